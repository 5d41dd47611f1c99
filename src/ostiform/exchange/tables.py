"""What is known of every shape as CSV: scores, volumes and other numbers, one row per shape."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.errors import ArtifactError
from ostiform.model import StoredModel
from ostiform.study import ShapeId
from ostiform.tables import write_table

MM3_PER_ML = 1000.0
IDENTITY = ("subject", "phase", "time")


def write_shape_values_csv(
    path: Path, ids: Sequence[ShapeId], columns: Sequence[str], values: FloatArray
) -> None:
    """Write who and when, and numbers (N, C) with the names of their columns.

    Raises
    ------
    ArtifactError
        If the file cannot be written.
    """
    rows = (
        [id.subject, id.phase, float(id.time), *map(float, row)]
        for id, row in zip(ids, values, strict=True)
    )
    write_table(path, [*IDENTITY, *columns], rows)


def read_shape_values_csv(path: Path) -> tuple[tuple[ShapeId, ...], tuple[str, ...], FloatArray]:
    """Read what `write_shape_values_csv` wrote.

    Returns
    -------
    ids : (N,) tuple of ShapeId
    columns : (C,) tuple of str
    values : (N, C) float64
        NaN where a cell is empty.

    Raises
    ------
    ArtifactError
        If the file is missing or another one.
    """
    try:
        with path.open(encoding="utf-8", newline="") as stream:
            header, *rows = csv.reader(stream)
        if tuple(header[:3]) != IDENTITY:
            raise ValueError(f"the columns {', '.join(header[:3])}")
        ids = tuple(ShapeId(subject, phase, float(time)) for subject, phase, time, *_ in rows)
        columns = tuple(header[3:])
        values = np.array([[cell or "nan" for cell in row[3:]] for row in rows], dtype=np.float64)
        return ids, columns, values.reshape(len(ids), len(columns))
    except (OSError, ValueError) as error:
        raise ArtifactError(
            f"{path}: expected a table of shapes that this program wrote, found {error}; run "
            "`ostiform model` on this output folder"
        ) from error


def write_scores_csv(path: Path, stored: StoredModel) -> None:
    """Write the scores of a model's training shapes in mm, columns ``mode1_mm`` and so on.

    Raises
    ------
    ArtifactError
        If the file cannot be written.
    """
    columns = [f"mode{k + 1}_mm" for k in range(stored.scores.shape[1])]
    write_shape_values_csv(path, stored.ids, columns, stored.scores)


def write_volumes_csv(
    path: Path, ids: Sequence[ShapeId], volumes: Mapping[str, FloatArray]
) -> None:
    """Write the volume of every part in ml, columns ``LV_ml`` and so on.

    Parameters
    ----------
    path : Path
    ids : sequence of ShapeId
        N shapes.
    volumes : mapping of str to (N,) float64, mm^3
        By part; see `evaluation.part_volumes`.

    Raises
    ------
    ArtifactError
        If the file cannot be written.
    """
    values = np.array(list(volumes.values())).reshape(len(volumes), len(ids)).T / MM3_PER_ML
    write_shape_values_csv(path, ids, [f"{part}_ml" for part in volumes], values)
