"""Pieces of a labelled surface that belong to what surrounds them."""

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.surface.fans import face_fans
from ostiform.surface.topology import graph_labels, non_manifold_vertices, unique_edges

_MOST_ROUNDS = 10


def without_islands(faces: IntArray, owner: IntArray, area: FloatArray) -> IntArray:
    """Give pieces of a part beside its largest to the part that surrounds them.

    So are faces that hang on their part by one vertex only.

    Parameters
    ----------
    faces : (F, 3) int64
    owner : (F,) int64
        The part of each face.
    area : (F,) float64

    Returns
    -------
    (F,) int64
    """
    owner = owner.copy()
    for _ in range(_MOST_ROUNDS):
        owner = _without_pinches(faces, _without_small_pieces(faces, owner, area))
        if not any(len(non_manifold_vertices(faces[owner == k])) for k in np.unique(owner)):
            break
    return _without_small_pieces(faces, owner, area)


def _without_pinches(faces: IntArray, owner: IntArray) -> IntArray:
    """Give the smaller fans of a part at a vertex that it touches twice to the other part there."""
    owner = owner.copy()
    for part in np.unique(owner).tolist():
        for vertex in non_manifold_vertices(faces[owner == part]).tolist():
            around = np.flatnonzero((faces == vertex).any(axis=1))
            others = owner[around][owner[around] != part]
            mine = np.flatnonzero(owner == part)
            fans = face_fans(faces[mine], vertex)
            if not len(others) or len(fans) < 2:
                continue
            largest = max(fans, key=len)
            for fan in fans:
                if fan is not largest:
                    owner[mine[fan]] = np.bincount(others).argmax()
    return owner


def _without_small_pieces(faces: IntArray, owner: IntArray, area: FloatArray) -> IntArray:
    owner = owner.copy()
    _, edge, _ = unique_edges(faces)
    order = np.argsort(edge, kind="stable")
    same = np.flatnonzero(edge[order][1:] == edge[order][:-1])
    one, two = order[same] // 3, order[same + 1] // 3
    for _ in range(3):
        alike = owner[one] == owner[two]
        label = graph_labels(one[alike], two[alike], len(faces))
        sizes = np.bincount(label, weights=area)
        changed = False
        for part in np.unique(owner).tolist():
            pieces = np.unique(label[owner == part])
            main = pieces[sizes[pieces].argmax()]
            for piece in pieces[pieces != main].tolist():
                inside = label == piece
                beyond = np.concatenate(
                    [owner[two[inside[one] & ~inside[two]]], owner[one[inside[two] & ~inside[one]]]]
                )
                if len(beyond):
                    owner[inside] = np.bincount(beyond).argmax()
                    changed = True
        if not changed:
            break
    return owner
