"""Discrete operators of a triangulated surface: areas, normals, Laplacians, local frames.

Pure functions of vertices (V, 3) and faces (F, 3). Vertices may be positions in mm or unit vectors;
areas come out in the square of their unit. A triangle without area has no angles: its cotangents
and gradients are those of a triangle of the same longest edge and `SLIVER_HEIGHT` of its height,
so that every value stays finite.
"""

from typing import Annotated

import numpy as np
from scipy import sparse

from ostiform.arrays import FloatArray, IntArray
from ostiform.surface.topology import unique_edges
from ostiform.values import Axes, value

# Least height of a triangle over its longest edge: far below any real sliver, far above round-off.
SLIVER_HEIGHT = 1e-10


def edge_lengths(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Return the length (E,) of every edge, in the order of `topology.unique_edges`."""
    edges = unique_edges(faces)[0]
    lengths: FloatArray = np.linalg.norm(vertices[edges[:, 1]] - vertices[edges[:, 0]], axis=1)
    return lengths


def median_edge_length(vertices: FloatArray, faces: IntArray) -> float:
    """Return the median edge length: the length scale of the mesh, blind to a few slivers."""
    return float(np.median(edge_lengths(vertices, faces)))


def face_areas(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Return the area (F,) of every triangle."""
    areas: FloatArray = 0.5 * np.linalg.norm(_area_vectors(vertices, faces), axis=1)
    return areas


def face_normals(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Return the unit normal (F, 3) of every triangle; zero for a triangle without area."""
    area_vectors = _area_vectors(vertices, faces)  # (F, 3)
    lengths = np.linalg.norm(area_vectors, axis=1, keepdims=True)
    normals: FloatArray = area_vectors / np.where(lengths > 0.0, lengths, 1.0)
    return normals


def vertex_areas(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Return the barycentric area (V,) of every vertex: a third of each triangle around it."""
    shares = np.repeat(face_areas(vertices, faces) / 3.0, 3)  # (3F,)
    areas: FloatArray = np.bincount(faces.ravel(), weights=shares, minlength=len(vertices)).astype(
        np.float64
    )
    return areas


def corner_cotangents(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Return the cotangent (F, 3) of the angle at every corner of every triangle."""
    corners = vertices[faces]  # (F, 3, 3)
    to_next = np.roll(corners, -1, axis=1) - corners
    to_previous = np.roll(corners, 1, axis=1) - corners
    longest_squared = np.einsum("fka,fka->fk", to_next, to_next).max(axis=1)
    double_areas = np.linalg.norm(_area_vectors(vertices, faces), axis=1)
    double_areas = np.maximum(double_areas, SLIVER_HEIGHT * longest_squared)
    double_areas = np.where(double_areas > 0.0, double_areas, 1.0)
    cotangents: FloatArray = (
        np.einsum("fka,fka->fk", to_next, to_previous) / double_areas[:, None]
    )  # (F, 3)
    return cotangents


def cotangent_stiffness(vertices: FloatArray, faces: IntArray) -> sparse.csr_array:
    """Return the cotangent stiffness matrix L (V, V), positive semi-definite.

    ``x' L x = sum over triangles of area |grad x|^2``: row i holds
    ``sum_j w_ij (x_i - x_j)`` with ``w_ij = (cot alpha + cot beta) / 2``, the spring constants
    of HY eq. 3 (which leaves out the factor 1/2). Constants are in its kernel.
    """
    n_vertices = len(vertices)
    weights = 0.5 * corner_cotangents(vertices, faces)  # (F, 3), of the edge opposite the corner
    start, end = np.roll(faces, -1, axis=1).ravel(), np.roll(faces, 1, axis=1).ravel()
    half = sparse.coo_array((weights.ravel(), (start, end)), shape=(n_vertices, n_vertices))
    adjacency = (half + half.T).tocsr()
    return (sparse.diags_array(np.asarray(adjacency.sum(axis=1)).ravel()) - adjacency).tocsr()


def uniform_laplacian(faces: IntArray, n_vertices: int) -> sparse.csr_array:
    """Return the graph Laplacian (V, V): the number of neighbours minus the adjacency matrix."""
    edges = unique_edges(faces)[0]
    half = sparse.coo_array(
        (np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(n_vertices, n_vertices)
    )
    adjacency = (half + half.T).tocsr()
    return (sparse.diags_array(np.asarray(adjacency.sum(axis=1)).ravel()) - adjacency).tocsr()


@value
class LocalFrames:
    """An orthonormal frame in the plane of every triangle, and the hat gradients in it.

    Attributes
    ----------
    axes : (F, 2, 3) float64
        Unit vectors u along the first edge and v = normal x u.
    gradients : (F, 3, 2) float64
        Gradient of each corner's hat function in the frame (u, v), per unit of length.
    areas : (F,) float64
    """

    axes: Annotated[FloatArray, Axes("F", 2, 3)]
    gradients: Annotated[FloatArray, Axes("F", 3, 2)]
    areas: Annotated[FloatArray, Axes("F")]

    def derivatives(self, values: FloatArray, faces: IntArray) -> FloatArray:
        """Return the derivative (F, d, 2) in (u, v) of a field (V, d) linear on each triangle."""
        derivatives: FloatArray = np.einsum("fkb,fka->fab", self.gradients, values[faces])
        return derivatives


def local_frames(vertices: FloatArray, faces: IntArray) -> LocalFrames:
    """Return the local frame, the hat gradients and the area of every triangle.

    In its frame a triangle has the corners (0, 0), (a, 0), (b, c) with a, c > 0; the gradients are
    the rows of the inverse of [[a, b], [0, c]].
    """
    corners = vertices[faces]  # (F, 3, 3)
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]  # (F, 3)
    longest = np.sqrt(
        np.maximum(
            np.einsum("fa,fa->f", first, first),
            np.maximum(
                np.einsum("fa,fa->f", second, second),
                np.einsum("fa,fa->f", second - first, second - first),
            ),
        )
    )
    longest = np.where(longest > 0.0, longest, 1.0)
    a = np.linalg.norm(first, axis=1)
    u = np.where(
        (a > 0.0)[:, None], first / np.where(a > 0.0, a, 1.0)[:, None], np.eye(3)[:1]
    )  # (F, 3)
    b = np.einsum("fa,fa->f", second, u)
    across = np.cross(first, second)  # (F, 3)
    areas = 0.5 * np.linalg.norm(across, axis=1)
    normals = _normals_or_any(across, u)
    v = np.cross(normals, u)
    a = np.maximum(a, SLIVER_HEIGHT * longest)
    c = np.maximum(2.0 * areas / a, SLIVER_HEIGHT * longest)
    gradients = np.zeros((len(faces), 3, 2))
    gradients[:, 1, 0], gradients[:, 1, 1] = 1.0 / a, -b / (a * c)
    gradients[:, 2, 1] = 1.0 / c
    gradients[:, 0] = -gradients[:, 1] - gradients[:, 2]
    return LocalFrames(np.stack([u, v], axis=1), gradients, areas)


def _area_vectors(vertices: FloatArray, faces: IntArray) -> FloatArray:
    corners = vertices[faces]
    vectors: FloatArray = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return vectors


def _normals_or_any(across: FloatArray, u: FloatArray) -> FloatArray:
    """Return the unit vectors along `across`, any unit vector normal to `u` where it is zero."""
    lengths = np.linalg.norm(across, axis=1, keepdims=True)
    smallest = np.eye(3)[np.argmin(np.abs(u), axis=1)]  # (F, 3)
    spare = np.cross(u, smallest)
    spare = spare / np.linalg.norm(spare, axis=1, keepdims=True)
    normals: FloatArray = np.where(
        lengths > 0.0, across / np.where(lengths > 0.0, lengths, 1.0), spare
    )
    return normals
