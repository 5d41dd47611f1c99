"""Scores and volumes as CSV, one row per shape."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

from ostiform.arrays import FloatArray
from ostiform.atomic import atomically
from ostiform.model import StoredModel
from ostiform.study import ShapeId

__all__ = ["write_scores_csv", "write_volumes_csv"]

MM3_PER_ML = 1000.0
IDENTITY = ("subject", "phase", "time")


def write_scores_csv(path: Path, stored: StoredModel) -> None:
    """Write the scores of a model's training shapes in mm, columns ``mode1_mm`` and so on.

    Raises
    ------
    ArtifactError
        If the file cannot be written.
    """
    header = [*IDENTITY, *(f"mode{k + 1}_mm" for k in range(stored.scores.shape[1]))]
    rows = [
        [*_identity(id), *(f"{score:.6g}" for score in scores)]
        for id, scores in zip(stored.ids, stored.scores, strict=True)
    ]
    _write(path, header, rows)


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
    rows = [
        [*_identity(id), *(f"{values[index] / MM3_PER_ML:.6g}" for values in volumes.values())]
        for index, id in enumerate(ids)
    ]
    _write(path, [*IDENTITY, *(f"{part}_ml" for part in volumes)], rows)


def _identity(id: ShapeId) -> list[str]:
    return [id.subject, id.phase, f"{id.time:.6g}"]


def _write(path: Path, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    with atomically(path) as partial, partial.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)
