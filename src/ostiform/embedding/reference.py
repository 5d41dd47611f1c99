"""The flat triangles that a map starts from: those of the surface, or equilateral ones."""

from typing import Annotated

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.surface import local_frames
from ostiform.values import Axes, value

# Triangles longer than this (longest edge x perimeter / (4 sqrt(3) area), 1 when equilateral) get
# an equilateral reference: the shape of a sliver is noise of the mesh, and would cap every step.
SLIVER_ASPECT = 10.0

# A triangle collapsed to a point gets a reference of this share of the median edge.
LEAST_EDGE = 1e-2


@value
class ReferenceTriangles:
    """The flat triangles that a map starts from.

    Attributes
    ----------
    gradients : (F, 3, 2) float64
        Gradient of each corner's hat function.
    areas : (F,) float64
        In steradians: their sum is the area of the domain to be covered.
    """

    gradients: Annotated[FloatArray, Axes("F", 3, 2)]
    areas: Annotated[FloatArray, Axes("F")]


def surface_reference(
    vertices: FloatArray,
    faces: IntArray,
    total_area: float,
    scales: FloatArray | None = None,
) -> ReferenceTriangles:
    """Return the triangles of a surface as references, scaled to a total area.

    Slivers (see `SLIVER_ASPECT`) are replaced by equilateral triangles of the same mean edge.

    Parameters
    ----------
    vertices : (V, 3) float64, mm
    faces : (F, 3) int64
    total_area : float
        Area of the domain, steradians.
    scales : (F,) float64, optional
        Length scale of each triangle before that; 1 by default.
    """
    frames = local_frames(vertices, faces)
    corners = vertices[faces]  # (F, 3, 3)
    lengths = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)  # (F, 3)
    perimeter = lengths.sum(axis=1)
    aspect = lengths.max(axis=1) * perimeter
    is_sliver = aspect >= SLIVER_ASPECT * 4.0 * np.sqrt(3.0) * frames.areas
    edge = np.maximum(perimeter / 3.0, LEAST_EDGE * np.median(perimeter / 3.0))
    gradients = np.where(
        is_sliver[:, None, None], _equilateral_gradients() / edge[:, None, None], frames.gradients
    )
    areas = np.where(is_sliver, np.sqrt(3.0) / 4.0 * edge**2, frames.areas)
    scale = np.ones(len(faces)) if scales is None else scales**2
    scale = scale * (total_area / float(scale @ frames.areas))  # (F,)
    return ReferenceTriangles(gradients / np.sqrt(scale)[:, None, None], areas * scale)


def equilateral_reference(areas: FloatArray) -> ReferenceTriangles:
    """Return equilateral triangles of areas (F,), the reference of the untangling."""
    edges = np.sqrt(4.0 * areas / np.sqrt(3.0))
    return ReferenceTriangles(_equilateral_gradients() / edges[:, None, None], areas)


def _equilateral_gradients() -> FloatArray:
    """Hat gradients (3, 2) of the triangle (0, 0), (1, 0), (1/2, sqrt(3)/2)."""
    height = np.sqrt(3.0) / 2.0
    return np.array([[-1.0, -0.5 / height], [1.0, -0.5 / height], [0.0, 1.0 / height]])
