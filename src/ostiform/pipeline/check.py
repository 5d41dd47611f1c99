"""Looking at every shape of a study without building anything."""

from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from ostiform.domain import triangle_quality
from ostiform.execution import Workers
from ostiform.pipeline.events import Event, OnEvent, Progress
from ostiform.pipeline.ingest import ingest_shapes, name_shapes
from ostiform.pipeline.prepare import prepared_shapes, shape_poses
from ostiform.pipeline.prepared import read_prepared, shape_artifact
from ostiform.pipeline.run import Run
from ostiform.pipeline.store import Store
from ostiform.pipeline.tube_ends import tube_ends
from ostiform.study import (
    MIRRORED,
    ShapeEntry,
    ShapeId,
    Study,
    other_arrays,
    part_facts,
    read_study,
)

UNLABELLED = "left out, as this frame has no label"


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
    is_excluded : bool
        Whether it is left out: by the sheet, or as a frame that nobody segmented.
    arrays : tuple of str
        What its files hold on the surface that no field of the study names.
    """

    id: ShapeId
    parts: tuple[PartRow, ...]
    repairs: tuple[str, ...]
    problem: str | None
    is_excluded: bool = False
    arrays: tuple[str, ...] = ()


def check_study(
    study_path: Path, workers: int = 1, on_event: OnEvent | None = None
) -> list[ShapeCheck]:
    """Read and prepare every shape of a study as a build does, and say whether it can be used.

    Raises
    ------
    InputError
        If the study itself is wrong.
    """
    study = read_study(study_path)
    shapes = study.settings.shapes.model_copy(update={"on_error": "skip"})
    settings = study.settings.model_copy(update={"shapes": shapes})

    def watch(event: Event) -> None:
        if isinstance(event, Progress) and on_event is not None:
            on_event(event)

    with TemporaryDirectory() as folder, Workers(workers) as pool:
        run = Run(replace(study, settings=settings), Store(Path(folder)), pool, watch)
        ingested = ingest_shapes(run)
        named = name_shapes(run, ingested)
        usable, failures = prepared_shapes(run, named, tube_ends(run, named))
        problems = {failure.id: failure.reason for failure in (*named.failures, *failures)}
        names = {ready.id: ready.name for ready, _ in usable}
        poses = shape_poses(run, [ready for ready, _ in usable]) if usable else ()
        notes = {pose.id: (MIRRORED,) for pose in poses if pose.mirrored}
        tasks = [
            _CheckTask(
                study,
                entry,
                run.store,
                names.get(entry.id),
                problems.get(entry.id),
                notes.get(entry.id, ()),
            )
            for entry in study.entries
            if entry.id not in ingested.unlabelled or entry.id in problems
        ]
        found: list[ShapeCheck | None] = [None] * len(tasks)
        for outcome in pool.each(_check, tasks):
            found[outcome.index] = outcome.result
    left_out = [
        *(
            ShapeCheck(id, (), (UNLABELLED,), None, True)
            for id in ingested.unlabelled
            if id not in problems
        ),
        *(ShapeCheck(id, (), (), None, True) for id in study.excluded),
    ]
    return [*(check for check in found if check is not None), *left_out]


@dataclass(frozen=True, slots=True)
class _CheckTask:
    study: Study
    entry: ShapeEntry
    store: Store
    name: str | None
    problem: str | None
    notes: tuple[str, ...]


def _check(task: _CheckTask) -> ShapeCheck:
    arrays = other_arrays(task.study.settings, task.entry)
    if task.name is None:
        rows = _rows_of_files(task.study, task.entry)
        return ShapeCheck(task.entry.id, rows, (), task.problem, arrays=arrays)
    prepared = read_prepared(task.store.path(shape_artifact(task.name)))
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
        for part, surface in prepared.shape.parts.items()
    )
    said = tuple(dict.fromkeys((*prepared.shape.repairs, *prepared.repairs, *task.notes)))
    return ShapeCheck(task.entry.id, rows, said, None, arrays=arrays)


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
