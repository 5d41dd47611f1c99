"""Local changes of a triangulation that keep its marked curves valid: split, collapse, flip.

Marked curves are closed vertex cycles of two kinds: rims (boundary loops) and inner curves
(seams). Every function returns a new mesh; none moves a vertex that survives.
"""

from dataclasses import dataclass

import numpy as np

from ostiform.arrays import BoolArray, FloatArray, IntArray, read_only
from ostiform.compiled import kernel

# A collapse may turn a triangle by at most 60 degrees.
LEAST_COSINE = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class MarkedMesh:
    """A triangulation with marked curves, in the middle of repairs (arrays are not checked).

    Attributes
    ----------
    vertices : (V, 3) float64
    faces : (F, 3) int64
    face_part : (F,) int64
    curves : tuple of (n,) int64
        Closed vertex cycles: rims and seams.
    """

    vertices: FloatArray
    faces: IntArray
    face_part: IntArray
    curves: tuple[IntArray, ...]

    @property
    def curve_of_vertex(self) -> IntArray:
        """Index (V,) of the curve each vertex lies on, -1 elsewhere."""
        index = np.full(len(self.vertices), -1, dtype=np.int64)
        for number, curve in enumerate(self.curves):
            index[curve] = number
        return index

    @property
    def curve_edges(self) -> IntArray:
        """Edges (K, 2) of all curves, in order along each."""
        pairs = [np.stack([curve, np.roll(curve, -1)], axis=1) for curve in self.curves]
        return np.concatenate([np.empty((0, 2), dtype=np.int64), *pairs])

    def edge_keys(self, edges: IntArray) -> IntArray:
        """One integer (K,) per undirected edge of (K, 2)."""
        keys: IntArray = edges.min(axis=1) * len(self.vertices) + edges.max(axis=1)
        return keys


def split_edges(mesh: MarkedMesh, edges: IntArray) -> MarkedMesh:
    """Insert the midpoint of every given edge (K, 2); the surface does not change as a point set.

    A triangle with one, two or three split edges becomes two, three or four; where two are split
    the remaining quadrilateral is cut along its shorter diagonal. A midpoint of an edge of a curve
    joins the curve.
    """
    if not len(edges):
        return mesh
    n_vertices = len(mesh.vertices)
    keys = np.unique(mesh.edge_keys(edges))  # (K,)
    ends = np.stack(np.divmod(keys, n_vertices), axis=1)
    vertices = np.concatenate([mesh.vertices, 0.5 * mesh.vertices[ends].sum(axis=1)])
    middle = _midpoint_of_half_edges(mesh, keys)  # (F, 3)
    n_split = (middle >= 0).sum(axis=1)
    blocks, parents = [mesh.faces[n_split == 0]], [np.flatnonzero(n_split == 0)]
    for count, pattern in ((1, _halves), (2, _thirds), (3, _quarters)):
        chosen = np.flatnonzero(n_split == count)
        corners, middles = _rotated(mesh.faces[chosen], middle[chosen], count)
        for block in pattern(corners, middles, vertices):
            blocks.append(block)
            parents.append(chosen)
    return MarkedMesh(
        vertices,
        np.concatenate(blocks),
        mesh.face_part[np.concatenate(parents)],
        tuple(_refined_curve(mesh, curve, keys) for curve in mesh.curves),
    )


def split_faces(mesh: MarkedMesh, chosen: IntArray) -> MarkedMesh:
    """Insert the centroid of every given face (indices, (K,)), cutting it in three."""
    if not len(chosen):
        return mesh
    faces = mesh.faces[chosen]
    centres = len(mesh.vertices) + np.arange(len(chosen))
    kept = np.delete(np.arange(len(mesh.faces)), chosen)
    fans = [
        np.stack([faces[:, k], faces[:, (k + 1) % 3], centres], axis=1) for k in range(3)
    ]  # 3 x (K, 3)
    return MarkedMesh(
        np.concatenate([mesh.vertices, mesh.vertices[faces].mean(axis=1)]),
        np.concatenate([mesh.faces[kept], *fans]),
        np.concatenate([mesh.face_part[kept], np.tile(mesh.face_part[chosen], 3)]),
        mesh.curves,
    )


def collapsed_edges(
    mesh: MarkedMesh, kept: IntArray, removed: IntArray, least_curve: int, least_height: float
) -> tuple[MarkedMesh, int]:
    """Collapse edges `removed` -> `kept` (both (K,)) where nothing is harmed, in the given order.

    A collapse is refused where it would change the topology (link condition), turn a triangle by
    more than 60 degrees, make one whose height is below `least_height` times its longest edge,
    take a curve below `least_curve` vertices, take a vertex off its curve, or touch triangles that
    an earlier collapse of this call has touched. Give an edge in both directions to allow either
    end to stay.

    Returns
    -------
    mesh : MarkedMesh
        With the removed vertices still in `vertices`, unreferenced; see `compacted`.
    count : int
        Edges collapsed.
    """
    curve_of_vertex = mesh.curve_of_vertex
    on_curve_edge = np.isin(
        mesh.edge_keys(np.stack([kept, removed], axis=1)), mesh.edge_keys(mesh.curve_edges)
    )
    allowed = (curve_of_vertex[removed] < 0) | on_curve_edge
    target = _chosen_collapses(
        read_only(mesh.vertices),
        read_only(mesh.faces),
        _incident_faces(mesh.faces, len(mesh.vertices)),
        np.stack([kept[allowed], removed[allowed]], axis=1),
        curve_of_vertex,
        np.array([len(curve) for curve in mesh.curves] + [0], dtype=np.int64),
        least_curve,
        least_height,
    )  # (V,)
    count = int((target != np.arange(len(target))).sum())
    if not count:
        return mesh, 0
    faces = target[mesh.faces]
    alive = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    curves = tuple(curve[target[curve] == curve] for curve in mesh.curves)
    return MarkedMesh(mesh.vertices, faces[alive], mesh.face_part[alive], curves), count


def flipped_edges(mesh: MarkedMesh, faces: IntArray) -> tuple[MarkedMesh, int]:
    """Flip the longest edge of every given face (indices, (K,)) where nothing is harmed.

    Meant for caps: triangles whose third corner lies on the longest edge. Edges of curves are left,
    as are flips that would turn a triangle or make an edge that exists.
    """
    flipped = mesh.faces.copy()
    offsets, incident = _incident_faces(mesh.faces, len(mesh.vertices))
    curve_keys = set(mesh.edge_keys(mesh.curve_edges).tolist())
    touched: set[int] = set()
    count = 0
    for face in faces.tolist():
        a, b, c = _longest_edge_first(mesh.vertices, mesh.faces[face])
        key = int(min(a, b) * len(mesh.vertices) + max(a, b))
        beyond = [
            int(other)
            for other in incident[offsets[a] : offsets[a + 1]]
            if other != face and b in mesh.faces[other]
        ]
        if len(beyond) != 1 or key in curve_keys:
            continue
        d = int(mesh.faces[beyond[0]].sum() - a - b)
        ring = mesh.faces[incident[offsets[c] : offsets[c + 1]]]
        if touched & {a, b, c, d} or d in ring:
            continue
        before = _area_vector(mesh.vertices[[a, d, b]])
        first = _area_vector(mesh.vertices[[a, d, c]])
        second = _area_vector(mesh.vertices[[d, b, c]])
        if min(float(first @ before), float(second @ before)) <= 0.0:
            continue
        flipped[face], flipped[beyond[0]] = (a, d, c), (d, b, c)
        touched |= {a, b, c, d}
        count += 1
    return MarkedMesh(mesh.vertices, flipped, mesh.face_part, mesh.curves), count


def compacted(mesh: MarkedMesh) -> MarkedMesh:
    """Drop vertices that no face uses."""
    used = np.unique(mesh.faces)
    if len(used) == len(mesh.vertices):
        return mesh
    new_index = np.full(len(mesh.vertices), -1, dtype=np.int64)
    new_index[used] = np.arange(len(used))
    return MarkedMesh(
        mesh.vertices[used],
        new_index[mesh.faces],
        mesh.face_part,
        tuple(new_index[curve] for curve in mesh.curves),
    )


def _midpoint_of_half_edges(mesh: MarkedMesh, keys: IntArray) -> IntArray:
    """Index (F, 3) of the midpoint on the half-edge from each corner to the next, or -1."""
    ahead = np.roll(mesh.faces, -1, axis=1)
    half_keys = np.minimum(mesh.faces, ahead) * len(mesh.vertices) + np.maximum(mesh.faces, ahead)
    position = np.minimum(np.searchsorted(keys, half_keys), len(keys) - 1)
    middle: IntArray = np.where(keys[position] == half_keys, len(mesh.vertices) + position, -1)
    return middle


def _refined_curve(mesh: MarkedMesh, curve: IntArray, keys: IntArray) -> IntArray:
    half_keys = mesh.edge_keys(np.stack([curve, np.roll(curve, -1)], axis=1))
    position = np.minimum(np.searchsorted(keys, half_keys), len(keys) - 1)
    middle = np.where(keys[position] == half_keys, len(mesh.vertices) + position, -1)
    refined = np.stack([curve, middle], axis=1).ravel()
    return refined[refined >= 0]


def _rotated(faces: IntArray, middle: IntArray, count: int) -> tuple[IntArray, IntArray]:
    """Rotate corners so that the first `count` half-edges are the split ones."""
    is_split = middle >= 0
    if count == 1:
        first = np.argmax(is_split, axis=1)
    elif count == 2:
        first = (np.argmin(is_split, axis=1) + 1) % 3
    else:
        first = np.zeros(len(faces), dtype=np.int64)
    order = (first[:, None] + np.arange(3)) % 3  # (K, 3)
    return np.take_along_axis(faces, order, axis=1), np.take_along_axis(middle, order, axis=1)


def _halves(corners: IntArray, middles: IntArray, vertices: FloatArray) -> list[IntArray]:
    p, q, r = corners.T
    m = middles[:, 0]
    return [np.stack([p, m, r], axis=1), np.stack([m, q, r], axis=1)]


def _thirds(corners: IntArray, middles: IntArray, vertices: FloatArray) -> list[IntArray]:
    p, q, r = corners.T
    m, n = middles[:, 0], middles[:, 1]
    from_p = np.linalg.norm(vertices[n] - vertices[p], axis=1) <= np.linalg.norm(
        vertices[r] - vertices[m], axis=1
    )
    return [
        np.stack([m, q, n], axis=1),
        np.stack([p, m, np.where(from_p, n, r)], axis=1),
        np.stack([np.where(from_p, p, m), n, r], axis=1),
    ]


def _quarters(corners: IntArray, middles: IntArray, vertices: FloatArray) -> list[IntArray]:
    p, q, r = corners.T
    m, n, o = middles.T
    return [np.stack(t, axis=1) for t in ((p, m, o), (m, q, n), (o, n, r), (m, n, o))]


def _incident_faces(faces: IntArray, n_vertices: int) -> tuple[IntArray, IntArray]:
    """Faces around each vertex: ``incident[offsets[v]:offsets[v + 1]]``."""
    order = np.argsort(faces.ravel(), kind="stable")
    offsets = np.zeros(n_vertices + 1, dtype=np.int64)
    np.cumsum(np.bincount(faces.ravel(), minlength=n_vertices), out=offsets[1:])
    return offsets, order // 3


def _longest_edge_first(vertices: FloatArray, face: IntArray) -> tuple[int, int, int]:
    lengths = np.linalg.norm(vertices[np.roll(face, -1)] - vertices[face], axis=1)
    a, b, c = np.roll(face, -int(np.argmax(lengths))).tolist()
    return a, b, c


def _area_vector(corners: FloatArray) -> FloatArray:
    vector: FloatArray = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    return vector


@kernel
def _chosen_collapses(
    vertices: FloatArray,
    faces: IntArray,
    rings: tuple[IntArray, IntArray],
    candidates: IntArray,
    curve: IntArray,
    curve_size: IntArray,
    least_curve: int,
    least_height: float,
) -> IntArray:
    offsets, incident = rings
    target = np.arange(len(vertices))
    locked: BoolArray = np.zeros(len(vertices), dtype=np.bool_)
    stamp = np.full(len(vertices), -1)
    for e in range(len(candidates)):
        i, j = candidates[e]
        if locked[i] or locked[j]:
            continue
        if curve[j] >= 0 and curve_size[curve[j]] <= least_curve:
            continue
        for f in incident[offsets[i] : offsets[i + 1]]:
            for k in range(3):
                stamp[faces[f, k]] = 2 * e
        shared, common = 0, 0
        harmless = True
        around = np.zeros(3)
        for f in incident[offsets[j] : offsets[j + 1]]:
            corner = vertices[faces[f, 0]]
            around += np.cross(vertices[faces[f, 1]] - corner, vertices[faces[f, 2]] - corner)
        for f in incident[offsets[j] : offsets[j + 1]]:
            has_kept = False
            for k in range(3):
                v = faces[f, k]
                has_kept = has_kept or v == i
                if v != i and v != j and stamp[v] == 2 * e:
                    stamp[v] = 2 * e + 1
                    common += 1
            if has_kept:
                shared += 1
            elif not _stays_upright(vertices, faces[f], i, j, around, least_height):
                harmless = False
        if not harmless or shared == 0 or common != shared:
            continue
        target[j] = i
        if curve[j] >= 0:
            curve_size[curve[j]] -= 1
        for v in (i, j):
            for f in incident[offsets[v] : offsets[v + 1]]:
                for k in range(3):
                    locked[faces[f, k]] = True
    return target


@kernel
def _stays_upright(
    vertices: FloatArray,
    face: IntArray,
    kept: int,
    removed: int,
    around: FloatArray,
    least_height: float,
) -> bool:
    """Whether a triangle survives a collapse; `around` is the area vector of the vertex's fan."""
    old, new = np.empty((3, 3)), np.empty((3, 3))
    for k in range(3):
        old[k] = vertices[face[k]]
        new[k] = vertices[kept] if face[k] == removed else vertices[face[k]]
    before = np.cross(old[1] - old[0], old[2] - old[0])
    after = np.cross(new[1] - new[0], new[2] - new[0])
    longest_before, longest_after = 0.0, 0.0
    for k in range(3):
        longest_before = max(longest_before, np.sum((old[k] - old[k - 1]) ** 2))
        longest_after = max(longest_after, np.sum((new[k] - new[k - 1]) ** 2))
    size_before, size_after = np.sqrt(np.sum(before**2)), np.sqrt(np.sum(after**2))
    was_flat = size_before <= least_height * longest_before
    if size_after <= least_height * longest_after:
        return bool(was_flat)
    if was_flat:  # without a normal of its own it must agree with its fan
        return bool(np.sum(around * after) >= 0.0)
    return bool(np.sum(before * after) >= LEAST_COSINE * size_before * size_after)
