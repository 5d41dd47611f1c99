"""Stage 2: the surfaces of every shape are made fit for maps, in one pose, on one domain.

Artifacts: ``shapes/NAME.bin`` (the surfaces with named openings, and the components that are
mapped), ``poses.json`` (by shape, and whether it seems to be a mirror image), ``holes.json`` (where
the openings of every shape lie in its conformal map, by the name of its artifacts) and
``domain.json``.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, TypeAlias

import numpy as np

from ostiform.arrays import FloatArray, frozen_floats
from ostiform.artifacts import load, load_mapped, save, to_json
from ostiform.domain import (
    BaseDomain,
    CircleSetting,
    ConformalHoles,
    PoseFeatures,
    chosen_pole,
    domain_from_json,
    domain_to_json,
    lay_out,
    pose_features,
    poses_of_features,
)
from ostiform.embedding import conformal_holes
from ostiform.errors import InputError
from ostiform.pipeline.events import Warn
from ostiform.pipeline.ingest import Named, ingest_shapes, name_shapes, opened_artifact
from ostiform.pipeline.prepared import prepared_shape, read_prepared, read_shape, shape_artifact
from ostiform.pipeline.run import Failure, Ready, Run, over_shapes, survivors
from ostiform.pipeline.store import Store, key_of
from ostiform.pipeline.tube_ends import TubeEnd, TubeEnds, tube_ends, with_tube_ends
from ostiform.study import (
    MIRRORED,
    OpenedShape,
    ShapeId,
    ShapeNames,
    Study,
    StudySettings,
    named_shape,
)
from ostiform.values import Axes, value

POSES = "poses.json"
HOLES = "holes.json"
DOMAIN = "domain.json"

FINEST = 10_000
"""Vertices of a part that are always mapped: 1 to 2 s, where 90,000 take 30 to 600 s."""
POINT_VERTICES = 4
"""Vertices of a part for each point of the template: edges half as long as the template's."""

Holes: TypeAlias = Mapping[str, tuple[ConformalHoles, ...]]


@value
class ShapePose:
    """The pose of one shape.

    Attributes
    ----------
    id : ShapeId
    transform : (4, 4) float64
        From input coordinates to the population's frame (column vectors).
    mirrored : bool
        Whether it fits the others better as its mirror image.
    """

    id: ShapeId
    transform: Annotated[FloatArray, Axes(4, 4)]
    mirrored: bool


@dataclass(frozen=True, slots=True, eq=False)
class Prepared:
    """The usable shapes of a study, their common pose and the base domain.

    Attributes
    ----------
    ready : tuple of Ready
        N shapes in study order.
    repairs : mapping of str to tuple of str
        What was changed on reading and for the maps, by artifact name; only shapes with repairs.
    poses : (N, 4, 4) float64
        From input coordinates to the population's frame (column vectors).
    holes : mapping of str to tuple of ConformalHoles
        By artifact name, one per component; not of shapes whose conformal map failed.
    domain : BaseDomain
    domain_key : str
        Hash of everything the domain was made from.
    failures : tuple of Failure
    """

    ready: tuple[Ready, ...]
    repairs: Mapping[str, tuple[str, ...]]
    poses: FloatArray
    holes: Holes
    domain: BaseDomain
    domain_key: str
    failures: tuple[Failure, ...]


def prepare_shapes(run: Run) -> Prepared:
    """Read every shape, bring the population into one pose and lay out its base domain."""
    named = name_shapes(run, ingest_shapes(run))
    found, failures = prepared_shapes(run, named, tube_ends(run, named))
    repairs = {ready.name: repairs for ready, repairs in found if repairs}
    ready = survivors(shape for shape, _ in found)
    settings = run.study.settings
    key = key_of(
        "domain",
        [shape.key for shape in ready],
        settings.pole,
        settings.alignment.frame,
        settings.domain.model_dump(mode="json"),
    )
    if not run.store.is_current(POSES, key):
        with run.store.writing(POSES, key) as path:
            save(path, shape_poses(run, ready), tuple[ShapePose, ...])
    posed = read_poses(run.store)
    for shape in posed:
        if shape.mirrored:
            run.on_event(Warn(f"{shape.id}: {MIRRORED}"))
    poses = frozen_floats([p.transform for p in posed], (len(ready), 4, 4), "poses")
    if not all(run.store.is_current(name, key) for name in (HOLES, DOMAIN)):
        _lay_out(run, ready, poses, key)
    domain = domain_from_json(run.store.read_json(DOMAIN))
    holes = load(run.store.path(HOLES), dict[str, tuple[ConformalHoles, ...]])
    return Prepared(ready, repairs, poses, holes, domain, key, (*named.failures, *failures))


def prepared_shapes(
    run: Run, named: Named, ends: TubeEnds
) -> tuple[list[tuple[Ready, tuple[str, ...]]], list[Failure]]:
    """Make the surfaces of named shapes fit for maps.

    Parameters
    ----------
    run : Run
    named : Named
    ends : mapping of str to TubeEnd
        Where the tubes of the openings that are cuts end, by full name.

    Returns
    -------
    found : list of (Ready, tuple of str)
        The shapes, in study order, and what was changed on reading and for the maps.
    failures : list of Failure
    """
    tasks = [
        _PrepareTask(run.store, run.study.settings, shape, named.names[shape.id], ends)
        for shape in named.ready
    ]
    ids = [shape.id for shape in named.ready]
    found, failures = over_shapes(run, "prepare", _prepared, tasks, ids)
    return [item for item in found if item is not None], failures


def read_poses(store: Store) -> tuple[ShapePose, ...]:
    """Return the poses of a run.

    Raises
    ------
    ArtifactError
        If they are missing or damaged.
    """
    return load(store.path(POSES), tuple[ShapePose, ...])


@dataclass(frozen=True, slots=True)
class _PrepareTask:
    store: Store
    settings: StudySettings
    shape: Ready
    names: ShapeNames
    ends: TubeEnds


def _prepared(task: _PrepareTask) -> tuple[Ready, tuple[str, ...]]:
    name = task.shape.name
    finest = _finest(task.settings)
    ends = to_json(task.ends, dict[str, TubeEnd])
    key = key_of("prepare", task.shape.key, to_json(task.names), ends, finest)
    artifact = shape_artifact(name)
    prepared = task.store.read_current(artifact, key, read_prepared)
    if prepared is None:
        opened = load_mapped(task.store.path(opened_artifact(name)), OpenedShape)
        shape = named_shape(task.settings, opened, task.names)
        prepared = prepared_shape(with_tube_ends(task.settings, shape, task.ends), finest)
        with task.store.writing(artifact, key) as path:
            save(path, prepared)
    repairs = (*prepared.shape.repairs, *prepared.repairs)
    return Ready(task.shape.id, name, key), repairs


def _finest(settings: StudySettings) -> int | None:
    """Return the most vertices that a part is mapped with; None for all that it has."""
    if not settings.embedding.coarsen:
        return None
    return max(FINEST, POINT_VERTICES * settings.template.points)


def shape_poses(run: Run, ready: Sequence[Ready]) -> tuple[ShapePose, ...]:
    """Return the poses of prepared shapes in their common frame."""
    features: list[PoseFeatures | None] = [None] * len(ready)
    names = [shape.name for shape in ready]
    for outcome in run.workers.each(_features, names, run.store):
        features[outcome.index] = outcome.result
    trusted = run.study.settings.alignment.frame == "files"
    posed = poses_of_features([own for own in features if own is not None], trusted)
    return tuple(
        ShapePose(shape.id, transform, bool(mirrored))
        for shape, transform, mirrored in zip(ready, posed.transforms, posed.mirrored, strict=True)
    )


def _features(name: str, store: Store) -> PoseFeatures:
    return pose_features(read_shape(store.path(shape_artifact(name))))


@dataclass(frozen=True, slots=True, eq=False)
class _HolesTask:
    store: Store
    name: str
    poles: tuple[str | None, ...]
    pose: FloatArray


def _lay_out(run: Run, ready: Sequence[Ready], poses: FloatArray, key: str) -> None:
    """Lay out the domain; a shape whose holes cannot be mapped has no say, and fails later."""
    pole, ids = run.study.settings.pole, [shape.id for shape in ready]
    outlines = [read_prepared(run.store.path(shape_artifact(s.name))).outlines for s in ready]
    by_component = [list(column) for column in zip(*outlines, strict=True)]
    poles = tuple(chosen_pole(column, pole) for column in by_component)
    tasks = [
        _HolesTask(run.store, shape.name, poles, pose)
        for shape, pose in zip(ready, poses, strict=True)
    ]
    found, _ = over_shapes(run, "domain", _holes, tasks, ids)
    holes = {shape.name: own for shape, own in zip(ready, found, strict=True) if own is not None}
    if not holes:
        raise InputError(
            "base domain: expected hole positions of at least one shape, found none; "
            "mend the shapes named above and run again"
        )
    columns = [list(column) for column in zip(*holes.values(), strict=True)]
    domain = lay_out(by_component, columns, pole, _circle_settings(run.study))
    with run.store.writing(HOLES, key) as path:
        save(path, holes, dict[str, tuple[ConformalHoles, ...]])
    run.store.write_json(DOMAIN, key, domain_to_json(domain))


def _holes(task: _HolesTask) -> tuple[ConformalHoles, ...]:
    components = read_prepared(task.store.path(shape_artifact(task.name))).components
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
