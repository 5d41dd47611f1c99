"""Spherical Delaunay triangulations and their smoothing (end of HY 2.2, design 4).

On the sphere the Delaunay triangulation is the convex hull. A circle is planar, so the polygon of
points on a rim, with nothing inside, is one facet of the hull: rims are edges of every Delaunay
triangulation. A seam has points on both sides; its edges are there because no point is allowed
nearer to it than half its spacing (inside the ball on an edge as diameter).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, cKDTree

from ostiform.arrays import BoolArray, FloatArray, IntArray
from ostiform.domain.types import Circle
from ostiform.errors import InputError
from ostiform.surface import (
    normalised,
    spherical_areas,
    spherical_fibonacci,
)

SizingFunction = Callable[[FloatArray], FloatArray]
"""Directions (n, 3) to relative edge lengths (n,), positive."""

CLEARANCE = 0.52
"""Least distance of interior points from a curve, relative to its spacing: above one half, which
keeps every edge of the curve in the Delaunay triangulation."""

GRADATION = 0.25
"""How much edges may lengthen per unit of distance from a rim."""

WIDEST_ANGLE = 85.0
"""Triangles with a wider angle, degrees, are represented by their centroid: the circumcentre
lies near or beyond their longest edge."""


@dataclass(frozen=True, slots=True, eq=False)
class SizingField:
    """Absolute edge lengths tabulated on the sphere, and what they add up to.

    Attributes
    ----------
    tree : scipy.spatial.cKDTree
        Of the nodes (M, 3).
    sizes : (M,) float64
        Edge length in radians.
    is_inside : (M,) bool
        Whether the node is in the domain, outside every rim.
    """

    tree: cKDTree
    sizes: FloatArray
    is_inside: BoolArray


@dataclass(frozen=True, slots=True, eq=False)
class GradedPoints:
    """Points on one sphere with their Delaunay triangulation.

    Attributes
    ----------
    points : (n, 3) float64
    curve : (n,) int64
        Index of the circle a point lies on, -1 in the interior.
    faces : (F, 3) int64
        Without the caps inside the rims.
    """

    points: FloatArray
    curve: IntArray
    faces: IntArray


def spherical_delaunay(points: FloatArray) -> IntArray:
    """Return the Delaunay triangulation of unit vectors, positively oriented.

    Parameters
    ----------
    points : (n, 3) float64
        At least four, not all in one plane.

    Returns
    -------
    faces : (F, 3) int64
        All around, the insides of rims included: see `without_caps`.

    Raises
    ------
    InputError
        If there are too few points, or some are so close that the hull drops them.
    """
    if len(points) < 4:
        raise InputError(f"points: expected at least 4 on the sphere, found {len(points)}")
    hull = ConvexHull(points)
    faces: IntArray = hull.simplices.astype(np.int64)
    if len(hull.vertices) < len(points):
        raise InputError(
            f"points: expected {len(points)} distinct points on the sphere, found "
            f"{len(points) - len(hull.vertices)} that coincide with others"
        )
    # The hull's outward plane tells the orientation, also of caps seen edge on from the centre.
    corners = points[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.einsum("fi,fi->f", normals, hull.equations[:, :3]) < 0
    faces[inward] = faces[inward][:, ::-1]
    return np.ascontiguousarray(faces)


def without_caps(faces: IntArray, curve: IntArray, rims: IntArray) -> IntArray:
    """Return the faces without those that lie inside a rim (all three corners on one rim).

    Parameters
    ----------
    faces : (F, 3) int64
    curve : (n,) int64
        Circle of each point, -1 in the interior.
    rims : (r,) int64
        The circles that are rims; a seam's inside belongs to the domain.
    """
    on = curve[faces]  # (F, 3)
    cap = (on[:, 0] == on[:, 1]) & (on[:, 0] == on[:, 2]) & np.isin(on[:, 0], rims)
    return np.ascontiguousarray(faces[~cap])


def circle_distances(points: FloatArray, circle: Circle) -> FloatArray:
    """Return the signed angular distance (n,) of unit vectors from a circle, positive outside."""
    across = np.linalg.norm(np.cross(points, circle.center), axis=1)
    distances: FloatArray = np.arctan2(across, points @ circle.center) - circle.radius
    return distances


def sizing_field(
    circles: Sequence[Circle],
    is_rim: Sequence[bool],
    counts: Sequence[int | None],
    n_points: float,
    sizing: SizingFunction | None,
    fewest: int,
) -> tuple[SizingField, list[int]]:
    """Return absolute edge lengths that give a number of points, graded towards the curves.

    Parameters
    ----------
    circles : sequence of Circle
    is_rim : sequence of bool
        Whether the inside of each circle is a hole.
    counts : sequence of int or None
        Points on each circle; None for as many as the sizes ask for.
    n_points : float
        Points on the whole sphere, those on the circles included.
    sizing : callable or None
        Relative edge lengths; None for constant.
    fewest : int
        Least number of points on a circle.

    Returns
    -------
    field : SizingField
    counts : list of int
        Points on each circle.
    """
    n_nodes = max(20_000, int(10 * n_points))
    nodes = spherical_fibonacci(n_nodes)
    inside = np.ones(n_nodes, dtype=np.bool_)
    distances = [circle_distances(nodes, circle) for circle in circles]
    for distance, hole in zip(distances, is_rim, strict=True):
        if hole:
            inside &= distance > 0
    relative = np.ones(n_nodes) if sizing is None else np.asarray(sizing(nodes), dtype=np.float64)
    if relative.shape != (n_nodes,) or not (np.isfinite(relative).all() and (relative > 0).all()):
        raise InputError("sizing: expected one positive number per direction, found others")
    cell = 4.0 * np.pi / n_nodes
    sizes = relative
    chosen = [count or fewest for count in counts]
    for _ in range(6):  # the scale, the counts and the gradation depend on each other
        scale = _scale(sizes[inside], cell, n_points, circles, chosen)
        sizes = relative * scale
        for k, circle in enumerate(circles):
            given = counts[k]
            if given is None:
                near = np.argsort(np.abs(distances[k]))[:32]
                around = 2.0 * np.pi * np.sin(circle.radius)
                wanted = round(around / float(sizes[near].mean()))
                chosen[k] = max(fewest, wanted)
            else:
                chosen[k] = given
            spacing = 2.0 * np.pi * np.sin(circle.radius) / chosen[k]
            sizes = np.minimum(sizes, spacing + GRADATION * np.abs(distances[k]))
        relative = sizes
    return SizingField(cKDTree(nodes), sizes, inside), chosen


def _scale(
    sizes: FloatArray, cell: float, n_points: float, circles: Sequence[Circle], counts: list[int]
) -> float:
    # An equilateral triangulation of edge h has 2 / (sqrt(3) h^2) points per area; half of the
    # triangles' share of a boundary point lies beyond the boundary, hence the circles' half.
    wanted = max(n_points - 0.5 * sum(counts[: len(circles)]), 4.0)
    return float(np.sqrt((2.0 / np.sqrt(3.0) / sizes**2).sum() * cell / wanted))


def size_at(field: SizingField, directions: FloatArray) -> FloatArray:
    """Return the edge length (n,) in radians at unit vectors, that of the nearest node."""
    sizes: FloatArray = field.sizes[field.tree.query(directions)[1]]
    return sizes


def graded_points(
    circles: Sequence[Circle],
    is_rim: Sequence[bool],
    counts: Sequence[int],
    n_points: int,
    field: SizingField,
    iterations: int,
    seed: int,
) -> GradedPoints:
    """Return well spread points on one sphere, exactly evenly on its circles.

    Optimal Delaunay triangulation smoothing (Chen & Holst 2011): every interior point moves to
    the mean of the circumcentres of its triangles, weighted by area over edge length to the
    fourth, and the triangulation is built anew.

    Parameters
    ----------
    circles, is_rim, counts
        The circles, whether their inside is a hole, and how many points lie on each.
    n_points : int
        Points in all.
    field : SizingField
    iterations : int
    seed : int
        Of the random start.

    Raises
    ------
    InputError
        If the circles alone need more points than there are.
    """
    n_fixed = sum(counts)
    n_free = n_points - n_fixed
    if n_free < max(4 - n_fixed, 1):
        raise InputError(
            f"template: expected more points than the {n_fixed} on the circles of the openings "
            f"and seams, found {n_points}: ask for more points or fewer on each rim"
        )
    on_circles = [
        circle.points(circle.phase + 2.0 * np.pi * np.arange(count) / count)
        for circle, count in zip(circles, counts, strict=True)
    ]
    curve = np.concatenate(
        [np.repeat(np.arange(len(circles)), counts), np.full(n_free, -1)]
    ).astype(np.int64)
    rims = np.flatnonzero(np.array(is_rim, dtype=np.bool_))
    spacings = [
        2.0 * np.pi * np.sin(c.radius) / count for c, count in zip(circles, counts, strict=True)
    ]
    free = _random_start(circles, spacings, field, n_free, np.random.default_rng(seed))
    points = np.concatenate([*on_circles, free])
    for _ in range(iterations):
        faces = without_caps(spherical_delaunay(points), curve, rims)
        points[n_fixed:] = _smoothed(points, faces, field)[n_fixed:]
        points[n_fixed:] = cleared_of_circles(points[n_fixed:], circles, is_rim, spacings)
    faces = without_caps(spherical_delaunay(points), curve, rims)
    return GradedPoints(points, curve, faces)


def cleared_of_circles(
    points: FloatArray,
    circles: Sequence[Circle],
    is_rim: Sequence[bool],
    spacings: Sequence[float],
) -> FloatArray:
    """Return points (n, 3) moved away from circles to `CLEARANCE` times their spacing.

    Points near a seam stay on their side; points in a hole come out of it.
    """
    moved = points.copy()
    for circle, hole, spacing in zip(circles, is_rim, spacings, strict=True):
        distance = circle_distances(moved, circle)
        clearance = min(CLEARANCE * spacing, 0.5 * circle.radius)
        near = (distance < clearance) if hole else (np.abs(distance) < clearance)
        if not near.any():
            continue
        side = np.ones(int(near.sum())) if hole else np.where(distance[near] < 0, -1.0, 1.0)
        angle = circle.radius + side * clearance
        axial = moved[near] @ circle.center
        outwards = normalised(moved[near] - axial[:, None] * circle.center)
        moved[near] = np.cos(angle)[:, None] * circle.center + np.sin(angle)[:, None] * outwards
    return moved


def _random_start(
    circles: Sequence[Circle],
    spacings: Sequence[float],
    field: SizingField,
    n_free: int,
    rng: np.random.Generator,
) -> FloatArray:
    nodes = np.asarray(field.tree.data, dtype=np.float64)
    usable = field.is_inside.copy()
    for circle, spacing in zip(circles, spacings, strict=True):
        clearance = min(CLEARANCE * spacing, 0.5 * circle.radius)
        usable &= np.abs(circle_distances(nodes, circle)) > clearance
    if usable.sum() < n_free:
        raise InputError(
            f"template: expected room for {n_free} points between the circles, found room for "
            f"{int(usable.sum())}: the circles leave too little of the sphere"
        )
    density = usable / field.sizes**2
    chosen = rng.choice(len(nodes), n_free, replace=False, p=density / density.sum())
    free: FloatArray = nodes[np.sort(chosen)]
    return free


def _smoothed(points: FloatArray, faces: IntArray, field: SizingField) -> FloatArray:
    corners = points[faces]  # (F, 3, 3)
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    centroids = normalised(corners.mean(axis=1))
    circumcentres = normalised(np.cross(b - a, c - a))  # outwards: faces are positively oriented
    edges = np.stack([c - b, a - c, b - a], axis=1)  # (F, 3, 3), opposite the corners
    squared = np.einsum("fki,fki->fk", edges, edges)
    longest = squared.max(axis=1)
    others = squared.sum(axis=1) - longest
    product = np.sqrt(squared.prod(axis=1) / longest)
    widest_cosine = (others - longest) / (2.0 * product)  # (F,)
    narrow = widest_cosine > np.cos(np.radians(WIDEST_ANGLE))
    centres = np.where(narrow[:, None], circumcentres, centroids)  # (F, 3)
    weights = np.abs(spherical_areas(points, faces)) / size_at(field, centroids) ** 4
    corner = faces.ravel()
    moved = points.copy()
    total = np.bincount(corner, np.repeat(weights, 3), minlength=len(points))
    used = total > 0
    sums: FloatArray = np.stack(
        [np.bincount(corner, np.repeat(weights * centres[:, d], 3), len(points)) for d in range(3)],
        axis=1,
    )  # (n, 3)
    moved[used] = normalised(sums[used])
    return moved
