"""How far a map is from G1 across a seam (HY 2.2; definition in design 3).

HY argue that a conformal map on either side with the same boundary values joins with a continuous
tangent plane. That holds for truly conformal maps only, which rims on given circles exclude, so
the jump is measured: the derivative of the map across the seam, on its two sides.
"""

from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components, dijkstra

from ostiform.arrays import BoolArray, FloatArray, IntArray
from ostiform.domain import Circle, Sphere, tangent_frame
from ostiform.embedding.types import SeamJump
from ostiform.errors import TopologyError
from ostiform.surface import (
    Component,
    Seam,
    edge_faces,
    face_normals,
    half_edges,
    local_frames,
    unique_edges,
    weighted_quantile,
)

# Where the mesh's own floor is measured: this far either side of the seam, halved while no closed
# edge path exists there.
FLOOR_OFFSET = np.radians(10.0)
LEAST_FLOOR_OFFSET = np.radians(1.0)


class OneSidedDerivatives(NamedTuple):
    """Derivatives of a map across a closed edge path, at each of its n vertices.

    Attributes
    ----------
    right, left : (n, 3) float64
        Per mm, along the surface co-normal that points to the left, averaged over the fan of
        faces on either side by area: g- and g+ of design 3.
    lengths : (n,) float64, mm
        Half the length of the two path edges at each vertex.
    """

    right: FloatArray
    left: FloatArray
    lengths: FloatArray

    @property
    def relative_jump(self) -> FloatArray:
        """``|g+ - g-| / ((|g+| + |g-|) / 2)`` at each vertex (n,)."""
        size = 0.5 * (np.linalg.norm(self.left, axis=1) + np.linalg.norm(self.right, axis=1))
        jump: FloatArray = np.linalg.norm(self.left - self.right, axis=1) / size
        return jump


def seam_jump(component: Component, sphere: Sphere, directions: FloatArray, seam: Seam) -> SeamJump:
    """Return the jump of the co-normal derivative of a map across a seam, and its floor.

    Parameters
    ----------
    component : Component
    sphere : Sphere
    directions : (V, 3) float64
        Unit vectors.
    seam : Seam
        One of the component's.

    Returns
    -------
    jump : SeamJump
        `floor_mean` is the mean over both closed edge paths ten degrees either side of the
        seam's circle (nearer where holes are in the way); NaN where none exists.
    """
    circle = sphere.seams[seam]
    across = one_sided_derivatives(component, directions, component.seams[seam])
    jumps, weights = across.relative_jump, across.lengths / across.lengths.sum()
    plus = np.linalg.norm(across.left, axis=1)
    minus = np.linalg.norm(across.right, axis=1)
    turned = np.arctan2(
        np.linalg.norm(np.cross(across.left, across.right), axis=1),
        np.einsum("na,na->n", across.left, across.right),
    )
    floors = [_floor(component, directions, circle, sign) for sign in (-1.0, 1.0)]
    measured = [floor for floor in floors if floor is not None]
    return SeamJump(
        mean=float(weights @ jumps),
        p95=weighted_quantile(jumps, weights, 0.95),
        floor_mean=float(np.mean(measured)) if measured else float("nan"),
        kink=float(weights @ (plus / minus)),
        shear=float(weights @ turned),
    )


def one_sided_derivatives(
    component: Component, directions: FloatArray, path: IntArray
) -> OneSidedDerivatives:
    """Return the derivatives of a map across a closed edge path, on its right and on its left.

    The derivative is taken at each vertex in the plane of each face around it, along the
    co-normal ``n x t`` (n the face normal, t the path's direction there), which points to the
    left, and averaged over the faces on one side, weighted by area.

    Parameters
    ----------
    component : Component
    directions : (V, 3) float64
        Unit vectors.
    path : (n,) int64
        A simple closed path along edges inside the surface that separates it.

    Raises
    ------
    TopologyError
        If the path does not separate the surface.
    """
    vertices, faces = component.vertices, component.faces
    rank = np.full(len(vertices), -1, dtype=np.int64)
    rank[path] = np.arange(len(path))
    touching = np.flatnonzero((rank[faces] >= 0).any(axis=1))
    is_left = _faces_on_left(faces[touching], path, len(vertices))
    ahead, behind = vertices[np.roll(path, -1)], vertices[np.roll(path, 1)]
    tangents = ahead - behind  # (n, 3)
    frames = local_frames(vertices, faces[touching])
    derivatives = frames.derivatives(directions, faces[touching])  # (T, 3, 2)
    normals = face_normals(vertices, faces[touching])  # (T, 3)
    sums = np.zeros((2, len(path), 3))
    areas = np.zeros((2, len(path)))
    for corner in range(3):
        at = rank[faces[touching, corner]]
        met = np.flatnonzero(at >= 0)
        conormal = np.cross(normals[met], tangents[at[met]])  # (m, 3)
        length = np.linalg.norm(conormal, axis=1, keepdims=True)
        conormal = conormal / np.where(length > 0.0, length, 1.0)
        in_frame = np.einsum("mba,ma->mb", frames.axes[met], conormal)
        along = np.einsum("mab,mb->ma", derivatives[met], in_frame)  # (m, 3)
        side = is_left[met].astype(np.int64)
        np.add.at(sums, (side, at[met]), frames.areas[met, None] * along)
        np.add.at(areas, (side, at[met]), frames.areas[met])
    means = sums / areas[:, :, None]
    steps = np.linalg.norm(ahead - vertices[path], axis=1)
    return OneSidedDerivatives(means[0], means[1], 0.5 * (steps + np.roll(steps, 1)))


def loop_near_circle(
    component: Component,
    directions: FloatArray,
    center: FloatArray,
    angle: float,
    within: float = np.pi,
) -> IntArray | None:
    """Return the closed edge path once about a centre that stays nearest to a circle.

    The shortest path, by ``length on the sphere x (1 + (distance from the circle / median
    edge)^2)``, from a vertex to itself in the double cover that the azimuth makes. Vertices of
    rims and seams are avoided.

    Parameters
    ----------
    component : Component
    directions : (V, 3) float64
        Unit vectors.
    center : (3,) float64
        Unit vector.
    angle : float
        Angular radius of the circle, radians.
    within : float
        How far from the circle the path may run, radians.

    Returns
    -------
    path : (n,) int64 or None
        Counter-clockwise about the centre seen from outside; None where holes are in the way.
    """
    n_vertices = len(directions)
    free = np.ones(n_vertices, dtype=np.bool_)
    for curve in (*component.rims.values(), *component.seams.values()):
        free[curve] = False
    polar = np.arccos(np.clip(directions @ center, -1.0, 1.0))
    free &= np.abs(polar - angle) < within
    edges = unique_edges(component.faces[free[component.faces].any(axis=1)])[0]
    edges = edges[free[edges].all(axis=1)]
    if not len(edges):
        return None
    lengths = np.linalg.norm(directions[edges[:, 1]] - directions[edges[:, 0]], axis=1)
    distance = np.abs(polar[edges] - angle).mean(axis=1) / np.median(lengths)
    weights = np.maximum(lengths * (1.0 + distance**2), np.finfo(np.float64).tiny)
    e1, e2 = tangent_frame(center)
    azimuth = np.arctan2(directions @ e2, directions @ e1)
    crosses = np.abs(azimuth[edges[:, 1]] - azimuth[edges[:, 0]]) > np.pi
    start, end = edges.T
    other = np.where(crosses, n_vertices, 0)
    rows = np.concatenate([start, start + n_vertices])
    columns = np.concatenate([end + other, end + n_vertices - other])
    graph = sparse.coo_array(
        (np.tile(weights, 2), (rows, columns)), shape=(2 * n_vertices, 2 * n_vertices)
    ).tocsr()
    usable = np.unique(edges)
    source = int(usable[np.argmin(np.abs(polar[usable] - angle))])
    _, trees = dijkstra(graph, directed=False, indices=[source], return_predecessors=True)
    before = trees[0]
    if before[source + n_vertices] < 0:
        return None
    path = []
    here = source + n_vertices
    while here != source:
        here = int(before[here])
        path.append(here % n_vertices)
    loop = np.array(path, dtype=np.int64)
    turn = azimuth[np.roll(loop, -1)] - azimuth[loop]
    turned = (np.remainder(turn + np.pi, 2.0 * np.pi) - np.pi).sum()
    if len(np.unique(loop)) < len(loop) or abs(abs(turned) - 2.0 * np.pi) > 1e-6:
        return None
    return loop if turned > 0.0 else loop[::-1].copy()


def _floor(
    component: Component, directions: FloatArray, circle: Circle, sign: float
) -> float | None:
    offset = FLOOR_OFFSET
    while offset >= LEAST_FLOOR_OFFSET:
        angle = circle.radius + sign * offset
        path = loop_near_circle(component, directions, circle.center, angle, offset)
        if path is not None:
            across = one_sided_derivatives(component, directions, path)
            return float(across.lengths @ across.relative_jump / across.lengths.sum())
        offset *= 0.5
    return None


def _faces_on_left(faces: IntArray, path: IntArray, n_vertices: int) -> BoolArray:
    """Which of the faces that touch a closed path (F,) are on its left: they form two strips."""
    edges, sides = edge_faces(faces)
    following = np.roll(path, -1)
    cut = np.minimum(path, following) * n_vertices + np.maximum(path, following)
    joined = (sides[:, 1] >= 0) & ~np.isin(edges[:, 0] * n_vertices + edges[:, 1], cut)
    links = sparse.coo_array(
        (np.ones(int(joined.sum()), dtype=np.int8), (sides[joined, 0], sides[joined, 1])),
        shape=(len(faces), len(faces)),
    )
    _, labels = connected_components(links, directed=False)
    directed = half_edges(faces)
    keys = directed[:, 0] * n_vertices + directed[:, 1]
    left = labels[np.flatnonzero(np.isin(keys, path * n_vertices + following)) // 3]
    right = labels[np.flatnonzero(np.isin(keys, following * n_vertices + path)) // 3]
    if np.intersect1d(left, right).size or not left.size or not right.size:
        raise TopologyError(
            f"expected a closed path that separates the surface, found one of {len(path)} "
            "vertices with the same faces on both sides"
        )
    on_left: BoolArray = np.isin(labels, left)
    return on_left
