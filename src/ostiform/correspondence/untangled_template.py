"""Removal of the few triangles of a template that are flipped in the domain (design 4).

Vertices carried back from a remeshed surface to the domain keep their triangles; where the map is
steep a chord cuts a corner and one triangle in a thousand turns over.
"""

from collections.abc import Sequence

import numpy as np

from ostiform.arrays import BoolArray, FloatArray, IntArray
from ostiform.compiled import kernel
from ostiform.domain import Circle, cleared_of_circles, spherical_delaunay, without_caps
from ostiform.surface import count_flipped, exact_orientations, twin_half_edges

ROUNDS = 10
SWEEPS = 10
"""Of the search for better positions, in each round."""

SOUND = 0.15
"""Signed quality (1 for an equilateral triangle) above which a triangle is left alone: thinner
ones would be the first to turn over under a warp."""


def fold_free_triangulation(
    points: FloatArray,
    faces: IntArray,
    curve: IntArray,
    circles: Sequence[Circle],
    is_rim: Sequence[bool],
) -> tuple[FloatArray, IntArray]:
    """Return points and triangles on the sphere without flipped or degenerate triangles.

    Edges of flipped triangles are flipped where that makes both triangles positive; then interior
    vertices of flipped and very thin triangles move to where the worst triangle round them is
    best. If flipped ones remain, the spherical Delaunay triangulation of the points, kept clear of
    the circles, replaces the triangles.

    Parameters
    ----------
    points : (n, 3) float64
        Unit vectors.
    faces : (F, 3) int64
    curve : (n,) int64
        Index of the circle a point is on, -1 in the interior.
    circles : sequence of Circle
    is_rim : sequence of bool

    Returns
    -------
    points : (n, 3) float64
        Points on circles are unchanged.
    faces : (F, 3) int64
    """
    free = curve < 0
    # Off the sliver between a chord and the arc of a rim, and off the seams.
    apart = [0.01 * circle.radius for circle in circles]
    moved = points.copy()
    moved[free] = cleared_of_circles(points[free], circles, is_rim, apart)
    for _ in range(ROUNDS):
        faces = _with_edges_flipped(moved, faces, curve)
        bad = _signed_quality(moved, faces) < SOUND
        chosen = np.unique(faces[bad])
        moved = _spread(moved, faces, chosen[free[chosen]], SWEEPS)
        moved[free] = cleared_of_circles(moved[free], circles, is_rim, apart)
        if count_flipped(moved, faces) == 0:
            return moved, faces
    return _delaunay(points, curve, circles, is_rim)


def _delaunay(
    points: FloatArray, curve: IntArray, circles: Sequence[Circle], is_rim: Sequence[bool]
) -> tuple[FloatArray, IntArray]:
    spacings = [
        2.0 * np.pi * np.sin(circle.radius) / max(int((curve == index).sum()), 1)
        for index, circle in enumerate(circles)
    ]
    cleared = points.copy()
    cleared[curve < 0] = cleared_of_circles(points[curve < 0], circles, is_rim, spacings)
    rims = np.flatnonzero(np.array(is_rim, dtype=np.bool_))
    return cleared, without_caps(spherical_delaunay(cleared), curve, rims)


def _with_edges_flipped(points: FloatArray, faces: IntArray, curve: IntArray) -> IntArray:
    # A vertex that has crossed the opposite edge of its triangle lies in the triangle beyond:
    # joining it to that triangle's far corner makes two positive ones.
    new = faces.copy()
    twins = twin_half_edges(new, len(points))
    touched = np.zeros(len(faces), dtype=np.bool_)
    for face in np.flatnonzero(exact_orientations(points, faces) <= 0).tolist():
        for corner in range(3):
            twin = int(twins[3 * face + corner])
            beyond = twin // 3
            if twin < 0 or touched[face] or touched[beyond]:
                continue
            a, b, c = (int(new[face, (corner + k) % 3]) for k in range(3))
            d = int(new[beyond, (twin % 3 + 2) % 3])
            if not _may_flip(new, curve, a, b, c, d):
                continue
            pair = np.array([[a, d, c], [d, b, c]], dtype=np.int64)
            if (exact_orientations(points, pair) > 0).all():
                new[face], new[beyond] = pair
                touched[face] = touched[beyond] = True
    return new


def _may_flip(faces: IntArray, curve: IntArray, a: int, b: int, c: int, d: int) -> bool:
    if curve[a] >= 0 and curve[b] >= 0:  # an edge of a rim or a seam
        return False
    if curve[c] >= 0 and curve[d] >= 0:  # would join two curve vertices
        return False
    joined: BoolArray = (faces == c).any(axis=1) & (faces == d).any(axis=1)
    return not joined.any()


def _signed_quality(points: FloatArray, faces: IntArray) -> FloatArray:
    a, b, c = (points[faces[:, corner]] for corner in range(3))
    return np.array(_triangle_qualities(a, b, c))


@kernel
def _triangle_qualities(a: FloatArray, b: FloatArray, c: FloatArray) -> FloatArray:
    qualities = np.empty(len(a))
    for f in range(len(a)):
        qualities[f] = _quality(a[f], b[f], c[f])
    return qualities


@kernel
def _quality(a: FloatArray, b: FloatArray, c: FloatArray) -> float:
    # 2 sqrt(3) det(a, b, c) / (sum of squared edges): 1 for a small equilateral triangle.
    u, v = b - a, c - a
    determinant = (
        a[0] * (u[1] * v[2] - u[2] * v[1])
        + a[1] * (u[2] * v[0] - u[0] * v[2])
        + a[2] * (u[0] * v[1] - u[1] * v[0])
    )
    w = v - u
    squared = (u * u).sum() + (v * v).sum() + (w * w).sum()
    return float(2.0 * np.sqrt(3.0) * determinant / squared) if squared > 0.0 else 0.0


@kernel
def _worst_quality(points: FloatArray, faces: IntArray, around: IntArray, n: int) -> float:
    worst = 2.0
    for i in range(n):
        f = faces[around[i]]
        worst = min(worst, _quality(points[f[0]], points[f[1]], points[f[2]]))
    return worst


@kernel
def _spread(points: FloatArray, faces: IntArray, chosen: IntArray, sweeps: int) -> FloatArray:
    # Pattern search, vertex by vertex: steps in eight directions, from half the mean distance of
    # the neighbours down to a sixty-fourth, each accepted if the worst triangle improves.
    moved = points.copy()
    around = np.empty(len(faces), np.int64)
    for _ in range(sweeps):
        for v in chosen:
            n = 0
            reach = 0.0
            for f in range(len(faces)):
                for k in range(3):
                    if faces[f, k] == v:
                        around[n] = f
                        n += 1
                        edge = moved[faces[f, (k + 1) % 3]] - moved[v]
                        reach += np.sqrt((edge * edge).sum())
            best = _worst_quality(moved, faces, around, n)
            here = moved[v].copy()
            e1 = np.zeros(3)
            e1[np.argmin(np.abs(here))] = 1.0
            e1 -= (e1 * here).sum() * here
            e1 /= np.sqrt((e1 * e1).sum())
            e2 = np.cross(here, e1)
            step = 0.5 * reach / max(n, 1)
            for _ in range(6):
                origin = moved[v].copy()
                found = origin
                for direction in range(8):
                    angle = 0.25 * np.pi * direction
                    trial = origin + step * (np.cos(angle) * e1 + np.sin(angle) * e2)
                    moved[v] = trial / np.sqrt((trial * trial).sum())
                    quality = _worst_quality(moved, faces, around, n)
                    if quality > best:
                        best = quality
                        found = moved[v].copy()
                moved[v] = found
                step *= 0.5
    return moved
