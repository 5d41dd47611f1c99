"""Naming the openings of every shape, before any shape is kept.

Artifacts: ``surveys/NAME.json``, what naming needs to know of each shape.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ostiform.errors import InputError
from ostiform.pipeline.events import Warn
from ostiform.pipeline.run import Failure, Run, over_shapes
from ostiform.pipeline.store import Store, file_hash, key_of, slug
from ostiform.study import (
    ShapeEntry,
    ShapeId,
    ShapeNames,
    ShapeSurvey,
    Study,
    named_population,
    survey_from_json,
    survey_shape,
    survey_to_json,
)

__all__ = ["Named", "name_shapes", "reading_inputs"]

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
    tasks = [_SurveyTask(run.study, entry, run.store) for entry in entries]
    found, failures = over_shapes(run, "look", _survey, tasks, [entry.id for entry in entries])
    names, doubtful = _named(run, [survey for survey in found if survey is not None])
    return Named(names, (*failures, *doubtful))


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
    if task.store.is_current(artifact, key):
        return survey_from_json(task.store.read_json(artifact))
    survey = survey_shape(task.study, task.entry)
    task.store.write_json(artifact, key, survey_to_json(survey))
    return survey


def _named(
    run: Run, surveys: Sequence[ShapeSurvey]
) -> tuple[Mapping[ShapeId, ShapeNames], list[Failure]]:
    population = named_population(run.study.settings, surveys)
    failures = []
    for survey in surveys:
        if survey.id not in population.problems:
            continue
        reason = f"shape {survey.id}: {population.problems[survey.id]}"
        if run.study.settings.shapes.on_error == "stop":
            raise InputError(reason)
        run.tell(Warn(f"{survey.id} left out: {reason}"))
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
