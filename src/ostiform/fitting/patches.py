"""Open surfaces prepared for closest points, curves for the same, and where both end."""

from dataclasses import dataclass

import numpy as np

from ostiform.arrays import BoolArray, FloatArray, IntArray
from ostiform.surface import (
    ClosestPoints,
    boundary_loops,
    face_areas,
)

AT_CORNER = 1e-6
"""Barycentric coordinates below this are zero: a millionth of a triangle."""

# Additive recurrence of the plastic number (Roberts 2018): low discrepancy in the unit square.
PLASTIC = (0.7548776662466927, 0.5698402909980532)


@dataclass(frozen=True, slots=True, eq=False)
class Patch:
    """Triangles, and where they end.

    Attributes
    ----------
    faces : (F, 3) int64
    edge_is_open : (F, 3) bool
        Whether the edge opposite to each corner is a boundary.
    vertex_is_open : (V,) bool
    loops : tuple of (n,) int64
        The boundary loops.
    """

    faces: IntArray
    edge_is_open: BoolArray
    vertex_is_open: BoolArray
    loops: tuple[IntArray, ...]

    def ends_at(self, found: ClosestPoints) -> BoolArray:
        """Return which closest points (n,) lie on a boundary."""
        small = found.barycentric < AT_CORNER  # (n, 3)
        on_edge = (small & self.edge_is_open[found.faces]).any(axis=1)
        corner = found.barycentric.argmax(axis=1)
        vertex = np.take_along_axis(self.faces[found.faces], corner[:, None], axis=1)[:, 0]
        at_vertex = (small.sum(axis=1) == 2) & self.vertex_is_open[vertex]
        result: BoolArray = on_edge | at_vertex
        return result


def open_patch(faces: IntArray, n_vertices: int) -> Patch:
    """Return triangles with their boundary marked.

    Raises
    ------
    TopologyError
        If the triangles are no consistently oriented manifold.
    """
    loops = tuple(np.asarray(loop) for loop in boundary_loops(faces))
    start, end = np.roll(faces, -1, axis=1), np.roll(faces, 1, axis=1)  # opposite to each corner
    keys = start.astype(np.int64) * n_vertices + end
    back = end.astype(np.int64) * n_vertices + start
    is_open = ~np.isin(keys, back.ravel())
    at_vertex = np.zeros(n_vertices, dtype=np.bool_)
    for loop in loops:
        at_vertex[loop] = True
    return Patch(faces, is_open, at_vertex, loops)


def even_samples(vertices: FloatArray, faces: IntArray, count: int) -> tuple[IntArray, FloatArray]:
    """Return triangles (count,) and barycentric coordinates (count, 3) spread evenly by area.

    Systematic sampling along the list of triangles, low-discrepancy inside them; deterministic.
    """
    cumulative = np.cumsum(face_areas(vertices, faces))
    steps = (np.arange(count) + 0.5) / count * cumulative[-1]
    chosen = np.minimum(np.searchsorted(cumulative, steps), len(faces) - 1)
    index = np.arange(1, count + 1)
    u, v = (np.mod(0.5 + index * factor, 1.0) for factor in PLASTIC)
    folded = u + v > 1.0
    u, v = np.where(folded, 1.0 - u, u), np.where(folded, 1.0 - v, v)
    return chosen.astype(np.int64), np.stack([1.0 - u - v, u, v], axis=1)


def closest_on_curve(
    curve: FloatArray, points: FloatArray
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return the nearest point of a closed polyline (n, 3) to each point (m, 3).

    Returns
    -------
    edge : (m,) int64
        Edge i runs from vertex i to the next, the last to the first.
    fraction : (m,) float64
        How far along it.
    nearest : (m, 3) float64
    """
    along = np.roll(curve, -1, axis=0) - curve  # (n, 3)
    squared = np.maximum((along**2).sum(axis=1), 1e-300)
    offset = points[:, None] - curve[None]  # (m, n, 3)
    fraction = np.clip(np.einsum("mni,ni->mn", offset, along) / squared, 0.0, 1.0)
    distance = ((offset - fraction[..., None] * along) ** 2).sum(axis=2)
    edge = distance.argmin(axis=1)
    share = np.take_along_axis(fraction, edge[:, None], axis=1)[:, 0]
    return edge, share, curve[edge] + share[:, None] * along[edge]


def curve_distance(first: FloatArray, second: FloatArray) -> float:
    """Return the mean of the two mean distances in mm between closed polylines (n, 3), (m, 3)."""
    there = np.linalg.norm(closest_on_curve(second, first)[2] - first, axis=1)
    back = np.linalg.norm(closest_on_curve(first, second)[2] - second, axis=1)
    return float(0.5 * (there.mean() + back.mean()))


def curve_samples(curve: FloatArray, step: float) -> FloatArray:
    """Return points (m, 3) about `step` apart along a polyline (n, 3), its ends among them."""
    lengths = np.linalg.norm(np.diff(curve, axis=0), axis=1)
    total = float(lengths.sum())
    if not total > 0.0:
        return curve[:1]
    place = np.concatenate([[0.0], np.cumsum(lengths)])
    is_closed = float(np.linalg.norm(curve[-1] - curve[0])) <= 1e-9 * total
    count = max(int(round(total / step)), 1)
    wanted = np.linspace(0.0, total, count + 1)[: -1 if is_closed else None]
    return np.stack([np.interp(wanted, place, curve[:, d]) for d in range(3)], axis=1)
