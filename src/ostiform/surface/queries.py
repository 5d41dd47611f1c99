"""Closest points on a surface, and distances between surfaces weighted by area."""

from dataclasses import dataclass

import igl
import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.errors import InputError
from ostiform.surface.quantiles import weighted_quantile


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceTree:
    """A surface with its bounding-box tree, prepared for many closest-point queries.

    Attributes
    ----------
    vertices : (V, 3) float64, mm
    faces : (F, 3) int64
    boxes : igl.AABB
        Tree of the axis-aligned boxes of the faces.
    """

    vertices: FloatArray
    faces: IntArray
    boxes: igl.AABB


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
    boxes = igl.AABB()
    boxes.init(vertices, faces)
    return SurfaceTree(vertices, faces, boxes)


def closest_points(tree: SurfaceTree, points: FloatArray) -> ClosestPoints:
    """Return the closest point of a surface to each of (n, 3) points in millimetres."""
    queries = np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 3)
    if len(queries) == 0:
        none = np.zeros((0, 3))
        return ClosestPoints(none, np.zeros(0, dtype=np.int64), none, np.zeros(0))
    squared, index, found = tree.boxes.squared_distance(tree.vertices, tree.faces, queries)
    face = np.asarray(index, dtype=np.int64).reshape(-1)
    closest = np.asarray(found, dtype=np.float64).reshape(-1, 3)
    return ClosestPoints(
        points=closest,
        faces=face,
        barycentric=_barycentric(tree.vertices[tree.faces[face]], closest),
        distances=np.sqrt(np.maximum(np.asarray(squared, dtype=np.float64).reshape(-1), 0.0)),
    )


def distances_to_surface(points: FloatArray, vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Return the unsigned distance (n,) in millimetres of each point (n, 3) from a surface.

    For several queries of one surface, prepare it once with `surface_tree`.
    """
    return closest_points(surface_tree(vertices, faces), points).distances


def surface_distance(vertices: FloatArray, faces: IntArray, target: SurfaceTree) -> SurfaceDistance:
    """Return the area-weighted distance from a surface to another.

    The distance is evaluated at the vertices and at the centroids of the faces; each triangle
    counts them 1 : 1 : 1 : 9, the rule that integrates quadratic functions exactly. Vertices that
    no face uses do not count.

    Parameters
    ----------
    vertices : (V, 3) float64, mm
    faces : (F, 3) int64
    target : SurfaceTree
    """
    corners = vertices[faces]  # (F, 3, 3)
    areas = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )  # (F,)
    shares = np.bincount(faces.ravel(), np.repeat(areas / 12.0, 3), minlength=len(vertices))
    used = np.bincount(faces.ravel(), minlength=len(vertices)) > 0
    weights = np.concatenate([shares[used], 0.75 * areas])
    distances = closest_points(target, np.concatenate([vertices[used], corners.mean(axis=1)]))
    values = distances.distances
    return SurfaceDistance(
        mean=float(weights @ values / weights.sum()),
        p95=weighted_quantile(values, weights, 0.95),
        maximum=float(values.max()),
    )


def _barycentric(corners: FloatArray, points: FloatArray) -> FloatArray:
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]  # (n, 3)
    normal = np.cross(b - a, c - a)
    weights = np.stack(
        [
            np.einsum("ni,ni->n", normal, np.cross(b - points, c - points)),
            np.einsum("ni,ni->n", normal, np.cross(c - points, a - points)),
            np.einsum("ni,ni->n", normal, np.cross(a - points, b - points)),
        ],
        axis=1,
    )  # (n, 3)
    weights = np.maximum(weights, 0.0)
    total = weights.sum(axis=1, keepdims=True)
    flat = total[:, 0] <= 0.0  # triangles without area: their nearest corner
    if flat.any():
        nearest = np.linalg.norm(corners[flat] - points[flat][:, None], axis=2).argmin(axis=1)
        weights[flat] = np.eye(3)[nearest]
        total[flat] = 1.0
    barycentric: FloatArray = weights / total
    return barycentric
