"""Where the handles of a surface are: short closed curves that do not part it.

Eppstein (2003): the edges that neither a spanning tree of the vertices nor one of the faces beside
it uses are 2 g in number; each closes a curve with the tree, and these curves generate all others.
"""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra, minimum_spanning_tree

from ostiform.arrays import FloatArray, IntArray
from ostiform.surface.topology import boundary_loops, edge_faces

_ROUNDS = 3
"""Roots tried one after the other, each on the shortest curve through the last."""


def short_handle_curve(vertices: FloatArray, faces: IntArray) -> IntArray:
    """Return a short closed curve round, or through, a handle of a surface.

    The curve is the shortest that passes one vertex among those of a tree of shortest paths; it is
    not proven to be the shortest of all.

    Parameters
    ----------
    vertices : (V, 3) float64
    faces : (F, 3) int64
        A consistently oriented manifold.

    Returns
    -------
    (n,) int64
        Vertices in order; empty where there is no handle.
    """
    # Openings are closed by cones whose tips no shortest path may pass.
    loops = boundary_loops(faces)
    caps = [
        np.stack([np.roll(loop, -1), loop, np.full(len(loop), len(vertices) + k)], axis=1)
        for k, loop in enumerate(loops)
    ]
    tips = [vertices[loop].mean(axis=0) for loop in loops]
    points = np.vstack([vertices, *tips])
    closed = np.vstack([faces, *caps])
    edges, sides = edge_faces(closed)
    lengths = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    far = float(lengths.sum())
    lengths = np.where((edges >= len(vertices)).any(axis=1), far, np.maximum(lengths, 1e-12 * far))
    root = int(faces[0, 0])
    best = np.zeros(0, dtype=np.int64)
    shortest = np.inf
    for _ in range(_ROUNDS):
        curve, length = _curve_from(root, edges, sides, lengths, len(points))
        if not length < shortest:
            break
        best, shortest = curve, length
        root = int(curve[len(curve) // 2])
    return best


def _curve_from(
    root: int, edges: IntArray, sides: IntArray, lengths: FloatArray, count: int
) -> tuple[IntArray, float]:
    """Return the shortest curve of a root's tree, and its length; infinite where there is none."""
    graph = coo_array((lengths, (edges[:, 0], edges[:, 1])), shape=(count, count)).tocsr()
    trees = dijkstra(graph, directed=False, indices=np.array([root]), return_predecessors=True)
    distance, before = trees[0][0], trees[1][0].astype(np.int64)
    reached = np.isfinite(distance)
    in_tree = (before[edges[:, 0]] == edges[:, 1]) | (before[edges[:, 1]] == edges[:, 0])
    rest = np.flatnonzero(~in_tree & reached[edges].all(axis=1) & (sides[:, 1] >= 0))
    round_trip = distance[edges[rest, 0]] + distance[edges[rest, 1]] + lengths[rest]
    # The tree of faces takes the edges of long curves, so that short ones are left.
    n_faces = int(sides.max()) + 1
    order = np.argsort(-round_trip, kind="stable")
    weight = np.empty(len(rest))
    weight[order] = 1.0 + np.arange(len(rest))
    one, two = sides[rest].T
    tree = minimum_spanning_tree(
        coo_array((weight, (np.minimum(one, two), np.maximum(one, two))), shape=(n_faces,) * 2)
    )
    used = np.rint(tree.data).astype(np.int64)
    is_left = np.ones(len(rest), dtype=np.bool_)
    is_left[order[used - 1]] = False
    if not is_left.any():
        return np.zeros(0, dtype=np.int64), np.inf
    left = np.flatnonzero(is_left)
    chosen = left[round_trip[left].argmin()]
    ends = [_path(before, root, int(v)) for v in edges[rest[chosen]]]
    common = 0
    while common < min(map(len, ends)) and ends[0][common] == ends[1][common]:
        common += 1
    curve = [*ends[0][max(common - 1, 0) :], *reversed(ends[1][common:])]
    return np.array(curve, dtype=np.int64), float(round_trip[chosen])


def _path(before: IntArray, root: int, vertex: int) -> list[int]:
    path = [vertex]
    while path[-1] != root:
        path.append(int(before[path[-1]]))
    return path[::-1]
