"""Triangles that pass through each other.

Found, not mended: the maps of this package do not need an embedded surface, but whoever measures
a volume does, so a surface that crosses itself is reported.
"""

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.compiled import kernel
from ostiform.surface.normals import vertex_normals
from ostiform.surface.queries import closest_points, surface_tree
from ostiform.surface.topology import boundary_half_edges

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


def crossing_depth(
    first: tuple[FloatArray, IntArray], second: tuple[FloatArray, IntArray]
) -> tuple[float, FloatArray]:
    """Return how far two surfaces pass through each other, and where most.

    That is how far vertices of one lie on the other side of the other surface than most: of a
    vessel that runs into a chamber the depth inside, of an endocardium that pierces its
    epicardium what stands out. Vertices that are nearest to a rim count for neither side.

    Parameters
    ----------
    first, second : ((V, 3) float64, (F, 3) int64), mm
        Faces counter-clockwise seen from outside.

    Returns
    -------
    depth : float, mm
        0 where no triangles cross.
    place : (3,) float64, mm
    """
    vertices = np.concatenate([first[0], second[0]])
    low = np.maximum(first[0].min(axis=0), second[0].min(axis=0))
    high = np.minimum(first[0].max(axis=0), second[0].max(axis=0))
    faces = np.concatenate([first[1], second[1] + len(first[0])])
    corners = vertices[faces]
    near = np.flatnonzero(
        (corners.max(axis=1) >= low).all(axis=1) & (corners.min(axis=1) <= high).all(axis=1)
    )
    pairs = near[crossing_triangles(vertices, faces[near])].reshape(-1, 2)
    if not ((pairs[:, 0] < len(first[1])) & (pairs[:, 1] >= len(first[1]))).any():
        return 0.0, np.zeros(3)
    return max(_depth(first, second), _depth(second, first), key=lambda found: found[0])


def _depth(
    inner: tuple[FloatArray, IntArray], outer: tuple[FloatArray, IntArray]
) -> tuple[float, FloatArray]:
    vertices, faces = outer
    found = closest_points(surface_tree(vertices, faces), inner[0])
    normals = vertex_normals(vertices, faces)[faces[found.faces]]  # (n, 3, 3)
    normal = np.einsum("nc,nck->nk", found.barycentric, normals)
    height = ((inner[0] - found.points) * normal).sum(axis=1)
    on_rim = np.zeros(len(vertices), dtype=np.bool_)
    on_rim[boundary_half_edges(faces)] = True
    at_rim = ((found.barycentric > 0.0) & on_rim[faces[found.faces]]).any(axis=1)
    signed = np.where(at_rim, 0.0, np.sign(height) * found.distances)
    side = signed if signed.max() < -signed.min() else -signed
    k = int(side.argmax())
    return max(float(side[k]), 0.0), inner[0][k]


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
