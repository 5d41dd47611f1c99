"""Whether the resampled surface still covers the original (design 6): the alarm for collapse."""

from collections.abc import Sequence
from dataclasses import dataclass

from ostiform.arrays import FloatArray, IntArray
from ostiform.evaluation.distances import diameter
from ostiform.evaluation.generalisation import OriginalMesh
from ostiform.surface import (
    closest_points,
    moved_tree,
    surface_tree,
    vertex_areas,
    weighted_quantile,
)


@dataclass(frozen=True, slots=True)
class Coverage:
    """How a shape's sampled surface covers its original surface.

    Attributes
    ----------
    p95, maximum : float, mm
        Distance from the original surface to the sampled one: 95 % over area, and the largest
        over the vertices.
    diameter : float, mm
        Bounding-box diagonal of the original.
    smallest_share : float
        Smallest area share of a point, relative to the mean share.
    smallest_share_ratio : float
        Smallest ratio of a point's area share to its share in the initial sampling.
    """

    p95: float
    maximum: float
    diameter: float
    smallest_share: float
    smallest_share_ratio: float

    @property
    def relative_maximum(self) -> float:
        """Largest distance as a share of the diameter."""
        return self.maximum / self.diameter


def shape_coverage(
    original: OriginalMesh, points: FloatArray, initial_points: FloatArray, faces: IntArray
) -> Coverage:
    """Measure how the sampled surface of one shape covers its original surface.

    Parameters
    ----------
    original : OriginalMesh
    points : (P, 3) float64, mm
        The sampled shape, in the original's coordinates.
    initial_points : (P, 3) float64, mm
        The same shape sampled at the same template without any warp.
    faces : (F, 3) int64
        Triangles of the template.
    """
    return population_coverage([original], points[None], initial_points[None], faces)[0]


def population_coverage(
    originals: Sequence[OriginalMesh],
    points: FloatArray,
    initial_points: FloatArray,
    faces: IntArray,
) -> tuple[Coverage, ...]:
    """Measure the coverage of N shapes: points (N, P, 3), and else as `shape_coverage`."""
    found = []
    tree = surface_tree(points[0], faces)
    for original, own, initial in zip(originals, points, initial_points, strict=True):
        tree = moved_tree(tree, own)
        distances = closest_points(tree, original.vertices).distances  # (V,)
        areas = vertex_areas(original.vertices, original.faces)
        shares = _shares(own, faces)
        found.append(
            Coverage(
                p95=weighted_quantile(distances, areas, 0.95),
                maximum=float(distances[areas > 0.0].max()),
                diameter=diameter(original.vertices),
                smallest_share=float(shares.min()) * len(own),
                smallest_share_ratio=float((shares / _shares(initial, faces)).min()),
            )
        )
    return tuple(found)


def _shares(points: FloatArray, faces: IntArray) -> FloatArray:
    areas = vertex_areas(points, faces)
    shares: FloatArray = areas / areas.sum()
    return shares
