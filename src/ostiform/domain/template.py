"""The template: one triangulation of the base domain for every shape (end of HY 2.2)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.domain.delaunay import (
    GradedPoints,
    SizingFunction,
    graded_points,
    sizing_field,
)
from ostiform.domain.types import BaseDomain, Circle, Sphere, Template
from ostiform.errors import InputError
from ostiform.surface import Seam, split_ostium_name

FEWEST_RIM_POINTS = 6
USUAL_RIM_POINTS = 16


@dataclass(frozen=True, slots=True)
class TriangleQuality:
    """How near a triangulation is to equilateral triangles.

    The quality of a triangle is ``4 sqrt(3) area / (sum of squared edges)``: 1 for an equilateral
    triangle, 0 for a degenerate one.

    Attributes
    ----------
    worst, mean : float
        Smallest and mean quality.
    min_angle, mean_min_angle : float
        Smallest angle of all triangles, and mean over triangles of each one's smallest, degrees.
    """

    worst: float
    mean: float
    min_angle: float
    mean_min_angle: float


def triangle_quality(points: FloatArray, faces: IntArray) -> TriangleQuality:
    """Return the quality of triangles, of a template on the sphere or of a surface.

    Parameters
    ----------
    points : (n, 3) float64
    faces : (F, 3) int64

    Raises
    ------
    InputError
        If there is no triangle.
    """
    if len(faces) == 0:
        raise InputError("faces: expected at least one triangle, found none")
    corners = points[faces]  # (F, 3, 3)
    to_next = np.roll(corners, -1, axis=1) - corners
    to_previous = np.roll(corners, 1, axis=1) - corners
    doubled = np.linalg.norm(np.cross(to_next, to_previous), axis=2)  # (F, 3), twice the area
    squared = np.einsum("fki,fki->f", to_next, to_next)
    angles = np.degrees(np.arctan2(doubled, np.einsum("fki,fki->fk", to_next, to_previous)))
    quality = np.where(
        squared > 0, 2.0 * np.sqrt(3.0) * doubled[:, 0] / np.where(squared > 0, squared, 1.0), 0.0
    )
    smallest = angles.min(axis=1)
    return TriangleQuality(
        worst=float(quality.min()),
        mean=float(quality.mean()),
        min_angle=float(smallest.min()),
        mean_min_angle=float(smallest.mean()),
    )


def graded_template(
    domain: BaseDomain,
    n_points: int,
    sizing: Sequence[SizingFunction] | None = None,
    rim_counts: Mapping[str, int] | None = None,
    *,
    iterations: int = 30,
    seed: int = 0,
) -> Template:
    """Return a graded, nearly equilateral Delaunay triangulation of the base domain.

    Points lie exactly on the circles, evenly by angle; interior points are spread by optimal
    Delaunay smoothing, with edges that grow from the spacing of the rims by at most a quarter of
    the distance from them.

    Parameters
    ----------
    domain : BaseDomain
    n_points : int
        Points in all, on every sphere together.
    sizing : sequence of callable, optional
        One per sphere: relative edge length (n,) at directions (n, 3). Constant if absent.
    rim_counts : mapping of str to int, optional
        Points on a curve, by the names of `Sphere.curves`. Curves not named get what the sizes
        ask for, and at least 16 (6 where few points are to be had).
    iterations : int
        Smoothing steps.
    seed : int
        Of the random start.

    Returns
    -------
    Template
        Exactly `n_points` points, no coarser levels.

    Raises
    ------
    InputError
        If a named curve does not exist, has fewer than three points, the sizes are not positive,
        or the points do not suffice for the curves.
    """
    rim_counts = {} if rim_counts is None else rim_counts
    names = curve_names(domain)
    for name, count in rim_counts.items():
        if name not in names:
            raise InputError(
                f"rim counts: expected one of {', '.join(names) or 'no curve'}, found {name}"
            )
        if count < 3:
            raise InputError(f"rim counts: expected at least 3 points on {name}, found {count}")
    if sizing is not None and len(sizing) != len(domain.spheres):
        raise InputError(
            f"sizing: expected one function per sphere ({len(domain.spheres)}), found {len(sizing)}"
        )
    fewest = int(np.clip(n_points / (8 * max(len(names), 1)), FEWEST_RIM_POINTS, USUAL_RIM_POINTS))
    pieces = []
    for index, sphere in enumerate(domain.spheres):
        share = _share(n_points, index, len(domain.spheres))
        circles = list(sphere.curves.values())
        is_rim = [name in sphere.rims for name in sphere.curves]
        wanted = [rim_counts.get(name) for name in sphere.curves]
        field, counts = sizing_field(
            circles, is_rim, wanted, share, None if sizing is None else sizing[index], fewest
        )
        pieces.append(graded_points(circles, is_rim, counts, share, field, iterations, seed))
    return _joined(domain, pieces)


def curve_names(domain: BaseDomain) -> tuple[str, ...]:
    """Return the names of every circle of the domain: sphere by sphere, rims, then seams."""
    return tuple(name for sphere in domain.spheres for name in sphere.curves)


def assembled_template(
    domain: BaseDomain, points: FloatArray, sphere: IntArray, curve: IntArray, faces: IntArray
) -> Template:
    """Return the template of a given triangulation, its parts and loops read off the circles.

    Parameters
    ----------
    domain : BaseDomain
    points : (P, 3) float64
        Unit vectors.
    sphere : (P,) int64
    curve : (P,) int64
        Index into `curve_names` of the circle a point lies on, -1 in the interior.
    faces : (F, 3) int64
        Positively oriented; every edge of a curve is an edge of the triangulation.

    Returns
    -------
    Template
    """
    names = curve_names(domain)
    parts = tuple(part for one in domain.spheres for part in one.parts)
    part = np.zeros(len(points), dtype=np.int64)
    face_part = np.zeros(len(faces), dtype=np.int64)
    offset = 0
    loops: dict[str, IntArray] = {}
    for index, one in enumerate(domain.spheres):
        own = sphere == index
        part[own] = offset + _parts_inside(one, points[own])
        own_faces = own[faces[:, 0]]
        face_part[own_faces] = offset + face_parts(one, points, faces[own_faces])
        for name, circle in one.rims.items():
            loop = _loop(points, np.flatnonzero(curve == names.index(name)), circle)
            loops[name] = loop
            part[loop] = offset + one.parts.index(split_ostium_name(name)[0])
        for seam, circle in one.seams.items():
            loop = _loop(points, np.flatnonzero(curve == names.index(seam.first)), circle)
            loops[seam.first] = loop
            loops[seam.second] = np.concatenate([loop[:1], loop[:0:-1]])
            part[loop] = offset + one.parts.index(split_ostium_name(seam.first)[0])
        offset += len(one.parts)
    return Template(
        points=points,
        sphere=sphere,
        part=part,
        faces=faces,
        face_part=face_part,
        parts=parts,
        curve=curve,
        curves=names,
        loops=loops,
    )


def face_parts(sphere: Sphere, points: FloatArray, faces: IntArray) -> IntArray:
    """Return the part (F,) of each face, an index into ``sphere.parts``.

    A face belongs to the part inside the smallest seam circle around it; outside every seam it
    belongs to the first part of the widest. Faces may touch a seam but not cross it.
    """
    # The corners of a face lie on one side of the plane of each seam's circle, hence so does the
    # flat centroid: no projection to the sphere, which could carry it across.
    return _parts_inside(sphere, points[faces].mean(axis=1))


def _parts_inside(sphere: Sphere, points: FloatArray) -> IntArray:
    part = np.full(len(points), _outer_part(sphere), dtype=np.int64)
    for seam, circle in _widest_first(sphere):
        inside = points @ circle.center > np.cos(circle.radius)
        part[inside] = sphere.parts.index(split_ostium_name(seam.second)[0])
    return part


def _widest_first(sphere: Sphere) -> list[tuple[Seam, Circle]]:
    return sorted(sphere.seams.items(), key=lambda item: -item[1].radius)


def _outer_part(sphere: Sphere) -> int:
    inner = {split_ostium_name(seam.second)[0] for seam in sphere.seams}
    for seam, _ in _widest_first(sphere):
        first = split_ostium_name(seam.first)[0]
        if first not in inner or first == split_ostium_name(seam.second)[0]:
            return sphere.parts.index(first)
    return 0


def _loop(points: FloatArray, on_curve: IntArray, circle: Circle) -> IntArray:
    # A rim has the surface on its left when it runs with decreasing angle (see Circle). Angles are
    # taken from the phase and rounded, so that the start does not depend on a last digit.
    angles = np.mod(circle.phase - circle.angles(points[on_curve]), 2.0 * np.pi)
    angles = np.mod(np.round(angles, 9), np.round(2.0 * np.pi, 9))
    return on_curve[np.argsort(angles, kind="stable")]


def _share(n_points: int, index: int, count: int) -> int:
    return n_points * (index + 1) // count - n_points * index // count


def _joined(domain: BaseDomain, pieces: Sequence[GradedPoints]) -> Template:
    points, sphere, curve, faces = [], [], [], []
    n_points = n_curves = 0
    for index, piece in enumerate(pieces):
        points.append(piece.points)
        sphere.append(np.full(len(piece.points), index, dtype=np.int64))
        curve.append(np.where(piece.curve >= 0, piece.curve + n_curves, -1))
        faces.append(piece.faces + n_points)
        n_points += len(piece.points)
        n_curves += len(domain.spheres[index].curves)
    return assembled_template(
        domain,
        np.concatenate(points),
        np.concatenate(sphere),
        np.concatenate(curve),
        np.concatenate(faces),
    )
