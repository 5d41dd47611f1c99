"""Closing openings: a loop is filled with triangles that continue the surface."""

from collections.abc import Sequence

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.surface.remesh import RemeshRules, isotropic_remeshed

_PLAIN_FAN = 12
"""A loop of fewer edges is filled by a fan as it is; a larger one is given inner vertices."""


def filled_loops(
    vertices: FloatArray, faces: IntArray, loops: Sequence[IntArray]
) -> tuple[FloatArray, IntArray]:
    """Close boundary loops; no vertex is moved.

    A loop of three vertices becomes a triangle, a small one a fan about the mean of its vertices,
    a larger one such a fan remeshed at the loop's own median edge.

    Parameters
    ----------
    vertices : (V, 3) float64
    faces : (F, 3) int64
        Consistently oriented.
    loops : sequence of (n,) int64
        As `boundary_loops` returns them: the surface on their left.

    Returns
    -------
    vertices : (V + n, 3) float64
        The given ones first.
    faces : (F + m, 3) int64
        The given ones first.
    """
    points, triangles = [vertices], [faces]
    n_vertices = len(vertices)
    for loop in loops:
        if len(loop) == 3:
            triangles.append(loop[::-1][None])
            continue
        inner, patch = _patch(vertices[loop])
        # Patch indices below n are the loop's vertices, the others follow all there are.
        index = np.concatenate([loop, n_vertices + np.arange(len(inner))])
        points.append(inner)
        triangles.append(index[patch])
        n_vertices += len(inner)
    return np.concatenate(points), np.concatenate(triangles)


def _patch(rim: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return inner vertices (k, 3) and triangles that close a loop (n, 3) run against its order."""
    n = len(rim)
    around = np.arange(n)
    fan = np.stack([np.roll(around, -1), around, np.full(n, n)], axis=1)  # (n, 3)
    points = np.vstack([rim, rim.mean(axis=0)])
    if n < _PLAIN_FAN:
        return points[n:], fan
    edges = np.linalg.norm(np.roll(rim, -1, axis=0) - rim, axis=1)
    fine = isotropic_remeshed(
        points,
        fan,
        edge_mm=float(np.median(edges)),
        curves=(around[::-1],),
        rules=RemeshRules(move_curves=False, fewest_on_curve=3),
    )
    (curve,) = fine.curves
    # The curve keeps its vertices, in the same direction; renumber them to come first.
    start = int(np.argmin(np.linalg.norm(fine.vertices[curve] - rim[-1], axis=1)))
    ordered = np.roll(curve, -start)[::-1]  # rim[0], rim[1], ...
    is_inner = np.ones(len(fine.vertices), dtype=np.bool_)
    is_inner[ordered] = False
    index = np.empty(len(fine.vertices), dtype=np.int64)
    index[ordered] = np.arange(n)
    index[is_inner] = n + np.arange(int(is_inner.sum()))
    return fine.vertices[is_inner], index[fine.faces]
