"""Closest points on a surface, and distances between surfaces weighted by area."""

from dataclasses import dataclass

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.errors import InputError
from ostiform.surface.box_kernels import fitted, halved, nearest


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceTree:
    """A surface with its bounding-box tree, prepared for many closest-point queries.

    Attributes
    ----------
    vertices : (V, 3) float64, mm
    faces : (F, 3) int64
    right : (2 F - 1,) int64
        The tree's nodes; see `box_kernels`.
    boxes : (2 F - 1, 6) float64, mm
        Of the nodes.
    """

    vertices: FloatArray
    faces: IntArray
    right: IntArray
    boxes: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class ClosestPoints:
    """The closest point of a surface to each query.

    Attributes
    ----------
    points : (n, 3) float64, mm
    faces : (n,) int64
        The triangle that holds each point.
    barycentric : (n, 3) float64
        Its coordinates there, non-negative, sum 1.
    distances : (n,) float64, mm
        Unsigned, from the query.
    """

    points: FloatArray
    faces: IntArray
    barycentric: FloatArray
    distances: FloatArray


@dataclass(frozen=True, slots=True)
class SurfaceDistance:
    """How far one surface is from another, in one direction, weighted by area.

    Attributes
    ----------
    mean, p95, maximum : float, mm
        Area-weighted mean and 95th percentile, and the largest distance.
    """

    mean: float
    p95: float
    maximum: float


def surface_tree(vertices: FloatArray, faces: IntArray) -> SurfaceTree:
    """Prepare a surface for closest-point queries.

    Raises
    ------
    InputError
        If there is no face.
    """
    if len(faces) == 0:
        raise InputError("faces: expected a surface with at least one triangle, found none")
    vertices = np.ascontiguousarray(vertices, dtype=np.float64)
    faces = np.ascontiguousarray(faces, dtype=np.int64)
    right = halved(vertices, faces)
    return SurfaceTree(vertices, faces, right, fitted(vertices, faces, right))


def moved_tree(tree: SurfaceTree, vertices: FloatArray) -> SurfaceTree:
    """Return the tree of the same triangles with their vertices (V, 3) elsewhere, mm.

    Much faster than a new one, and as good while neighbours stay neighbours.
    """
    vertices = np.ascontiguousarray(vertices, dtype=np.float64)
    boxes = fitted(vertices, tree.faces, tree.right)
    return SurfaceTree(vertices, tree.faces, tree.right, boxes)


def closest_points(
    tree: SurfaceTree, points: FloatArray, near: IntArray | None = None
) -> ClosestPoints:
    """Return the closest point of a surface to each of (n, 3) points in millimetres.

    Parameters
    ----------
    tree : SurfaceTree
    points : (n, 3) float64, mm
    near : (n,) int64, optional
        A triangle supposed to be near each point. It makes the search faster, not different.
    """
    queries = np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 3)
    if near is None:
        near = np.full(len(queries), -1)
    squared, faces, barycentric = nearest(
        tree.vertices, tree.faces, tree.right, tree.boxes, queries, near
    )
    return ClosestPoints(
        points=np.einsum("nc,nck->nk", barycentric, tree.vertices[tree.faces[faces]]),
        faces=faces,
        barycentric=barycentric,
        distances=np.sqrt(squared),
    )


def distances_to_surface(points: FloatArray, vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Return the unsigned distance (n,) in millimetres of each point (n, 3) from a surface.

    For several queries of one surface, prepare it once with `surface_tree`.
    """
    return closest_points(surface_tree(vertices, faces), points).distances
