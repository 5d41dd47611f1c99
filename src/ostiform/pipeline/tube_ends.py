"""Openings that are cuts: their tubes end at one place of the anatomy in all shapes.

Artifacts: ``tube_ends.json``.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.artifacts import load, load_mapped, save, to_json
from ostiform.errors import InputError, TopologyError
from ostiform.pipeline.events import Note
from ostiform.pipeline.ingest import Named, opened_artifact
from ostiform.pipeline.run import Ready, Run, over_shapes
from ostiform.pipeline.store import Store, key_of
from ostiform.study import OpenedShape, Shape, ShapeNames, StudySettings, named_shape
from ostiform.surface import (
    Body,
    Surface,
    body_inside,
    distance_from_rims,
    height_over_body,
    rim_radius,
    shortened,
    split_ostium_name,
)
from ostiform.values import value

TUBE_ENDS = "tube_ends.json"

BALL_RADII = 1.6
"""Radius of the smallest ball of a body over that of the tube. On twelve generated atria, their
veins cut by 0 to 12 mm, 1.35 to 1.65 place the cut with the same standard deviation (0.3 to 0.5
mm)."""
SHORTEST_RADII = 0.35
"""Height over the body, in radii of the tube, below which none is cut: nearer, the foot of a tube
has no clear end. Chosen on the same atria."""
MARGIN_RADII = 0.1
"""What is cut off at least, in radii of the tube, so that every rim becomes level."""

Measured: TypeAlias = Literal["body", "rims"]
"""Height over the body, or distance from the rims of the part's openings that are no cuts."""

PLACES: Mapping[Measured, str] = {"body": "the body", "rims": "the openings that are no cuts"}


@value
class TubeEnd:
    """Where the tubes of one ostium are cut.

    Attributes
    ----------
    measured : "body" or "rims"
    radius : float, mm
        Of the tube: the median over the shapes.
    level : float, mm
        The height of the cut.
    """

    measured: Measured
    radius: float
    level: float


TubeEnds: TypeAlias = Mapping[str, TubeEnd]
"""By full name of the ostium."""


def tube_ends(run: Run, named: Named) -> TubeEnds:
    """Return where the tubes of the openings that are cuts end in all shapes.

    The shortest tube of the population decides: what is beyond it is not known of every shape. A
    tube that hardly leaves the body has no say.

    Raises
    ------
    InputError
        If a part has neither a body wider than the tube nor an opening that is no cut.
    """
    cuts = run.study.settings.cut_names
    if not cuts or not named.ready:
        return {}
    names = [to_json(named.names[shape.id]) for shape in named.ready]
    key = key_of("tube ends", [shape.key for shape in named.ready], names, cuts)
    if run.store.is_current(TUBE_ENDS, key):
        return known_tube_ends(run.store)
    tasks = [
        _Task(run.store, run.study.settings, shape, named.names[shape.id], {})
        for shape in named.ready
    ]
    ids = [shape.id for shape in named.ready]
    found, _ = over_shapes(run, "tubes", _radii, tasks, ids)
    known = [own for own in found if own is not None]
    radii = {name: float(np.median([own[name] for own in known])) for name in cuts}
    tasks = [replace(task, radii=radii) for task in tasks]
    found_reaches, _ = over_shapes(run, "tubes", _reaches, tasks, ids)
    reaches = {str(id): own for id, own in zip(ids, found_reaches, strict=True) if own is not None}
    ends = {
        name: _end(run, name, radii[name], {id: own[name] for id, own in reaches.items()})
        for name in cuts
    }
    with run.store.writing(TUBE_ENDS, key) as path:
        save(path, ends, dict[str, TubeEnd])
    return ends


def known_tube_ends(store: Store) -> TubeEnds:
    """Return where the tubes of a finished run end; empty where none of its openings is a cut.

    Raises
    ------
    ArtifactError
        If the file is damaged.
    """
    path = store.path(TUBE_ENDS)
    return load(path, dict[str, TubeEnd]) if path.is_file() else {}


def with_tube_ends(settings: StudySettings, shape: Shape, ends: TubeEnds) -> Shape:
    """Return a shape with its tubes cut where those of the population are.

    A tube that ends before keeps its rim, and the shape says so.

    Raises
    ------
    TopologyError
        If an opening has no tube of its own there.
    """
    parts, said = dict(shape.parts), []
    bodies = _bodies(parts, {name: end.radius for name, end in ends.items()})
    for name, end in ends.items():
        part, ostium = split_ostium_name(name)
        height = _height(settings, end.measured, bodies[part], parts[part], part, end.radius)
        if height is None:
            raise TopologyError(
                f"shape {shape.id}: {name}: expected a body with room for a ball of radius "
                f"{BALL_RADII * end.radius:.3g} mm, found none; leave this shape out"
            )
        least, place = float(height[parts[part].loops[ostium]].min()), PLACES[end.measured]
        if least <= end.level:
            said.append(
                f"{name} ends {least:.1f} mm from {place}, where others are cut at "
                f"{end.level:.1f} mm: its own rim is taken"
            )
            continue
        try:
            parts[part] = shortened(parts[part], ostium, height, end.level)
        except TopologyError as error:
            raise TopologyError(f"shape {shape.id}: {part}: {error}") from None
        said.append(
            f"{name} cut {least - end.level:.1f} mm shorter, {end.level:.1f} mm from {place}"
        )
    return Shape(shape.id, parts, shape.seams, (*shape.repairs, *said))


@dataclass(frozen=True, slots=True, eq=False)
class _Task:
    store: Store
    settings: StudySettings
    shape: Ready
    names: ShapeNames
    radii: Mapping[str, float]


def _radii(task: _Task) -> dict[str, float]:
    """Return the radius of every tube at its rim, mm."""
    parts = _named(task).parts
    return {
        name: rim_radius(parts[part], ostium)
        for name in task.settings.cut_names
        for part, ostium in [split_ostium_name(name)]
    }


def _reaches(task: _Task) -> dict[str, dict[Measured, float]]:
    """Return how far each tube reaches at least, as far as that can be measured, mm."""
    parts = _named(task).parts
    bodies = _bodies(parts, task.radii)
    reaches: dict[str, dict[Measured, float]] = {}
    for name, radius in task.radii.items():
        part, ostium = split_ostium_name(name)
        rim = parts[part].loops[ostium]
        heights = {
            measured: _height(task.settings, measured, bodies[part], parts[part], part, radius)
            for measured in PLACES
        }
        reaches[name] = {
            measured: float(height[rim].min())
            for measured, height in heights.items()
            if height is not None
        }
    return reaches


def _named(task: _Task) -> Shape:
    opened = load_mapped(task.store.path(opened_artifact(task.shape.name)), OpenedShape)
    return named_shape(task.settings, opened, task.names)


def _bodies(parts: Mapping[str, Surface], radii: Mapping[str, float]) -> dict[str, Body]:
    """Return the bodies of the parts that have tubes of these radii, by full ostium name."""
    least: dict[str, float] = {}
    for name, radius in radii.items():
        part, _ = split_ostium_name(name)
        least[part] = min(radius, least.get(part, radius))
    return {part: body_inside(parts[part], BALL_RADII * own) for part, own in least.items()}


def _height(
    settings: StudySettings,
    measured: Measured,
    body: Body,
    surface: Surface,
    part: str,
    radius: float,
) -> FloatArray | None:
    """Return the heights (V,) of a surface along a tube, mm; None where they have no ground."""
    if measured == "body":
        return height_over_body(body, surface.vertices, BALL_RADII * radius)
    anatomy = tuple(name for name in surface.loops if name not in settings.parts[part].cuts)
    return distance_from_rims(surface, anatomy) if anatomy else None


def _end(
    run: Run, name: str, radius: float, reaches: Mapping[str, Mapping[Measured, float]]
) -> TubeEnd:
    """Return where the tubes of an ostium end, from their reaches by shape."""
    measured: Measured = "body" if all("body" in own for own in reaches.values()) else "rims"
    if not all(measured in own for own in reaches.values()):
        raise InputError(
            f"{name}: expected a part with a body wider than {2.0 * BALL_RADII * radius:.3g} mm or "
            "with an opening that is no cut, found neither; take it from the cuts of its part"
        )
    tops = {id: own[measured] for id, own in reaches.items()}
    first = min(tops, key=lambda id: tops[id])
    shortest = SHORTEST_RADII * radius if measured == "body" else 0.0
    level = max(tops[first] - MARGIN_RADII * radius, shortest)
    run.on_event(
        Note(
            f"{name}: cut {level:.1f} mm from {PLACES[measured]} in all shapes; its tubes end "
            f"{tops[first]:.1f} ({first}) to {max(tops.values()):.1f} mm from there"
        )
    )
    return TubeEnd(measured, radius, level)
