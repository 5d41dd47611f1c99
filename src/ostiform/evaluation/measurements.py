"""Clinical numbers of shapes in correspondence: openings, long axis, twist, ejection.

Definitions, for one part (docs/dynamics.md has them with pictures of thought):

- *area* of an opening: magnitude of its rim's vector area, ``|1/2 sum p_i x p_(i+1)|``, the area
  of the flat cap; *diameters*: axes of the ellipse that has the second moments of the rim, seen
  along the vector area (exact for an ellipse); all on the smooth curve through the rim's points;
- *annulus*: the opening of the part with the longest perimeter on the mean of the shapes; *apex*:
  the part's point furthest from the annulus' centre there. Both are the same material points in
  all shapes. *Long axis*: from the centre of the annulus to the apex;
- *reference*: the phase of the heart in which the part is largest (end-diastole of a ventricle);
- *twist*: rotation about the long axis since the reference of the third of the part nearest to the
  apex, less that of the third nearest to the annulus; positive counter-clockwise seen from the
  apex.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ostiform.arrays import FloatArray, IntArray, frozen_floats
from ostiform.errors import InputError
from ostiform.evaluation.clinical import enclosed_volumes, part_volumes
from ostiform.model import ModelMesh
from ostiform.study import ShapeId
from ostiform.surface import Surface, vertex_areas
from ostiform.values import Axes, value

MM3_PER_ML = 1000.0
VOLUME = "_volume_ml"
WALLS = re.compile("epi|myo", re.IGNORECASE)
"""Names of parts that enclose no blood of their own."""

THIRD = 1.0 / 3.0


_CURVE_STEPS = 8
"""Pieces that a smooth rim is drawn in from each of its points to the next."""


@dataclass(frozen=True, slots=True, eq=False)
class RimMeasures:
    """Sizes of one opening in several shapes.

    Attributes
    ----------
    area : (N,) float64, mm^2
    perimeter, diameter_max, diameter_min : (N,) float64, mm
    centre : (N, 3) float64, mm
        Centroid of the flat cap.
    """

    area: FloatArray
    perimeter: FloatArray
    diameter_max: FloatArray
    diameter_min: FloatArray
    centre: FloatArray


@dataclass(frozen=True, slots=True)
class LongAxis:
    """The material points that a part's long axis joins.

    Attributes
    ----------
    annulus : str
        Full name of the opening.
    apex : int
        Index of the point.
    """

    annulus: str
    apex: int


@value
class ClinicalTable:
    """Numbers of shapes, one column per quantity, with the unit at the end of its name.

    Attributes
    ----------
    ids : tuple of ShapeId
    columns : tuple of str
    values : (N, C) float64
        NaN where a shape has no such number.
    """

    ids: Annotated[tuple[ShapeId, ...], Axes("N")]
    columns: Annotated[tuple[str, ...], Axes("columns")]
    values: Annotated[FloatArray, Axes("N", "columns", gaps=True)]

    @property
    def volumes(self) -> dict[str, FloatArray]:
        """Volume (N,) in mm^3 of every part."""
        return {
            name.removesuffix(VOLUME): MM3_PER_ML * self.values[:, index]
            for index, name in enumerate(self.columns)
            if name.endswith(VOLUME)
        }

    def column(self, name: str) -> FloatArray:
        """Return one column (N,).

        Raises
        ------
        InputError
            If there is no such column.
        """
        if name not in self.columns:
            raise InputError(
                f"clinical numbers: expected one of {', '.join(self.columns)}, found {name}"
            )
        values: FloatArray = self.values[:, self.columns.index(name)]
        return values


def rim_curves(rims: FloatArray) -> FloatArray:
    """Return smooth closed curves through the points of rims (N, n, 3), as (N, 8 n, 3).

    A sampled rim of a dozen points is a polygon, whose length is 1 % and whose area is 4 % below
    those of the rim that they lie on. The curve is cubic from point to point, with the tangents of
    the parabola through three points, by chord length: 12 points of an oval, evenly spaced or not,
    give both within 0.4 %.
    """
    points = np.asarray(rims, dtype=np.float64)
    after = np.roll(points, -1, axis=1)
    chord = np.linalg.norm(after - points, axis=2, keepdims=True)  # (N, n, 1)
    slope = (after - points) / np.maximum(chord, np.finfo(np.float64).tiny)
    chord_before, slope_before = np.roll(chord, 1, axis=1), np.roll(slope, 1, axis=1)
    both = np.maximum(chord + chord_before, np.finfo(np.float64).tiny)
    tangent = (chord_before * slope + chord * slope_before) / both
    start, end = tangent * chord, np.roll(tangent, -1, axis=1) * chord
    t = (np.arange(_CURVE_STEPS) / _CURVE_STEPS)[:, None]
    curves: FloatArray = (
        (2.0 * t**3 - 3.0 * t**2 + 1.0) * points[:, :, None]
        + (t**3 - 2.0 * t**2 + t) * start[:, :, None]
        + (3.0 * t**2 - 2.0 * t**3) * after[:, :, None]
        + (t**3 - t**2) * end[:, :, None]
    )
    return curves.reshape(len(points), -1, 3)


def rim_measures(rims: FloatArray) -> RimMeasures:
    """Return the sizes of an opening from its rim (N, n, 3) in mm, a polygon in order."""
    points = np.asarray(rims, dtype=np.float64)
    start = points.mean(axis=1, keepdims=True)
    offsets = points - start
    after = np.roll(offsets, -1, axis=1)
    vector = 0.5 * np.cross(offsets, after).sum(axis=1)  # (N, 3)
    area = np.linalg.norm(vector, axis=1)
    across, up = _plane(vector)  # (N, 3) each
    x, y = np.einsum("npi,ni->np", offsets, across), np.einsum("npi,ni->np", offsets, up)
    xn, yn = np.roll(x, -1, axis=1), np.roll(y, -1, axis=1)
    twice = x * yn - xn * y  # (N, n) twice the areas of the triangles with the mean
    size = np.where(twice.sum(axis=1) > 0.0, twice.sum(axis=1), 1.0)
    cx, cy = ((u + un) * twice / 3.0 for u, un in ((x, xn), (y, yn)))
    cx, cy = cx.sum(axis=1) / size, cy.sum(axis=1) / size
    xx = ((x * x + x * xn + xn * xn) * twice).sum(axis=1) / 6.0 / size - cx**2
    yy = ((y * y + y * yn + yn * yn) * twice).sum(axis=1) / 6.0 / size - cy**2
    xy = ((2.0 * (x * y + xn * yn) + x * yn + xn * y) * twice).sum(axis=1) / 12.0 / size - cx * cy
    mid, half = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    return RimMeasures(
        area=area,
        perimeter=np.linalg.norm(after - offsets, axis=2).sum(axis=1),
        diameter_max=4.0 * np.sqrt(np.maximum(mid + half, 0.0)),
        diameter_min=4.0 * np.sqrt(np.maximum(mid - half, 0.0)),
        centre=start[:, 0] + cx[:, None] * across + cy[:, None] * up,
    )


def surface_sizes(parts: Mapping[str, Surface]) -> dict[str, float]:
    """Return the sizes of a shape's own meshes, by the names that `clinical_measures` gives.

    Volumes in ml, areas of openings in mm^2 and their perimeters in mm.

    Parameters
    ----------
    parts : mapping of str to Surface
        With all their openings named.
    """
    sizes = {}
    for part, surface in parts.items():
        loops = list(surface.loops.values())
        (volume,) = enclosed_volumes(surface.vertices[None], surface.faces, loops)
        sizes[f"{part}{VOLUME}"] = float(volume) / MM3_PER_ML
        for ostium, loop in surface.loops.items():
            rim = rim_measures(surface.vertices[loop][None])
            sizes[f"{part}_{ostium}_area_mm2"] = float(rim.area[0])
            sizes[f"{part}_{ostium}_perimeter_mm"] = float(rim.perimeter[0])
    return sizes


def long_axes(points: FloatArray, mesh: ModelMesh) -> dict[str, LongAxis]:
    """Return the long axis of every part that has an opening, found on the mean shape.

    Parameters
    ----------
    points : (N, P, 3) float64, mm
        All shapes, aligned; their mean is looked at.
    mesh : ModelMesh
    """
    mean = np.asarray(points, dtype=np.float64).mean(axis=0)
    axes = {}
    for index, part in enumerate(mesh.parts):
        loops = {n: loop for n, loop in mesh.loops.items() if n.startswith(f"{part}.")}
        own = np.unique(mesh.faces[mesh.face_part == index])
        if loops and len(own):
            measures = {n: rim_measures(rim_curves(mean[loop][None])) for n, loop in loops.items()}
            annulus = max(measures, key=lambda name: float(measures[name].perimeter[0]))
            away = np.linalg.norm(mean[own] - measures[annulus].centre[0], axis=1)
            axes[part] = LongAxis(annulus, int(own[away.argmax()]))
    return axes


def clinical_measures(
    points: FloatArray, mesh: ModelMesh, axes: Mapping[str, LongAxis]
) -> dict[str, FloatArray]:
    """Return the clinical numbers of one heart's phases, by column name.

    Parameters
    ----------
    points : (T, P, 3) float64, mm
        All phases of one heart, in one frame and not scaled: of a subject, or made by a model.
    mesh : ModelMesh
    axes : mapping of part to LongAxis
        Of the population (`long_axes`).

    Returns
    -------
    columns : dict of str to (T,) float64
        The name ends with the unit: ``ml``, ``mm``, ``mm2``, ``percent`` or ``deg``. Of one phase
        there is no motion; a part that is named as a wall (epicardium, myocardium) ejects nothing.
    """
    shapes = np.asarray(points, dtype=np.float64)
    columns: dict[str, FloatArray] = {}
    rims = {name: rim_measures(rim_curves(shapes[:, loop])) for name, loop in mesh.loops.items()}
    for part, volumes in part_volumes(shapes, mesh).items():
        reference = int(volumes.argmax())
        ejected = 100.0 * (1.0 - volumes / volumes[reference])
        columns[f"{part}{VOLUME}"] = volumes / MM3_PER_ML
        moves = len(shapes) > 1
        if moves and not WALLS.search(part):
            columns[f"{part}_ejected_percent"] = ejected
            columns[f"{part}_ejection_fraction_percent"] = np.full(len(shapes), ejected.max())
        if part in axes:
            own = np.unique(mesh.faces[mesh.face_part == mesh.parts.index(part)])
            base, apex = rims[axes[part].annulus].centre, shapes[:, axes[part].apex]
            length = np.linalg.norm(apex - base, axis=1)
            columns[f"{part}_long_axis_mm"] = length
            if moves:
                shortening = 100.0 * (1.0 - length / length[reference])
                columns[f"{part}_long_axis_shortening_percent"] = shortening
                faces = np.searchsorted(own, mesh.faces[mesh.face_part == mesh.parts.index(part)])
                twist = twist_angles(shapes[:, own], faces, base, apex, reference)
                columns[f"{part}_twist_deg"] = np.degrees(twist)
        for name, rim in rims.items():
            if name.startswith(f"{part}."):
                label = name.replace(".", "_")
                columns[f"{label}_area_mm2"] = rim.area
                columns[f"{label}_perimeter_mm"] = rim.perimeter
                columns[f"{label}_diameter_max_mm"] = rim.diameter_max
                columns[f"{label}_diameter_min_mm"] = rim.diameter_min
    return columns


def twist_angles(
    points: FloatArray, faces: IntArray, base: FloatArray, apex: FloatArray, reference: int
) -> FloatArray:
    """Return how far the end near the apex has turned against the one near the base, radians.

    Parameters
    ----------
    points : (T, Q, 3) float64, mm
        One part of one heart.
    faces : (F, 3) int64
    base, apex : (T, 3) float64, mm
        Ends of the long axis.
    reference : int
        The phase against which the others are turned.
    """
    axis = (apex - base) / np.linalg.norm(apex - base, axis=1, keepdims=True)  # (T, 3)
    heights = (points[reference] - base[reference]) @ axis[reference]  # (Q,)
    low, high = heights.min(), heights.max()
    areas = vertex_areas(points[reference], faces)
    first, _ = _plane(axis[reference][None])
    # Axes of the cross-section that turn with the long axis by the smallest rotation.
    across = first - np.einsum("ti,ki->tk", axis, first) * axis
    across = across / np.linalg.norm(across, axis=1, keepdims=True)
    up = np.cross(axis, across)
    turns = []
    for chosen in (heights >= high - THIRD * (high - low), heights <= low + THIRD * (high - low)):
        slab = points[:, chosen]
        middle = np.average(slab, axis=1, weights=areas[chosen])[:, None]
        offsets = slab - middle
        z = np.einsum("tqi,ti->tq", offsets, across) + 1j * np.einsum("tqi,ti->tq", offsets, up)
        turns.append(np.angle((np.conj(z[reference]) * z) @ areas[chosen]))
    twist: FloatArray = np.angle(np.exp(1j * (turns[0] - turns[1])))
    return twist


def clinical_table(
    ids: Sequence[ShapeId], points: FloatArray, aligned: FloatArray, mesh: ModelMesh
) -> ClinicalTable:
    """Return the clinical numbers of all shapes of a population.

    Parameters
    ----------
    ids : (N,) sequence of ShapeId
    points : (N, P, 3) float64, mm
        In coordinates that were not scaled; the phases of a subject in one frame.
    aligned : (N, P, 3) float64, mm
        Gives the mean on which annulus and apex are found.
    mesh : ModelMesh
    """
    shapes = frozen_floats(points, (len(ids), len(mesh.part), 3), "points of shapes")
    axes = long_axes(aligned, mesh)
    subjects = np.array([id.subject for id in ids])
    found = {
        subject: clinical_measures(shapes[subjects == subject], mesh, axes)
        for subject in dict.fromkeys(subjects.tolist())
    }
    columns = max((tuple(own) for own in found.values()), key=len, default=())
    stacked = np.full((len(ids), len(columns)), np.nan)
    for subject, own in found.items():
        for index, name in enumerate(columns):
            if name in own:
                stacked[subjects == subject, index] = own[name]
    return ClinicalTable(tuple(ids), columns, stacked)


def _plane(normals: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return two unit vectors (N, 3) that make a right-handed frame with normals (N, 3)."""
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    unit = normals / np.where(length > 0.0, length, 1.0)
    helper = np.eye(3)[np.abs(unit).argmin(axis=1)]
    across = np.cross(helper, unit)
    size = np.linalg.norm(across, axis=1, keepdims=True)
    across = across / np.where(size > 0.0, size, 1.0)
    return across, np.cross(unit, across)
