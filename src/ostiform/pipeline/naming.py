"""Naming the openings of every shape, before any shape is kept.

Artifacts: ``surveys/NAME.json``, what naming needs to know of each shape.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ostiform.artifacts import load, save
from ostiform.domain import Circle, circle_from_part_sphere
from ostiform.errors import InputError
from ostiform.pipeline.events import Warn
from ostiform.pipeline.run import Failure, Run, over_shapes
from ostiform.pipeline.store import Store, file_hash, key_of, slug
from ostiform.study import (
    LayoutCircle,
    ShapeEntry,
    ShapeId,
    ShapeNames,
    ShapeSurvey,
    Study,
    StudySettings,
    named_population,
    survey_shape,
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
class Named:
    """The shapes whose openings are named, and those that were left out."""

    names: Mapping[ShapeId, ShapeNames]
    failures: tuple[Failure, ...]


def name_shapes(run: Run) -> Named:
    """Look at every shape and name its openings over the whole population."""
    entries = run.study.entries
    study = replace(run.study, entries=())  # a task's own entry is all that it needs
    tasks = [_SurveyTask(study, entry, run.store) for entry in entries]
    found, failures = over_shapes(run, "look", _survey, tasks, [entry.id for entry in entries])
    names, doubtful = _named(run, [survey for survey in found if survey is not None])
    return Named(names, (*failures, *doubtful))


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


def reading_inputs(study: Study, entry: ShapeEntry) -> list[Any]:
    """Return what a shape is read from: its files by their hashes, and the settings.

    Raises
    ------
    InputError
        If a file cannot be read.
    """
    settings = study.settings.model_dump(mode="json", include=READING_SETTINGS)
    identity = [entry.id.subject, entry.id.phase, entry.id.time]
    files = dict(entry.files)
    if entry.cuts is not None:
        files["cuts"] = entry.cuts
    hashes = {name: _hash(entry, name, path) for name, path in files.items()}
    return [identity, hashes, settings, list(entry.notes)]


@dataclass(frozen=True, slots=True)
class _SurveyTask:
    study: Study
    entry: ShapeEntry
    store: Store


def _survey(task: _SurveyTask) -> ShapeSurvey:
    key = key_of("survey", reading_inputs(task.study, task.entry))
    artifact = f"surveys/{slug(task.entry.id)}.json"
    stored = task.store.read_current(artifact, key, partial(load, kind=ShapeSurvey))
    if stored is not None:
        return stored
    survey = survey_shape(task.study, task.entry)
    with task.store.writing(artifact, key) as path:
        save(path, survey)
    return survey


def _named(
    run: Run, surveys: Sequence[ShapeSurvey]
) -> tuple[Mapping[ShapeId, ShapeNames], list[Failure]]:
    settings = run.study.settings
    population = named_population(settings, surveys, layout_circles(settings))
    failures = []
    for survey in surveys:
        if survey.id not in population.problems:
            continue
        reason = f"shape {survey.id}: {population.problems[survey.id]}"
        if run.study.settings.shapes.on_error == "stop":
            raise InputError(reason)
        run.on_event(Warn(f"{survey.id} left out: {reason}"))
        failures.append(Failure(survey.id, "look", reason))
    return population.names, failures


def _hash(entry: ShapeEntry, name: str, path: Path) -> str:
    try:
        return file_hash(path)
    except OSError as error:
        raise InputError(
            f"shape {entry.id}: expected to read {path} for {name}, found that "
            f"{error.strerror or error}: check the file"
        ) from error
