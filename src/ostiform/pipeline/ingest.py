"""Stage 1: the files of every shape are read, once, and its openings named over the population.

Artifacts: ``opened/NAME.bin``, each shape as its files hold it, repaired and cut open.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ostiform.artifacts import load_mapped, save
from ostiform.domain import Circle, circle_from_part_sphere
from ostiform.errors import InputError, UnlabelledError
from ostiform.pipeline.events import Note, Warn
from ostiform.pipeline.run import Failure, Ready, Run, over_shapes
from ostiform.pipeline.store import Store, file_hash, key_of, slug
from ostiform.study import (
    LayoutCircle,
    OpenedShape,
    ShapeEntry,
    ShapeId,
    ShapeNames,
    ShapeSurvey,
    Study,
    StudySettings,
    data_beside,
    named_population,
    opened_shape,
    shape_survey,
    surface_fields,
)
from ostiform.surface import split_ostium_name

READING_SETTINGS = {
    "repair",
    "units",
    "frame",
    "parts",
    "seams",
    "shapes",
    "ostia",
    "welding",
    "labels",
    "cuts",
}


@dataclass(frozen=True, slots=True, eq=False)
class Ingested:
    """The shapes whose files could be read.

    Attributes
    ----------
    ready : tuple of Ready
        In study order.
    surveys : tuple of ShapeSurvey
        What naming needs to know of each.
    failures : tuple of Failure
    unlabelled : tuple of ShapeId
        Frames left out because nobody segmented them.
    """

    ready: tuple[Ready, ...]
    surveys: tuple[ShapeSurvey, ...]
    failures: tuple[Failure, ...]
    unlabelled: tuple[ShapeId, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Named:
    """The shapes whose openings are named, and those that were left out.

    Attributes
    ----------
    ready : tuple of Ready
        In study order.
    names : mapping of ShapeId to ShapeNames
    failures : tuple of Failure
        Also of shapes whose files could not be read.
    """

    ready: tuple[Ready, ...]
    names: Mapping[ShapeId, ShapeNames]
    failures: tuple[Failure, ...]


def ingest_shapes(run: Run) -> Ingested:
    """Read the files of every shape of a study."""
    entries = run.study.entries
    if run.study.excluded:
        run.on_event(Note(f"left out as excluded: {', '.join(map(str, run.study.excluded))}"))
    study = replace(run.study, entries=())  # a task's own entry is all that it needs
    tasks = [_IngestTask(study, entry, run.store) for entry in entries]
    found, failures = over_shapes(run, "read", _ingested, tasks, [entry.id for entry in entries])
    pairs = [pair for pair in found if pair is not None]
    used = {ready.id for ready, _ in pairs} | {failure.id for failure in failures}
    unlabelled = tuple(entry.id for entry in entries if entry.id not in used)
    for subject in dict.fromkeys(id.subject for id in unlabelled):
        own = [id for id in unlabelled if id.subject == subject]
        if subject not in {id.subject for id in used}:
            reason = f"shape {own[0]}: expected a label in some frame, found none in {len(own)}"
            if run.study.settings.shapes.on_error == "stop":
                raise InputError(reason)
            failures.append(Failure(own[0], "read", reason))
        else:
            phases = ", ".join(id.phase for id in own)
            run.on_event(Note(f"{subject}: left out the frames without any label: {phases}"))
    return Ingested(
        tuple(ready for ready, _ in pairs),
        tuple(survey for _, survey in pairs),
        tuple(failures),
        unlabelled,
    )


def name_shapes(run: Run, ingested: Ingested, known: Sequence[ShapeSurvey] = ()) -> Named:
    """Name the openings of all shapes over the whole population, known ones first."""
    settings = run.study.settings
    surveys = [*known, *ingested.surveys]
    population = named_population(settings, surveys, layout_circles(settings))
    failures = list(ingested.failures)
    for shape in ingested.ready:
        if shape.id not in population.problems:
            continue
        reason = f"shape {shape.id}: {population.problems[shape.id]}"
        if settings.shapes.on_error == "stop":
            raise InputError(reason)
        run.on_event(Warn(f"{shape.id} left out: {reason}"))
        failures.append(Failure(shape.id, "name", reason))
    named = tuple(shape for shape in ingested.ready if shape.id in population.names)
    return Named(named, population.names, tuple(failures))


def opened_artifact(name: str) -> str:
    """Return the artifact of a shape as its files hold it."""
    return f"opened/{name}.bin"


def stored_survey(store: Store, name: str) -> ShapeSurvey:
    """Return what naming needs to know of a shape that was read before.

    Raises
    ------
    ArtifactError
        If its file is missing or damaged.
    """
    return shape_survey(load_mapped(store.path(opened_artifact(name)), OpenedShape))


def layout_circles(settings: StudySettings) -> dict[str, LayoutCircle]:
    """Return the circles that a study gives its domain, on the spheres of the components."""
    sides: dict[str, Literal["first", "second"]] = {}
    for seam in settings.seam_pairs:
        sides.setdefault(split_ostium_name(seam.first)[0], "first")
        sides.setdefault(split_ostium_name(seam.second)[0], "second")
    circles = {}
    for name, given in settings.domain.circles.items():
        part = split_ostium_name(name)[0]
        center = np.array(given.center, dtype=np.float64)
        length = float(np.linalg.norm(center))
        if length == 0.0:
            continue  # refused where the domain is laid out
        circle = Circle(center / length, float(np.radians(given.radius_deg)), 0.0)
        if given.frame == "part" and part in sides:
            circle = circle_from_part_sphere(circle, sides[part])
        circles[name] = LayoutCircle(circle.center, circle.radius)
    return circles


def _reading_inputs(study: Study, entry: ShapeEntry) -> list[Any]:
    """Return what a shape is read from: its files by their hashes, and the settings.

    Raises
    ------
    InputError
        If a file cannot be read.
    """
    settings = study.settings.model_dump(mode="json", include=READING_SETTINGS)
    identity = [entry.id.subject, entry.id.phase, entry.id.time, entry.frame, entry.reflect]
    files = dict(entry.files)
    files |= {f"cuts {k}": path for k, path in enumerate(entry.cuts)}
    for name, path in entry.files.items():
        files |= {f"{name} {item.suffix}": item for item in data_beside(path)}
    hashes = {name: _hash(entry, name, path) for name, path in files.items()}
    return [identity, hashes, settings, list(entry.notes)]


@dataclass(frozen=True, slots=True)
class _IngestTask:
    study: Study
    entry: ShapeEntry
    store: Store


def _ingested(task: _IngestTask) -> tuple[Ready, ShapeSurvey] | None:
    """Return a shape as read; None for a frame that nobody segmented."""
    name = slug(task.entry.id)
    key = key_of("ingest", _reading_inputs(task.study, task.entry))
    artifact = opened_artifact(name)
    opened = task.store.read_current(artifact, key, lambda path: load_mapped(path, OpenedShape))
    if opened is None:
        try:
            opened = opened_shape(task.study, task.entry)
        except UnlabelledError:
            if task.entry.frame is None:
                raise
            return None
        with task.store.writing(artifact, key) as path:
            save(path, opened)
    if task.study.settings.fields:
        surface_fields(task.study.settings, task.entry)  # what it lacks is told before all else
    return Ready(task.entry.id, name, key), shape_survey(opened)


def _hash(entry: ShapeEntry, name: str, path: Path) -> str:
    try:
        return file_hash(path)
    except OSError as error:
        raise InputError(
            f"shape {entry.id}: expected to read {path} for {name}, found that "
            f"{error.strerror or error}: check the file"
        ) from error
