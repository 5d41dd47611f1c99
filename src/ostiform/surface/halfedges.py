"""Twins of half-edges: how to step from a triangle to its neighbour in constant time."""

import numpy as np

from ostiform.arrays import IntArray
from ostiform.compiled import kernel
from ostiform.errors import TopologyError


def twin_half_edges(faces: IntArray, n_vertices: int) -> IntArray:
    """Return the oppositely directed half-edge of every half-edge.

    Half-edge ``3 f + k`` runs from corner k to corner k + 1 of face f; the face across it is its
    twin's index // 3.

    Parameters
    ----------
    faces : (F, 3) int64
        Consistently oriented, with at most two faces at an edge.
    n_vertices : int

    Returns
    -------
    twins : (3F,) int64
        -1 on a boundary.

    Raises
    ------
    TopologyError
        If two faces run along the same edge in the same direction: an edge with three or more
        faces, or neighbours that are not oriented alike.
    """
    twins, clash = _twins(np.ascontiguousarray(faces), n_vertices)
    if clash >= 0:
        start, end = faces[clash // 3, clash % 3], faces[clash // 3, (clash % 3 + 1) % 3]
        raise TopologyError(
            "expected a manifold mesh with faces oriented alike, found two faces that run along "
            f"the edge from vertex {int(start)} to {int(end)} in the same direction: repair or "
            "orient the surface first"
        )
    found: IntArray = twins
    return found


@kernel
def _twins(faces: IntArray, n_vertices: int) -> tuple[IntArray, int]:
    n_half_edges = 3 * len(faces)
    start = np.zeros(n_vertices + 1, dtype=np.int64)
    for f in range(len(faces)):
        for k in range(3):
            start[faces[f, k] + 1] += 1
    for v in range(n_vertices):
        start[v + 1] += start[v]
    outgoing = np.empty(n_half_edges, dtype=np.int64)  # half-edges sorted by their first vertex
    filled = start[:-1].copy()
    for h in range(n_half_edges):
        v = faces[h // 3, h % 3]
        outgoing[filled[v]] = h
        filled[v] += 1
    twins = np.full(n_half_edges, -1, dtype=np.int64)
    for h in range(n_half_edges):
        a, b = faces[h // 3, h % 3], faces[h // 3, (h % 3 + 1) % 3]
        for i in range(start[b], start[b + 1]):
            g = outgoing[i]
            if faces[g // 3, (g % 3 + 1) % 3] == a:
                if twins[h] >= 0:
                    return twins, g
                twins[h] = g
    for h in range(n_half_edges):
        if twins[h] >= 0 and twins[twins[h]] != h:
            return twins, h
        if twins[h] < 0:
            a, b = faces[h // 3, h % 3], faces[h // 3, (h % 3 + 1) % 3]
            for i in range(start[a], start[a + 1]):
                g = outgoing[i]
                if g != h and faces[g // 3, (g % 3 + 1) % 3] == b:
                    return twins, h
    return twins, -1
