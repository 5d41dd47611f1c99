"""The ring of triangles around every vertex, as flat arrays for compiled sweeps."""

from typing import NamedTuple

import numpy as np

from ostiform.arrays import IntArray


class Rings(NamedTuple):
    """For vertex v the opposite edges ``start[k], end[k]``, ``offsets[v] <= k < offsets[v + 1]``.

    The triangle ``(v, start[k], end[k])`` has the orientation of the mesh; on a closed ring every
    neighbour is a start once.

    Attributes
    ----------
    offsets : (V + 1,) int64
    start, end : (3F,) int64
    """

    offsets: IntArray
    start: IntArray
    end: IntArray


def vertex_rings(faces: IntArray, n_vertices: int) -> Rings:
    """Return the rings of all vertices of faces (F, 3)."""
    order = np.argsort(faces.ravel(), kind="stable")
    offsets = np.zeros(n_vertices + 1, dtype=np.int64)
    np.cumsum(np.bincount(faces.ravel(), minlength=n_vertices), out=offsets[1:])
    return Rings(
        offsets, np.roll(faces, -1, axis=1).ravel()[order], np.roll(faces, 1, axis=1).ravel()[order]
    )
