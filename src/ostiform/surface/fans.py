"""Vertices round which the faces form several fans: parted or split.

Two fans that share only a vertex are either two sheets that touch (the vertex is split, one copy
per fan) or one sheet between two openings that touch (the openings are parted by a triangle; a
split would make one opening of them).
"""

from dataclasses import dataclass

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.surface.topology import graph_labels, half_edges, non_manifold_vertices, unique_edges

MOST_FANS = 100
"""A mesh with more such vertices is no surface with flaws."""


@dataclass(frozen=True, slots=True, eq=False)
class PartedFans:
    """A mesh with one fan of faces round every vertex.

    Attributes
    ----------
    vertices : (V, 3) float64
        New copies come last.
    faces : (F, 3) int64
        The given ones in their order, then new ones.
    n_parted : int
        Vertices where two openings met, each given one new triangle.
    n_split : int
        Vertices given a copy per fan.
    """

    vertices: FloatArray
    faces: IntArray
    n_parted: int
    n_split: int


def with_single_fans(vertices: FloatArray, faces: IntArray) -> PartedFans:
    """Return the mesh with one fan of faces round every vertex; no vertex is moved.

    Parameters
    ----------
    vertices : (V, 3) float64
    faces : (F, 3) int64
        Consistently oriented, at most two at every edge.
    """
    n_parted = 0
    for vertex in non_manifold_vertices(faces).tolist():
        corner = _corner_between_openings(faces, vertex)
        if corner is not None:
            faces = np.concatenate([faces, corner[None]])
            n_parted += 1
    split = non_manifold_vertices(faces)
    if not len(split):
        return PartedFans(vertices, faces, n_parted, 0)
    faces = faces.copy()
    copies: list[FloatArray] = []
    for vertex in split.tolist():
        for fan in face_fans(faces, vertex)[1:]:
            rows = faces[fan]
            rows[rows == vertex] = len(vertices) + len(copies)
            faces[fan] = rows
            copies.append(vertices[vertex])
    return PartedFans(np.vstack([vertices, *copies]), faces, n_parted, len(split))


def face_fans(faces: IntArray, vertex: int) -> list[IntArray]:
    """Return the faces (indices) of each fan round a vertex."""
    around = np.flatnonzero((faces == vertex).any(axis=1))
    local = faces[around]
    ends = np.sort(np.where(local == vertex, -1, local), axis=1)[:, 1:]  # (n, 2) outer vertices
    key = ends.reshape(-1)
    order = np.argsort(key, kind="stable")
    same = np.flatnonzero(key[order][1:] == key[order][:-1])
    labels = graph_labels(order[same] // 2, order[same + 1] // 2, len(around))
    return [around[labels == label] for label in range(int(labels.max()) + 1)]


def _corner_between_openings(faces: IntArray, vertex: int) -> IntArray | None:
    """Return the triangle (3,) that parts two openings which meet at a vertex, or None.

    Only two fans are told apart: the rim that leaves along one fan must come back along the other.
    """
    rim = _Rim.of(faces)
    leaving = rim.leaving.get(vertex, [])
    if len(leaving) != 2 or len(face_fans(faces, vertex)) != 2:
        return None
    walks = [rim.walk(row, vertex) for row in leaving]
    if any(not walk for walk in walks):
        return None
    fans = face_fans(faces, vertex)
    if any(np.isin(rim.owner[[walk[0], walk[-1]]], fan).all() for walk in walks for fan in fans):
        return None  # two sheets that touch
    longer = max(walks, key=len)
    return np.array([rim.edges[longer[0], 1], vertex, rim.edges[longer[-1], 0]], dtype=np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class _Rim:
    """The rim half-edges (n, 2), the face of each (n,), and the rows that leave each vertex."""

    faces: IntArray
    edges: IntArray
    owner: IntArray
    leaving: dict[int, list[int]]

    @classmethod
    def of(cls, faces: IntArray) -> "_Rim":
        _, edge, count = unique_edges(faces)
        rows = np.flatnonzero(count[edge] == 1)
        edges = half_edges(faces)[rows]
        leaving: dict[int, list[int]] = {}
        for row, start in enumerate(edges[:, 0].tolist()):
            leaving.setdefault(start, []).append(row)
        return cls(faces, edges, rows // 3, leaving)

    def walk(self, row: int, vertex: int) -> list[int]:
        """Return the rim edges from one that leaves the vertex to the one that comes back.

        Where the rim passes another vertex of two fans it goes on along the other fan, so that it
        stays round one opening. Empty if it does not come back.
        """
        walk = [row]
        while self.edges[walk[-1], 1] != vertex:
            if len(walk) > len(self.edges):
                return []
            here = int(self.edges[walk[-1], 1])
            onward = self.leaving.get(here, [])
            if len(onward) > 1:
                mine = next(f for f in face_fans(self.faces, here) if self.owner[walk[-1]] in f)
                onward = [r for r in onward if self.owner[r] not in mine]
            if len(onward) != 1:
                return []
            walk.append(onward[0])
        return walk
