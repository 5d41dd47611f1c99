"""Distances between surfaces, weighted by area and in both directions.

Integrals over a surface are sums over its vertices, each with a third of the area of the
triangles around it. Closest points are searched on the triangles of the other surface.
"""

from dataclasses import dataclass

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.surface import (
    SurfaceTree,
    closest_points,
    moved_tree,
    surface_tree,
    vertex_areas,
    weighted_quantile,
)


@dataclass(frozen=True, slots=True, eq=False)
class ComparedSurface:
    """A surface prepared once for all that is compared with it.

    Attributes
    ----------
    tree : SurfaceTree
    points : (V, 3) float64, mm
        The vertices that have area.
    weights : (V,) float64
        Their shares of the area, sum 1.
    """

    tree: SurfaceTree
    points: FloatArray
    weights: FloatArray


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


def compared_surface(vertices: FloatArray, faces: IntArray) -> ComparedSurface:
    """Prepare a surface, vertices (V, 3) in mm and faces (G, 3), for comparison."""
    areas = vertex_areas(vertices, faces)
    used = areas > 0.0
    return ComparedSurface(
        surface_tree(vertices, faces), vertices[used], areas[used] / areas[used].sum()
    )


def surface_distances(
    shapes: FloatArray, shape_faces: IntArray, vertices: FloatArray, faces: IntArray
) -> tuple[SurfaceDistance, ...]:
    """Return the distance of each of several shapes with shared triangles to one surface.

    Parameters
    ----------
    shapes : (R, P, 3) float64, mm
    shape_faces : (F, 3) int64
    vertices : (V, 3) float64, mm
        The surface compared to; where there are more shapes to come, prepare it once with
        `compared_surface` and call `distances_from`.
    faces : (G, 3) int64
    """
    return distances_from(compared_surface(vertices, faces), shapes, shape_faces)


def distances_from(
    surface: ComparedSurface, shapes: FloatArray, shape_faces: IntArray
) -> tuple[SurfaceDistance, ...]:
    """Return the distance of a surface from each of several shapes with shared triangles.

    Shapes that follow each other are supposed to be alike (reconstructions with more and more
    modes): every search begins where the one before it ended, and their trees differ in the boxes
    alone.

    Parameters
    ----------
    surface : ComparedSurface
    shapes : (R, P, 3) float64, mm
    shape_faces : (F, 3) int64
    """
    results = []
    there = back = tree = None
    for shape in shapes:
        tree = surface_tree(shape, shape_faces) if tree is None else moved_tree(tree, shape)
        forward = closest_points(surface.tree, shape, there)  # P
        backward = closest_points(tree, surface.points, back)  # V
        there, back = forward.faces, backward.faces
        areas = vertex_areas(shape, shape_faces)
        weights = np.concatenate([areas / areas.sum(), surface.weights])
        pooled = np.concatenate([forward.distances, backward.distances])
        results.append(
            SurfaceDistance(
                mean=0.5 * float(weights @ pooled),
                p95=weighted_quantile(pooled, weights, 0.95),
                maximum=float(pooled.max()),
            )
        )
    return tuple(results)


def diameter(points: FloatArray) -> float:
    """Return the bounding-box diagonal in mm of points (n, 3)."""
    return float(np.linalg.norm(points.max(axis=0) - points.min(axis=0)))
