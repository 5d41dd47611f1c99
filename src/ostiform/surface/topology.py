"""Topology of triangle soups: edges, boundary loops, orientation, genus, manifoldness.

Everything here works on faces alone (indices of vertices), so it holds for any position of the
vertices; only `oriented_outward` and `enclosed_volume` look at positions.
"""

from typing import TypeAlias

import numpy as np

from ostiform.arrays import BoolArray, FloatArray, IntArray
from ostiform.errors import TopologyError
from ostiform.surface.topology_kernels import (
    grouped_edges,
    labels_of_links,
    propagated_flips,
)

_ByEdge: TypeAlias = tuple[IntArray, IntArray, IntArray, IntArray]
"""What `_half_edges_by_edge` returns: sorted once, for all that is asked of one mesh."""


def half_edges(faces: IntArray) -> IntArray:
    """Return the directed edges of the faces.

    Parameters
    ----------
    faces : (F, 3) int64

    Returns
    -------
    (3F, 2) int64
        Row ``3 f + k`` is the half-edge of face f from its corner k to its corner k + 1.
    """
    return np.stack([faces, faces[:, [1, 2, 0]]], axis=2).reshape(-1, 2)  # (3F, 2)


def unique_edges(faces: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """Return the undirected edges of the faces, and which edge each half-edge is.

    Returns
    -------
    edges : (E, 2) int64
        Smaller vertex first, sorted.
    edge_of_half_edge : (3F,) int64
        Index into `edges` of each row of `half_edges`.
    n_faces : (E,) int64
        How many half-edges (so faces) use each edge: 1 on a boundary, 2 inside, more where the
        mesh is not manifold.
    """
    edges, index, count, _ = _half_edges_by_edge(faces)
    return edges, index, count


def non_manifold_edges(faces: IntArray) -> IntArray:
    """Return the edges used by three or more faces, (n, 2) int64, smaller vertex first."""
    edges, _, count = unique_edges(faces)
    return edges[count > 2]


def edge_faces(faces: IntArray) -> tuple[IntArray, IntArray]:
    """Return the edges of a mesh and the faces on either side.

    Returns
    -------
    edges : (E, 2) int64
        Smaller vertex first, sorted.
    sides : (E, 2) int64
        The one or two faces of each edge in ascending order; -1 where there is no second face.

    Raises
    ------
    TopologyError
        If an edge has three or more faces.
    """
    edges, _, count, order = _half_edges_by_edge(faces)
    _refuse_non_manifold_edges(edges, count)
    start = np.concatenate([[0], np.cumsum(count)[:-1]]) if len(edges) else np.zeros(0, np.int64)
    owner = order // 3
    sides = np.full((len(edges), 2), -1, dtype=np.int64)
    if len(edges):
        sides[:, 0] = owner[start]
        inner = count == 2
        sides[inner, 1] = owner[start[inner] + 1]
    return edges, sides


def boundary_half_edges(faces: IntArray) -> IntArray:
    """Return the half-edges that no other face uses, in face order, the surface on their left.

    Returns
    -------
    (n, 2) int64
    """
    _, index, count = unique_edges(faces)
    rim: IntArray = half_edges(faces)[count[index] == 1]
    return rim


def boundary_loops(faces: IntArray) -> tuple[IntArray, ...]:
    """Return the boundary loops of a consistently oriented mesh, the surface on their left.

    Each loop follows the half-edges of the faces and starts at its smallest vertex index; loops
    are ordered by that vertex, so the result depends on the faces alone.

    Parameters
    ----------
    faces : (F, 3) int64
        Consistently oriented, every edge with one or two faces.

    Returns
    -------
    tuple of (n,) int64
        Empty for a closed surface.

    Raises
    ------
    TopologyError
        If an edge has three or more faces, the faces are not consistently oriented, or two
        boundaries meet at a vertex.
    """
    return _loops(faces, _half_edges_by_edge(faces))


def _loops(faces: IntArray, by_edge: _ByEdge) -> tuple[IntArray, ...]:
    edges, index, count, _ = by_edge
    _refuse_non_manifold_edges(edges, count)
    if not _are_oriented_alike(faces, by_edge):
        raise TopologyError(
            "expected faces oriented alike, found neighbouring faces that run along their common "
            "edge in the same direction: orient the surface first"
        )
    rim = half_edges(faces)[count[index] == 1]  # (n, 2)
    starts, uses = np.unique(rim[:, 0], return_counts=True)
    if (uses > 1).any():
        shared = starts[uses > 1]
        raise TopologyError(
            f"expected openings that share no vertex, found {len(shared)} vertices where two "
            f"boundaries meet, the first with index {int(shared[0])}: remove or duplicate it"
        )
    following = dict(zip(rim[:, 0].tolist(), rim[:, 1].tolist(), strict=True))
    loops = []
    for first in starts.tolist():
        if first not in following:
            continue
        loop = [first]
        vertex = following.pop(first)
        while vertex != first:
            loop.append(vertex)
            vertex = following.pop(vertex)
        loops.append(np.array(loop, dtype=np.int64))
    return tuple(loops)


def connected_components(faces: IntArray) -> IntArray:
    """Return the label of the connected piece each face belongs to, (F,) int64.

    Faces are connected through edges (not through single vertices). Labels count from 0 in the
    order of each piece's first face.
    """
    return _pieces(faces, _half_edges_by_edge(faces))


def _pieces(faces: IntArray, by_edge: _ByEdge) -> IntArray:
    one, two = _joined_half_edges(by_edge)
    return graph_labels(one // 3, two // 3, len(faces))


def euler_characteristic(faces: IntArray) -> int:
    """Return vertices - edges + faces, counting only vertices that a face uses."""
    return _euler(faces, _half_edges_by_edge(faces))


def _euler(faces: IntArray, by_edge: _ByEdge) -> int:
    n_vertices = int(referenced_vertices(faces, int(faces.max(initial=-1)) + 1).sum())
    return n_vertices - len(by_edge[0]) + len(faces)


def genus(faces: IntArray) -> int:
    """Return the number of handles of an oriented surface, summed over its pieces.

    ``chi = sum over pieces of (2 - 2 g - b)`` with b the number of boundary loops.

    Raises
    ------
    TopologyError
        If the mesh is not a consistently oriented manifold.
    """
    by_edge = _half_edges_by_edge(faces)
    vertices = _bow_ties(faces, by_edge)
    if len(vertices):
        raise TopologyError(
            f"expected one fan of faces round every vertex, found {len(vertices)} vertices where "
            f"the surface only touches itself, the first with index {int(vertices[0])}"
        )
    n_loops = len(_loops(faces, by_edge))
    n_pieces = int(_pieces(faces, by_edge).max(initial=-1)) + 1
    return (2 * n_pieces - n_loops - _euler(faces, by_edge)) // 2


def non_manifold_vertices(faces: IntArray) -> IntArray:
    """Return the vertices whose faces do not form one fan ("bow-ties"), (n,) int64, ascending.

    Two fans that meet only at the vertex make it non-manifold; edges with three or more faces
    are reported by `non_manifold_edges`, not here.
    """
    return _bow_ties(faces, _half_edges_by_edge(faces))


def _bow_ties(faces: IntArray, by_edge: _ByEdge) -> IntArray:
    one, two = _joined_half_edges(by_edge)
    corner_count = faces.size
    following = np.roll(np.arange(corner_count).reshape(-1, 3), -1, axis=1).reshape(-1)
    vertex = faces.reshape(-1)
    alike = vertex[one] == vertex[two]
    # Corners of one vertex in two faces that share an edge at that vertex belong to one fan.
    opposite = np.where(alike, two, following[two])
    opposite_end = np.where(alike, following[two], two)
    labels = graph_labels(
        np.concatenate([one, following[one]]),
        np.concatenate([opposite, opposite_end]),
        corner_count,
    )
    vertex_of_fan = np.empty(int(labels.max(initial=-1)) + 1, dtype=np.int64)
    vertex_of_fan[labels] = vertex
    return np.flatnonzero(np.bincount(vertex_of_fan) > 1)


def referenced_vertices(faces: IntArray, n_vertices: int) -> BoolArray:
    """Return which of the vertices a face uses, (V,) bool."""
    used = np.zeros(n_vertices, dtype=np.bool_)
    used[faces] = True
    return used


def without_unreferenced(faces: IntArray, n_vertices: int) -> tuple[IntArray, IntArray]:
    """Drop the vertices that no face uses.

    Returns
    -------
    kept : (V',) int64
        Old indices of the vertices that remain, ascending.
    faces : (F, 3) int64
        The faces with the new indices.
    """
    used = referenced_vertices(faces, n_vertices)
    renumbered = np.cumsum(used) - 1
    return np.flatnonzero(used), renumbered[faces].astype(np.int64)


def is_consistently_oriented(faces: IntArray) -> bool:
    """Return whether no two faces run along a common edge in the same direction."""
    return _are_oriented_alike(faces, _half_edges_by_edge(faces))


def _are_oriented_alike(faces: IntArray, by_edge: _ByEdge) -> bool:
    directed = half_edges(faces)
    _, index, count, _ = by_edge
    is_forward = directed[:, 0] < directed[:, 1]
    n_forward = np.bincount(index, weights=is_forward, minlength=len(count))
    return bool((n_forward <= 1).all() and (count - n_forward <= 1).all())


def consistently_oriented(faces: IntArray) -> IntArray:
    """Return the faces turned so that each piece is oriented as its first face is.

    Raises
    ------
    TopologyError
        If an edge has three or more faces, or the surface has one side only (a Moebius band).
    """
    if is_consistently_oriented(faces) and not len(non_manifold_edges(faces)):
        return faces
    _, sides = edge_faces(faces)
    inner = sides[:, 1] >= 0
    neighbours = sides[inner]  # (n, 2)
    one, two = _joined_half_edges(_half_edges_by_edge(faces))
    start = faces.reshape(-1)
    same_direction = start[one] == start[two]
    flip, is_orientable = propagated_flips(neighbours, same_direction, len(faces))
    if not is_orientable:
        raise TopologyError(
            "expected a surface with two sides, found one that cannot be oriented (a Moebius band)"
        )
    turned = faces.copy()
    turned[flip] = turned[flip][:, [0, 2, 1]]
    return turned


def enclosed_volume(vertices: FloatArray, faces: IntArray) -> float:
    """Return the signed volume of an oriented surface whose openings are closed by cones.

    Each boundary loop is closed by triangles to the mean of its vertices. Positive when the
    faces are counter-clockwise seen from outside.

    Parameters
    ----------
    vertices : (V, 3) float64, mm
    faces : (F, 3) int64
        Consistently oriented.

    Returns
    -------
    float
        In cubic units of the vertices.
    """
    center = vertices[referenced_vertices(faces, len(vertices))].mean(axis=0)
    corners = vertices[faces] - center  # (F, 3, 3)
    volume = float(np.linalg.det(corners).sum())
    for loop in boundary_loops(faces):
        rim = vertices[loop] - center  # (n, 3)
        tip = rim.mean(axis=0)
        # The cap runs against the rim's half-edges, or it would not continue the surface.
        volume += float(np.cross(np.roll(rim, -1, axis=0), rim).sum(axis=0) @ tip)
    return volume / 6.0


def oriented_outward(vertices: FloatArray, faces: IntArray) -> IntArray:
    """Return the faces turned to be counter-clockwise seen from outside, piece by piece.

    Outside is where `enclosed_volume` is positive.

    Parameters
    ----------
    vertices : (V, 3) float64
    faces : (F, 3) int64

    Returns
    -------
    (F, 3) int64
        In the same order; turned faces have their second and third corners exchanged.

    Raises
    ------
    TopologyError
        If the surface cannot be oriented or two boundaries meet at a vertex.
    """
    turned = consistently_oriented(faces).copy()
    piece = connected_components(turned)
    for label in range(int(piece.max(initial=-1)) + 1):
        mine = piece == label
        if enclosed_volume(vertices, turned[mine]) < 0.0:
            turned[mine] = turned[mine][:, [0, 2, 1]]
    return turned


def graph_labels(one: IntArray, two: IntArray, count: int) -> IntArray:
    """Return the label (count,) of the connected set of each item, from links (one, two).

    Labels count from 0 in the order of each set's first item.
    """
    labels: IntArray = labels_of_links(one, two, count)
    return labels


def _refuse_non_manifold_edges(edges: IntArray, count: IntArray) -> None:
    bad = edges[count > 2]
    if len(bad):
        raise TopologyError(
            f"expected at most two faces at every edge, found {len(bad)} edges with three or more, "
            f"the first between vertices {int(bad[0, 0])} and {int(bad[0, 1])}: remove the extra "
            "sheet"
        )


def _half_edges_by_edge(faces: IntArray) -> _ByEdge:
    """Return what `unique_edges` does, and the half-edges (3F,) in the order of their edges."""
    directed = half_edges(faces)
    low = np.minimum(directed[:, 0], directed[:, 1])
    high = np.maximum(directed[:, 0], directed[:, 1])
    edges, index, count, order = grouped_edges(low, high, int(faces.max(initial=-1)) + 1)
    return edges, index, count, order


def _joined_half_edges(by_edge: _ByEdge) -> tuple[IntArray, IntArray]:
    """Return pairs (one, two) of half-edges of the same edge, in the order of the edges."""
    _, index, _, order = by_edge
    edge = index[order]
    joined = np.flatnonzero(edge[1:] == edge[:-1])
    return order[joined], order[joined + 1]
