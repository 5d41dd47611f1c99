"""Distances between surfaces, weighted by area and in both directions.

Integrals over a surface are sums over its vertices, each with a third of the area of the
triangles around it. Closest points are searched on the triangles of the other surface.
"""

from dataclasses import dataclass

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.surface import SurfaceTree, surface_tree, vertex_areas, weighted_quantile


@dataclass(frozen=True, slots=True)
class SurfaceDistance:
    """Distance between two surfaces, mm.

    Attributes
    ----------
    mean : float
        Mean of the two area-weighted mean distances, one per direction.
    p95 : float
        95 % of the distance over both surfaces, pooled with half of the weight each.
    maximum : float
        Largest over the vertices of both.
    """

    mean: float
    p95: float
    maximum: float


def surface_distances(
    shapes: FloatArray, shape_faces: IntArray, vertices: FloatArray, faces: IntArray
) -> tuple[SurfaceDistance, ...]:
    """Return the distance of each of several shapes with shared triangles to one surface.

    Parameters
    ----------
    shapes : (R, P, 3) float64, mm
    shape_faces : (F, 3) int64
    vertices : (V, 3) float64, mm
        The surface compared to; its search tree is built once.
    faces : (G, 3) int64
    """
    tree = surface_tree(vertices, faces)
    areas = vertex_areas(vertices, faces)  # (V,)
    used = areas > 0.0
    targets, target_weights = vertices[used], areas[used] / (2.0 * areas.sum())
    results = []
    for shape in shapes:
        forward = _distances(tree, np.ascontiguousarray(shape))  # (P,)
        backward = _distances(surface_tree(shape, shape_faces), targets)  # (V,)
        shape_areas = vertex_areas(shape, shape_faces)
        forward_weights = shape_areas / (2.0 * shape_areas.sum())
        pooled = np.concatenate([forward, backward])
        results.append(
            SurfaceDistance(
                mean=float(forward_weights @ forward + target_weights @ backward),
                p95=weighted_quantile(
                    pooled, np.concatenate([forward_weights, target_weights]), 0.95
                ),
                maximum=float(pooled.max()),
            )
        )
    return tuple(results)


def diameter(points: FloatArray) -> float:
    """Return the bounding-box diagonal in mm of points (n, 3)."""
    return float(np.linalg.norm(points.max(axis=0) - points.min(axis=0)))


def _distances(tree: SurfaceTree, points: FloatArray) -> FloatArray:
    squared, _, _ = tree.boxes.squared_distance(tree.vertices, tree.faces, points)
    distances: FloatArray = np.sqrt(squared)
    return distances
