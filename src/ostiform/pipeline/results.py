"""What every results folder says of its model, whoever brought its shapes into correspondence.

Files: ``model.h5``, ``scores.csv``, and where the shapes have triangles ``volumes.csv`` and
``clinical.csv`` (volumes, openings, long axis, twist of every shape).
"""

import shutil
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

from ostiform.evaluation import clinical_table, part_volumes
from ostiform.exchange import write_scores_csv, write_shape_values_csv, write_volumes_csv
from ostiform.model import CorrespondedShapes, StoredModel, write_model
from ostiform.pipeline.store import Store

Writer = Callable[[Path], object]


def result_files(stored: StoredModel, shapes: CorrespondedShapes | None) -> dict[str, Writer]:
    """Return what writes each file, by its name.

    Parameters
    ----------
    stored : StoredModel
    shapes : CorrespondedShapes or None
        Its training shapes, where they are known.
    """
    files: dict[str, Writer] = {
        "model.h5": partial(write_model, stored=stored),
        "scores.csv": partial(write_scores_csv, stored=stored),
    }
    if shapes is not None and len(shapes.mesh.faces):
        files |= {
            "volumes.csv": partial(_write_volumes, shapes=shapes),
            "clinical.csv": partial(_write_clinical, shapes=shapes),
        }
    return files


def write_all(store: Store, key: str, files: Mapping[str, Writer]) -> None:
    """Write artifacts, whether or not they are current."""
    for name, write in files.items():
        with store.writing(name, key) as path:
            write(path)


def write_missing(store: Store, key: str, files: Mapping[str, Writer]) -> None:
    """Write the artifacts that are not current."""
    write_all(store, key, {n: write for n, write in files.items() if not store.is_current(n, key)})


def copy_artifact(store: Store, source: str, target: str, key: str) -> None:
    """Copy an artifact within the output folder."""
    write_all(store, key, {target: partial(shutil.copyfile, store.path(source))})


def _write_volumes(path: Path, shapes: CorrespondedShapes) -> None:
    write_volumes_csv(path, shapes.ids, part_volumes(shapes.points, shapes.mesh))


def _write_clinical(path: Path, shapes: CorrespondedShapes) -> None:
    table = clinical_table(shapes.ids, shapes.points, shapes.aligned, shapes.mesh)
    write_shape_values_csv(path, table.ids, table.columns, table.values)
