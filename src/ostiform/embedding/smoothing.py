"""Constrained Laplacian smoothing on the sphere with a quality metric (HY eq. 2).

A free vertex moves to the centre of its neighbours only if the quality of its sub-mesh, the least
quality of the triangles round it, improves. The quality of a triangle (Canann et al. 1998) is 1
for an equilateral triangle, 0 for a degenerate one and negative for an inverted one ::

    alpha = I 2 sqrt(3) |(x2 - x0) x (x1 - x0)| / (|x2 - x0|^2 + |x0 - x1|^2 + |x1 - x2|^2)

with I = +1 where the triangle's normal agrees with the sphere's at its centre, else -1.
"""

from typing import Annotated

import numpy as np

from ostiform.arrays import BoolArray, FloatArray, IntArray
from ostiform.compiled import kernel
from ostiform.embedding.rings import vertex_rings
from ostiform.values import Axes, value

# Smoothing ends with the sweep that moves fewer than this share of the free vertices.
LEAST_SHARE_MOVED = 0.01


@value
class SmoothingResult:
    """A smoothed map.

    Attributes
    ----------
    directions : (V, 3) float64
        Unit vectors.
    sweeps : int
    moves : int
        Accepted moves, all sweeps together.
    """

    directions: Annotated[FloatArray, Axes("V", 3)]
    sweeps: int
    moves: int


def triangle_qualities(directions: FloatArray, faces: IntArray) -> FloatArray:
    """Return the quality (F,) of every chord triangle on the sphere (HY eq. 2), in [-1, 1]."""
    corners = directions[faces]  # (F, 3, 3)
    edges = np.roll(corners, -1, axis=1) - corners
    across = np.cross(edges[:, 0], -edges[:, 2])
    squares = np.einsum("fka,fka->f", edges, edges)
    inverted = np.einsum("fa,fa->f", across, corners.sum(axis=1)) <= 0.0
    sizes = np.linalg.norm(across, axis=1) / np.where(squares > 0.0, squares, 1.0)
    qualities: FloatArray = 2.0 * np.sqrt(3.0) * np.where(inverted, -sizes, sizes)
    return qualities


def smoothed_where_better(
    directions: FloatArray, faces: IntArray, is_fixed: BoolArray, max_sweeps: int = 20
) -> SmoothingResult:
    """Smooth a map; no move lowers the least quality round the vertex it moves (HY eq. 2).

    Parameters
    ----------
    directions : (V, 3) float64
        Unit vectors.
    faces : (F, 3) int64
    is_fixed : (V,) bool
        Vertices of rims and seams.
    max_sweeps : int
    """
    rings = vertex_rings(faces, len(directions))
    free = np.flatnonzero(~is_fixed)
    current = np.array(directions, dtype=np.float64)
    sweeps = moves = 0
    while sweeps < max_sweeps:
        moved = _swept(current, rings.offsets, rings.start, rings.end, free)
        sweeps, moves = sweeps + 1, moves + moved
        if moved <= LEAST_SHARE_MOVED * len(free):
            break
    return SmoothingResult(current, sweeps, moves)


@kernel
def _swept(
    directions: FloatArray, offsets: IntArray, start: IntArray, end: IntArray, free: IntArray
) -> int:
    """Move every free vertex in turn, in place; return how many moved."""
    moved = 0
    for v in free:
        first, last = offsets[v], offsets[v + 1]
        center = np.zeros(3)
        for k in range(first, last):
            center += directions[start[k]]
        size = np.sqrt((center**2).sum())
        if size == 0.0:
            continue
        center /= size
        before, after = np.inf, np.inf
        for k in range(first, last):
            p, q = directions[start[k]], directions[end[k]]
            before = min(before, _quality(directions[v], p, q))
            after = min(after, _quality(center, p, q))
        if after > before:
            directions[v] = center
            moved += 1
    return moved


@kernel
def _quality(a: FloatArray, b: FloatArray, c: FloatArray) -> float:
    across = np.cross(b - a, c - a)
    squares = ((b - a) ** 2).sum() + ((c - b) ** 2).sum() + ((a - c) ** 2).sum()
    if squares == 0.0:
        return 0.0
    size = float(2.0 * np.sqrt(3.0) * np.sqrt((across**2).sum()) / squares)
    return size if (across * (a + b + c)).sum() > 0.0 else -size
