"""Stage 1: the files of every shape become surfaces with named ostia, in one pose, on one domain.

Artifacts: ``shapes/NAME.bin`` (the surfaces as read, in input coordinates), ``poses.json``,
``mirrored.json`` (which shapes seem to be mirror images) and ``domain.json``.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ostiform.arrays import FloatArray, frozen_floats
from ostiform.domain import (
    BaseDomain,
    CircleSetting,
    ComponentOutline,
    ConformalHoles,
    PopulationPoses,
    PoseFeatures,
    chosen_pole,
    domain_from_json,
    domain_to_json,
    lay_out,
    outlined,
    pose_features,
    poses_of_features,
)
from ostiform.embedding import conformal_holes
from ostiform.errors import InputError
from ostiform.pipeline.arrays_file import read_shape as read_stored_shape
from ostiform.pipeline.arrays_file import write_shape
from ostiform.pipeline.events import Warn
from ostiform.pipeline.naming import name_shapes, reading_inputs
from ostiform.pipeline.run import Failure, Ready, Run, over_shapes, survivors
from ostiform.pipeline.store import Store, key_of, slug
from ostiform.study import Shape, ShapeEntry, ShapeNames, Study, read_shape
from ostiform.surface import Component, cleaned_for_embedding, welded_components

MIRRORED = "mirrored.json"


@dataclass(frozen=True, slots=True, eq=False)
class Prepared:
    """The usable shapes of a study, their common pose and the base domain.

    Attributes
    ----------
    ready : tuple of Ready
        N shapes in study order.
    repairs : mapping of str to tuple of str
        What was changed on reading, by artifact name; only shapes with repairs.
    poses : (N, 4, 4) float64
        From input coordinates to the population's frame (column vectors).
    domain : BaseDomain
    domain_key : str
        Hash of everything the domain was made from.
    failures : tuple of Failure
    """

    ready: tuple[Ready, ...]
    repairs: Mapping[str, tuple[str, ...]]
    poses: FloatArray
    domain: BaseDomain
    domain_key: str
    failures: tuple[Failure, ...]


def prepare_shapes(run: Run) -> Prepared:
    """Read every shape, bring the population into one pose and lay out its base domain."""
    named = name_shapes(run)
    entries = [entry for entry in run.study.entries if entry.id in named.names]
    study = replace(run.study, entries=())  # a task's own entry is all that it needs
    tasks = [_ReadTask(study, entry, named.names[entry.id], run.store) for entry in entries]
    found, failures = over_shapes(run, "read", _read, tasks, [entry.id for entry in entries])
    repairs = {item.ready.name: item.repairs for item in found if item and item.repairs}
    ready = survivors(item.ready if item else None for item in found)
    settings = run.study.settings
    domain_key = key_of(
        "domain",
        [shape.key for shape in ready],
        settings.pole,
        settings.domain.model_dump(mode="json"),
    )
    if not all(run.store.is_current(name, domain_key) for name in ("poses.json", MIRRORED)):
        posed = _poses(run, ready)
        run.store.write_json("poses.json", domain_key, posed.transforms.tolist())
        run.store.write_json(MIRRORED, domain_key, [bool(item) for item in posed.mirrored])
    poses = frozen_floats(run.store.read_json("poses.json"), (len(ready), 4, 4), "poses")
    for shape, is_mirrored in zip(ready, run.store.read_json(MIRRORED), strict=True):
        if is_mirrored:
            run.on_event(Warn(f"{shape.id}: fits the others better as its mirror image; check it"))
    if not run.store.is_current("domain.json", domain_key):
        run.store.write_json("domain.json", domain_key, domain_to_json(_domain(run, ready, poses)))
    domain = domain_from_json(run.store.read_json("domain.json"))
    return Prepared(ready, repairs, poses, domain, domain_key, (*named.failures, *failures))


def prepared_components(shape: Shape) -> tuple[tuple[Component, ...], tuple[str, ...]]:
    """Return the components of a shape, fit for embedding, and what was repaired on the way."""
    cleaned = [cleaned_for_embedding(c) for c in welded_components(shape.parts, shape.seams)]
    return (
        tuple(component for component, _ in cleaned),
        tuple(repair for _, repairs in cleaned for repair in repairs),
    )


def shape_artifact(name: str) -> str:
    """Return the artifact of a shape as it was read."""
    return f"shapes/{name}.bin"


@dataclass(frozen=True, slots=True)
class _ReadTask:
    study: Study
    entry: ShapeEntry
    names: ShapeNames
    store: Store


@dataclass(frozen=True, slots=True)
class _Read:
    ready: Ready
    repairs: tuple[str, ...]


def _read(task: _ReadTask) -> _Read:
    name = slug(task.entry.id)
    names = [
        {part: dict(loops) for part, loops in task.names.names.items()},
        dict(task.names.closed),
        task.names.notes,
    ]
    key = key_of("shape", reading_inputs(task.study, task.entry), names)
    artifact = shape_artifact(name)
    shape = task.store.read_current(artifact, key, read_stored_shape)
    if shape is None:
        shape = read_shape(task.study, task.entry, task.names)
        prepared_components(shape)  # a topology that cannot be mapped is refused here
        with task.store.writing(artifact, key) as path:
            write_shape(path, shape)
    return _Read(Ready(task.entry.id, name, key), shape.repairs)


def _poses(run: Run, ready: Sequence[Ready]) -> PopulationPoses:
    features: list[PoseFeatures | None] = [None] * len(ready)
    names = [shape.name for shape in ready]
    for outcome in run.workers.each(_pose_features, names, run.store):
        features[outcome.index] = outcome.result
    return poses_of_features([own for own in features if own is not None])


def _pose_features(name: str, store: Store) -> PoseFeatures:
    return pose_features(read_stored_shape(store.path(shape_artifact(name))))


@dataclass(frozen=True, slots=True, eq=False)
class _HolesTask:
    store: Store
    name: str
    poles: tuple[str | None, ...]
    pose: FloatArray


def _domain(run: Run, ready: Sequence[Ready], poses: FloatArray) -> BaseDomain:
    """Lay out the domain; a shape whose holes cannot be mapped has no say, and fails later."""
    pole, ids = run.study.settings.pole, [shape.id for shape in ready]
    names = [(run.store, shape.name) for shape in ready]
    outlines, _ = over_shapes(run, "outline", _outlines, names, ids)
    by_component = [list(column) for column in zip(*(o for o in outlines if o), strict=True)]
    poles = tuple(chosen_pole(column, pole) for column in by_component)
    tasks = [
        _HolesTask(run.store, shape.name, poles, pose)
        for shape, pose in zip(ready, poses, strict=True)
    ]
    holes, _ = over_shapes(run, "domain", _holes, tasks, ids)
    usable = [item for item in holes if item is not None]
    if not usable:
        raise InputError(
            "base domain: expected hole positions of at least one shape, found none; "
            "mend the shapes named above and run again"
        )
    return lay_out(
        by_component,
        [list(column) for column in zip(*usable, strict=True)],
        pole,
        _circle_settings(run.study),
    )


def _outlines(task: tuple[Store, str]) -> tuple[ComponentOutline, ...]:
    store, name = task
    shape = read_stored_shape(store.path(shape_artifact(name)))
    return tuple(outlined(c) for c in welded_components(shape.parts, shape.seams))


def _holes(task: _HolesTask) -> tuple[ConformalHoles, ...]:
    shape = read_stored_shape(task.store.path(shape_artifact(task.name)))
    components, _ = prepared_components(shape)
    return tuple(
        conformal_holes(component, pole, task.pose)
        for component, pole in zip(components, task.poles, strict=True)
    )


def _circle_settings(study: Study) -> dict[str, CircleSetting]:
    return {
        name: CircleSetting(
            np.array(circle.center), circle.radius_deg, circle.phase_deg, circle.frame
        )
        for name, circle in study.settings.domain.circles.items()
    }
