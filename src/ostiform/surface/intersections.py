"""Triangles that pass through each other.

Found, not mended: the maps of this package do not need an embedded surface, but whoever measures
a volume does, so a surface that crosses itself is reported.
"""

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.compiled import kernel

_CELLS_PER_EDGE = 1.5
"""Size of a grid cell in units of the mean bounding box of a triangle: few triangles per cell and
few cells per triangle."""


def crossing_triangles(vertices: FloatArray, faces: IntArray) -> IntArray:
    """Return the pairs of triangles without a common vertex that pass through each other.

    Signs are those of floating-point determinants: contacts without a crossing (one vertex on
    another triangle, two coplanar triangles) are not found.

    Parameters
    ----------
    vertices : (V, 3) float64
    faces : (F, 3) int64

    Returns
    -------
    (n, 2) int64
        Smaller index first, sorted.
    """
    if not len(faces):
        return np.zeros((0, 2), dtype=np.int64)
    corners = np.ascontiguousarray(vertices[faces])  # (F, 3, 3)
    low, high = corners.min(axis=1), corners.max(axis=1)  # (F, 3)
    size = _CELLS_PER_EDGE * float((high - low).max(axis=1).mean())
    if not size > 0.0:
        return np.zeros((0, 2), dtype=np.int64)
    origin = low.min(axis=0)
    first = ((low - origin) // size).astype(np.int64)
    last = ((high - origin) // size).astype(np.int64)
    owner, cell = _occupied(first, last)
    shape = last.max(axis=0) + 1
    key = (cell[:, 0] * shape[1] + cell[:, 1]) * shape[2] + cell[:, 2]
    order = np.argsort(key, kind="stable")
    starts = np.flatnonzero(np.diff(key[order], prepend=-1))
    ends = np.append(starts[1:], len(order))
    pairs = _crossings(corners, faces, low, high, owner[order], starts, ends)
    return np.unique(pairs, axis=0)


def _occupied(first: IntArray, last: IntArray) -> tuple[IntArray, IntArray]:
    """Return (triangle, cell) for every cell of the grid that a bounding box meets."""
    extent = last - first + 1  # (F, 3)
    count = extent.prod(axis=1)
    owner = np.repeat(np.arange(len(first)), count)
    rank = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    wide = extent[owner]
    along_z = rank % wide[:, 2]
    along_y = rank // wide[:, 2] % wide[:, 1]
    along_x = rank // (wide[:, 2] * wide[:, 1])
    return owner, first[owner] + np.stack([along_x, along_y, along_z], axis=1)


@kernel
def _crossings(
    corners: FloatArray,
    faces: IntArray,
    low: FloatArray,
    high: FloatArray,
    owner: IntArray,
    starts: IntArray,
    ends: IntArray,
) -> IntArray:
    found = np.empty((64, 2), dtype=np.int64)
    n_found = 0
    for g in range(len(starts)):
        for a in range(starts[g], ends[g]):
            one = owner[a]
            for b in range(a + 1, ends[g]):
                two = owner[b]
                apart = False
                for k in range(3):
                    if low[one, k] > high[two, k] or low[two, k] > high[one, k]:
                        apart = True
                    for l in range(3):
                        if faces[one, k] == faces[two, l]:
                            apart = True
                if apart:
                    continue
                if _pierced(corners[one], corners[two]) or _pierced(corners[two], corners[one]):
                    if n_found == len(found):
                        larger = np.empty((2 * len(found), 2), dtype=np.int64)
                        larger[:n_found] = found
                        found = larger
                    found[n_found, 0] = min(one, two)
                    found[n_found, 1] = max(one, two)
                    n_found += 1
    return found[:n_found]


@kernel
def _pierced(triangle: FloatArray, other: FloatArray) -> bool:
    """Whether an edge of the other triangle passes through the inside of the triangle."""
    sides = np.empty(3)
    for k in range(3):
        sides[k] = _volume(triangle[0], triangle[1], triangle[2], other[k])
    for k in range(3):
        l = (k + 1) % 3
        if sides[k] * sides[l] >= 0.0:
            continue
        one = _volume(other[k], other[l], triangle[0], triangle[1])
        two = _volume(other[k], other[l], triangle[1], triangle[2])
        three = _volume(other[k], other[l], triangle[2], triangle[0])
        if (one > 0.0 and two > 0.0 and three > 0.0) or (one < 0.0 and two < 0.0 and three < 0.0):
            return True
    return False


@kernel
def _volume(a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray) -> float:
    bx, by, bz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    cx, cy, cz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    dx, dy, dz = d[0] - a[0], d[1] - a[1], d[2] - a[2]
    return float(bx * (cy * dz - cz * dy) - by * (cx * dz - cz * dx) + bz * (cx * dy - cy * dx))
