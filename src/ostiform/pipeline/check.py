"""Looking at every shape of a study without building anything."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ostiform.domain import triangle_quality
from ostiform.errors import OstiformError
from ostiform.execution import Workers
from ostiform.pipeline.events import OnEvent, Progress
from ostiform.pipeline.naming import layout_circles
from ostiform.pipeline.prepare import prepared_components
from ostiform.study import (
    ShapeEntry,
    ShapeId,
    ShapeNames,
    ShapeSurvey,
    Study,
    named_population,
    part_facts,
    read_shape,
    read_study,
    survey_shape,
)


@dataclass(frozen=True, slots=True)
class PartRow:
    """What was found in one part of one shape; None where it cannot be said.

    Attributes
    ----------
    part : str
    n_vertices, n_faces : int
    n_openings : int or None
    ostia : tuple of str
        The names of the openings; empty where they could not be named.
    genus : int or None
    n_components : int
        Connected pieces of the surface.
    worst_triangle : float
        Quality of the worst triangle, 1 for an equilateral one.
    """

    part: str
    n_vertices: int
    n_faces: int
    n_openings: int | None
    ostia: tuple[str, ...]
    genus: int | None
    n_components: int
    worst_triangle: float


@dataclass(frozen=True, slots=True)
class ShapeCheck:
    """The verdict on one shape.

    Attributes
    ----------
    id : ShapeId
    parts : tuple of PartRow
        The parts that can be read at all.
    repairs : tuple of str
        What reading and hygiene change.
    problem : str or None
        Why the shape cannot be used.
    """

    id: ShapeId
    parts: tuple[PartRow, ...]
    repairs: tuple[str, ...]
    problem: str | None


def check_study(
    study_path: Path, workers: int = 1, on_event: OnEvent | None = None
) -> list[ShapeCheck]:
    """Read every shape of a study and say whether it can be used.

    Raises
    ------
    InputError
        If the study itself is wrong.
    """
    study = read_study(study_path)
    entries = study.entries
    surveys: list[ShapeSurvey | None] = [None] * len(entries)
    problems: dict[ShapeId, str] = {}
    found: list[ShapeCheck | None] = [None] * len(entries)
    with Workers(workers) as pool:
        looks = [(study, entry) for entry in entries]
        for done, outcome in enumerate(pool.each(_look, looks), start=1):
            surveys[outcome.index] = outcome.value
            if outcome.error is not None:
                problems[entries[outcome.index].id] = str(outcome.error)
            _tell(on_event, "look", done, entries, outcome.index)
        population = named_population(
            study.settings,
            [s for s in surveys if s is not None],
            layout_circles(study.settings),
        )
        problems.update({k: f"shape {k}: {why}" for k, why in population.problems.items()})
        tasks = [
            (study, entry, population.names.get(entry.id), problems.get(entry.id))
            for entry in entries
        ]
        for done, checked in enumerate(pool.each(_check, tasks), start=1):
            found[checked.index] = checked.result
            _tell(on_event, "check", done, entries, checked.index)
    return [check for check in found if check is not None]


def _tell(
    on_event: OnEvent | None, stage: str, done: int, entries: Sequence[ShapeEntry], index: int
) -> None:
    if on_event is not None:
        on_event(Progress(stage, done, len(entries), str(entries[index].id)))


def _look(task: tuple[Study, ShapeEntry]) -> ShapeSurvey:
    return survey_shape(*task)


def _check(task: tuple[Study, ShapeEntry, ShapeNames | None, str | None]) -> ShapeCheck:
    study, entry, names, problem = task
    if problem is not None:
        return ShapeCheck(entry.id, _rows_of_files(study, entry), (), problem)
    try:
        shape = read_shape(study, entry, names)
        _, repairs = prepared_components(shape)
    except OstiformError as error:
        return ShapeCheck(entry.id, _rows_of_files(study, entry), (), str(error))
    rows = tuple(
        PartRow(
            part,
            len(surface.vertices),
            len(surface.faces),
            len(surface.loops),
            tuple(surface.loops),
            0,
            1,
            triangle_quality(surface.vertices, surface.faces).worst,
        )
        for part, surface in shape.parts.items()
    )
    return ShapeCheck(entry.id, rows, (*shape.repairs, *repairs), None)


def _rows_of_files(study: Study, entry: ShapeEntry) -> tuple[PartRow, ...]:
    """Return what can be said of the parts of a shape that cannot be used."""
    rows = []
    for part in study.settings.parts:
        facts = part_facts(study, entry, part)
        if facts is None:
            continue
        rows.append(
            PartRow(
                part,
                len(facts.vertices),
                len(facts.faces),
                facts.n_openings,
                (),
                facts.genus,
                facts.n_components,
                triangle_quality(facts.vertices, facts.faces).worst,
            )
        )
    return tuple(rows)
