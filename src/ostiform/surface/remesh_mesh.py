"""The half-edge arrays of a mesh that is being remeshed, and how to walk on them, compiled.

Half-edge ``h = 3 f + k`` runs from corner k to corner k + 1 of face f. A removed face has its
first corner set to -1, a removed vertex its `out` entry.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.compiled import kernel

MAX_RING = 256
"""Vertices with more neighbours than this are left alone."""

SAME_SIDE = 0.5
"""Cosine of the angle by which a triangle may turn in one operation: 60 degrees."""

FLATTEST = 0.1
"""Twice the area over the squared longest edge: a collapse makes no flatter triangle."""


class Mesh(NamedTuple):
    """The arrays of a mesh that is being changed, with room to grow.

    `positions` (V, 3), `target` edge length (V,), `curve` the vertex is on or -1 (V,), `along` its
    arc length there (V,), `out` an outgoing half-edge (V,); `faces` (F, 3), `label` (F,); `twins`
    and `feature` (the curve a half-edge is on, or -1) (3F,); `counts` = [vertices, faces in use];
    `on_curve` the number of vertices on each curve.
    """

    positions: FloatArray
    target: FloatArray
    curve: IntArray
    along: FloatArray
    out: IntArray
    faces: IntArray
    label: IntArray
    twins: IntArray
    feature: IntArray
    counts: IntArray
    on_curve: IntArray


class Curves(NamedTuple):
    """The closed input polylines: `points` and `arcs` from `start[c]` to `start[c + 1]`, closed."""

    start: IntArray
    points: FloatArray
    arcs: FloatArray


@kernel(inline="always")
def following(h: int) -> int:
    """Return the next half-edge of the same face."""
    return h - 2 if h % 3 == 2 else h + 1


@kernel(inline="always")
def preceding(h: int) -> int:
    """Return the previous half-edge of the same face."""
    return h + 2 if h % 3 == 0 else h - 1


@kernel(inline="always")
def origin(faces: IntArray, h: int) -> int:
    """Return the vertex a half-edge starts at."""
    return int(faces[h // 3, h % 3])


@kernel
def curve_position(curves: Curves, c: int, s: float) -> tuple[FloatArray, float]:
    """Return the point at arc length s (any number of turns) of curve c, and s within it."""
    low, high = curves.start[c], curves.start[c + 1]
    length = curves.arcs[high - 1]
    s = s % length
    i = low + np.searchsorted(curves.arcs[low:high], s, side="right") - 1
    i = min(max(i, low), high - 2)
    t = (s - curves.arcs[i]) / (curves.arcs[i + 1] - curves.arcs[i])
    return (1.0 - t) * curves.points[i] + t * curves.points[i + 1], s


@kernel
def arc_step(curves: Curves, c: int, a: float, b: float) -> float:
    """Return the signed arc length from a to b on curve c, the short way round."""
    length = curves.arcs[curves.start[c + 1] - 1]
    return float((b - a + 0.5 * length) % length - 0.5 * length)


@kernel
def half_edge_ring(mesh: Mesh, v: int, ring: IntArray) -> tuple[int, bool]:
    """Fill `ring` with the outgoing half-edges of v, counter-clockwise; return how many.

    Those of a boundary vertex start at its first face. The second value tells whether the ring is
    closed. The number is -1 where the ring is longer than `MAX_RING`.
    """
    first = mesh.out[v]
    h = first
    steps = 0
    while mesh.twins[h] >= 0 and steps <= MAX_RING:
        h = following(mesh.twins[h])
        steps += 1
        if h == first:
            break
    first = h
    n = 0
    closed = False
    while n < MAX_RING:
        ring[n] = h
        n += 1
        h = mesh.twins[preceding(h)]
        if h == first:
            closed = True
            break
        if h < 0:
            break
    if n >= MAX_RING:
        return -1, closed
    return n, closed


@kernel
def neighbours(mesh: Mesh, v: int, ring: IntArray, around: IntArray) -> tuple[int, int]:
    """Fill `around` with the neighbours of v; return their number and that of the faces."""
    n, closed = half_edge_ring(mesh, v, ring)
    if n < 0:
        return -1, -1
    for i in range(n):
        around[i] = origin(mesh.faces, following(ring[i]))
    if closed:
        return n, n
    around[n] = origin(mesh.faces, preceding(ring[n - 1]))
    return n + 1, n


@kernel(inline="always")
def area_vector(a: FloatArray, b: FloatArray, c: FloatArray) -> tuple[float, float, float]:
    """Return twice the vector area of a triangle."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx


@kernel(inline="always")
def squared_distance(a: FloatArray, b: FloatArray) -> float:
    """Return the squared distance of two points."""
    return float((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2)


@kernel
def pair(mesh: Mesh, h: int, t: int, k: int) -> None:
    """Make two half-edges twins (t may be -1) on curve k (-1 for none)."""
    mesh.twins[h] = t
    mesh.feature[h] = k
    if t >= 0:
        mesh.twins[t] = h
        mesh.feature[t] = k


@kernel
def turns_little(
    mesh: Mesh, v: int, a: int, b: int, position: FloatArray, refuse_slivers: bool
) -> bool:
    """Return whether the face (v, a, b) keeps its side when v moves, optionally its fatness."""
    pa, pb = mesh.positions[a], mesh.positions[b]
    ox, oy, oz = area_vector(mesh.positions[v], pa, pb)
    nx, ny, nz = area_vector(position, pa, pb)
    old, new = np.sqrt(ox * ox + oy * oy + oz * oz), np.sqrt(nx * nx + ny * ny + nz * nz)
    before = max(squared_distance(mesh.positions[v], pa), squared_distance(mesh.positions[v], pb))
    before = max(before, squared_distance(pa, pb))
    after = max(squared_distance(position, pa), squared_distance(position, pb))
    after = max(after, squared_distance(pa, pb))
    if refuse_slivers and new < FLATTEST * after and new * before < old * after:
        return False
    if old < 1e-6 * before:  # a triangle without a direction of its own may turn anywhere
        return True
    return bool(ox * nx + oy * ny + oz * nz > SAME_SIDE * old * new)


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """A mesh between two passes: exact-size arrays, nothing removed; fields as in `Mesh`."""

    vertices: FloatArray
    faces: IntArray
    labels: IntArray
    target: FloatArray
    curve: IntArray
    along: FloatArray
    feature: IntArray


def opened(grid: Grid, n_new: int, twins: IntArray, n_curves: int) -> Mesh:
    """Return a mesh that passes can change, with room for new vertices."""
    n_vertices, n_faces = len(grid.vertices), len(grid.faces)
    out = np.full(n_vertices, -1, dtype=np.int64)
    out[grid.faces.ravel()] = np.arange(3 * n_faces)
    on_curve = np.bincount(grid.curve[grid.curve >= 0], minlength=max(n_curves, 1))

    def grown(array: np.ndarray, extra: int) -> np.ndarray:
        return np.concatenate([array, np.zeros((extra, *array.shape[1:]), dtype=array.dtype)])

    return Mesh(
        positions=grown(grid.vertices, n_new),
        target=grown(grid.target, n_new),
        curve=grown(grid.curve, n_new),
        along=grown(grid.along, n_new),
        out=grown(out, n_new),
        faces=grown(grid.faces, 2 * n_new),
        label=grown(grid.labels, 2 * n_new),
        twins=grown(twins, 6 * n_new),
        feature=grown(grid.feature, 6 * n_new),
        counts=np.array([n_vertices, n_faces], dtype=np.int64),
        on_curve=on_curve.astype(np.int64),
    )


def closed(mesh: Mesh) -> Grid:
    """Return what is left of a mesh after a pass."""
    n_vertices, n_faces = int(mesh.counts[0]), int(mesh.counts[1])
    kept_faces = np.flatnonzero(mesh.faces[:n_faces, 0] >= 0)
    kept = np.flatnonzero(mesh.out[:n_vertices] >= 0)
    index = np.full(n_vertices, -1, dtype=np.int64)
    index[kept] = np.arange(len(kept))
    feature = mesh.feature[: 3 * n_faces].reshape(-1, 3)[kept_faces]
    return Grid(
        vertices=mesh.positions[kept],
        faces=np.ascontiguousarray(index[mesh.faces[kept_faces]]),
        labels=mesh.label[kept_faces],
        target=mesh.target[kept],
        curve=mesh.curve[kept],
        along=mesh.along[kept],
        feature=feature.ravel(),
    )
