"""Looking at every shape of a study without building anything."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ostiform.domain import triangle_quality
from ostiform.errors import OstiformError
from ostiform.execution import each
from ostiform.pipeline.events import Progress, Tell
from ostiform.pipeline.prepare import prepared_components
from ostiform.study import ShapeEntry, ShapeId, Study, read_shape, read_study

__all__ = ["PartRow", "ShapeCheck", "check_study"]


@dataclass(frozen=True, slots=True)
class PartRow:
    """What was found in one part of one shape."""

    part: str
    n_vertices: int
    n_faces: int
    ostia: tuple[str, ...]
    worst_triangle: float


@dataclass(frozen=True, slots=True)
class ShapeCheck:
    """The verdict on one shape.

    Attributes
    ----------
    id : ShapeId
    parts : tuple of PartRow
        Empty if the shape cannot be read.
    repairs : tuple of str
        What reading and hygiene change.
    problem : str or None
        Why the shape cannot be used.
    """

    id: ShapeId
    parts: tuple[PartRow, ...]
    repairs: tuple[str, ...]
    problem: str | None


def check_study(study_path: Path, workers: int = 1, tell: Tell | None = None) -> list[ShapeCheck]:
    """Read every shape of a study and say whether it can be used.

    Raises
    ------
    InputError
        If the study itself is wrong.
    """
    study = read_study(study_path)
    tasks = [(study, entry) for entry in study.entries]
    checks: Sequence[ShapeCheck | None] = [None] * len(tasks)
    found = list(checks)
    for done, outcome in enumerate(each(_check, tasks, workers), start=1):
        found[outcome.index] = outcome.result
        if tell is not None:
            tell(Progress("check", done, len(tasks), str(study.entries[outcome.index].id)))
    return [check for check in found if check is not None]


def _check(task: tuple[Study, ShapeEntry]) -> ShapeCheck:
    study, entry = task
    try:
        shape = read_shape(study, entry)
        _, repairs = prepared_components(shape)
    except OstiformError as error:
        return ShapeCheck(entry.id, (), (), str(error))
    rows = tuple(
        PartRow(
            part,
            len(surface.vertices),
            len(surface.faces),
            tuple(surface.loops),
            triangle_quality(surface.vertices, surface.faces).worst,
        )
        for part, surface in shape.parts.items()
    )
    return ShapeCheck(entry.id, rows, (*shape.repairs, *repairs), None)
