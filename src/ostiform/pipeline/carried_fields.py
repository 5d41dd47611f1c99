"""The fields of a study at the corresponding points of every shape.

Artifacts: ``fields.bin`` and ``fields/NAME.csv``, one row per shape and one column per point.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.artifacts import load, save
from ostiform.execution import Executor
from ostiform.model import ModelMesh, SurfaceField
from ostiform.pipeline.results import Writer, write_all
from ostiform.pipeline.store import Store, key_of
from ostiform.study import (
    ShapeEntry,
    ShapeId,
    StudySettings,
    surface_fields,
    values_at,
)
from ostiform.tables import write_table

FIELDS = "fields.bin"
FOLDER = "fields"

Fields = tuple[SurfaceField, ...]


def fields_key(settings: StudySettings, key: str) -> str:
    """Return the hash of what the fields of shapes in correspondence are made from."""
    stated = {name: field.model_dump(mode="json") for name, field in settings.fields.items()}
    return key_of("fields", key, stated)


def write_fields(store: Store, key: str, ids: Sequence[ShapeId], fields: Fields) -> None:
    """Write fields and their tables; remove those of a study that names them no longer."""
    tables = field_tables(ids, fields)
    for path in store.path(FOLDER).glob("*.csv"):
        if f"{FOLDER}/{path.name}" not in tables:
            store.remove(f"{FOLDER}/{path.name}")
    if not fields:
        store.remove(FIELDS)
        return
    write_all(store, key, {FIELDS: partial(save, value=fields, kind=Fields), **tables})


def field_tables(ids: Sequence[ShapeId], fields: Fields) -> dict[str, Writer]:
    """Return what writes the table of every field, by its path in a folder of results."""
    return {
        f"{FOLDER}/{quote(field.name, safe=' ')}.csv": partial(_write_table, ids=ids, field=field)
        for field in fields
    }


def read_fields(store: Store) -> Fields:
    """Return the fields of a folder of results, none where its study names none.

    Raises
    ------
    ArtifactError
        If their file is damaged.
    """
    path = store.path(FIELDS)
    return load(path, Fields) if path.is_file() else ()


def carried_fields(
    settings: StudySettings,
    entries: Sequence[ShapeEntry],
    points: FloatArray,
    mesh: ModelMesh,
    workers: Executor,
) -> Fields:
    """Return the fields of shapes at their corresponding points.

    Parameters
    ----------
    settings : StudySettings
    entries : sequence of ShapeEntry
        N shapes, whose files are read.
    points : (N, P, 3) float64, mm
        In each shape's input coordinates.
    mesh : ModelMesh
        Says which points belong to which part.
    workers : Executor

    Raises
    ------
    InputError
        If a file cannot be read or lacks a field.
    """
    if not settings.fields:
        return ()
    owned = {part: mesh.of_part(part)[0] for part in mesh.parts}
    tasks = [_Task(settings, entry, own) for entry, own in zip(entries, points, strict=True)]
    found = np.full((len(settings.fields), *points.shape[:2]), np.nan)
    for outcome in workers.each(_carried, tasks, owned):
        found[:, outcome.index] = outcome.result
    return tuple(
        SurfaceField(name, field.units, field.kind == "label", values)
        for (name, field), values in zip(settings.fields.items(), found, strict=True)
    )


def fields_of_all(known: Fields, further: Fields, n_further: int) -> Fields:
    """Return fields with the values of further shapes, NaN where these have no such field."""
    by_name = {field.name: field.values for field in further}
    return tuple(
        replace(
            field,
            values=np.concatenate(
                [
                    field.values,
                    by_name.get(field.name, np.full((n_further, field.values.shape[1]), np.nan)),
                ]
            ),
        )
        for field in known
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Task:
    settings: StudySettings
    entry: ShapeEntry
    points: FloatArray


def _carried(task: _Task, owned: Mapping[str, np.ndarray]) -> FloatArray:
    """Return the fields (K, P) of one shape; points of a seam have the values of its first part."""
    fields = task.settings.fields
    values = {name: np.full(len(task.points), np.nan) for name in fields}
    meshes = surface_fields(task.settings, task.entry)
    for part in reversed(tuple(owned)):
        rows = owned[part]
        for name, own in values_at(meshes[part], fields, task.points[rows]).items():
            values[name][rows] = np.where(np.isnan(own), values[name][rows], own)
    return np.array(list(values.values()))


def _write_table(path: Path, ids: Sequence[ShapeId], field: SurfaceField) -> None:
    header = ["subject", "phase", "time", *map(str, range(field.values.shape[1]))]
    rows: Any = (
        [id.subject, id.phase, float(id.time), *(None if np.isnan(v) else float(v) for v in row)]
        for id, row in zip(ids, field.values, strict=True)
    )
    write_table(path, header, rows)
