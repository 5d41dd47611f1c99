"""Sampling: where the points of the template lie on a shape, and how they move (end of HY 2.2).

An interior point is located in the spherical triangulation of its shape's embedding and
interpolated with gnomonic barycentric coordinates; a point of a rim or a seam is located by its
angle on that curve, so it lies on the input's own polyline and a seam point is one point for both
parts. The derivative of the position with respect to the direction is analytic; it jumps where a
point crosses an edge of the shape's mesh, as any piecewise linear map's does.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.correspondence.sampling_kernels import interpolated, interpolated_on_curve
from ostiform.domain import BaseDomain, Template
from ostiform.embedding import Embedding, PlacedCurve
from ostiform.errors import InputError
from ostiform.surface import (
    SurfaceTree,
    closest_points,
    containing_triangles,
    normalised,
    surface_tree,
)
from ostiform.values import Axes, value


@value
class SurfaceMarks:
    """Landmarks that a user placed on one shape.

    Attributes
    ----------
    names : tuple of str
    positions : (L, 3) float64, mm
        In the shape's input coordinates.
    sd_mm : (L,) float64
        Standard deviation of each coordinate, positive.
    """

    names: Annotated[tuple[str, ...], Axes("L")]
    positions: Annotated[FloatArray, Axes("L", 3)]
    sd_mm: Annotated[FloatArray, Axes("L")]

    def __post_init__(self) -> None:
        """Check the standard deviations."""
        if (self.sd_mm <= 0.0).any():
            raise InputError(
                f"landmark {self.names[int(self.sd_mm.argmin())]}: expected a standard deviation "
                f"above 0 mm, found {self.sd_mm.min():g}"
            )


@dataclass(frozen=True, slots=True, eq=False)
class ShapeSampler:
    """A shape to be sampled, one component per sphere of the base domain, in its order.

    Attributes
    ----------
    components : tuple of Embedding
    marks : SurfaceMarks or None
        The user's landmarks on it.
    """

    components: tuple[Embedding, ...]
    marks: SurfaceMarks | None = None


def sampler(embeddings: Sequence[Embedding], domain: BaseDomain) -> ShapeSampler:
    """Return a shape to be sampled: its embeddings in the order of the domain.

    Parameters
    ----------
    embeddings : sequence of Embedding
        One per sphere of the domain, in any order; matched by the component's name.
    domain : BaseDomain

    Returns
    -------
    ShapeSampler

    Raises
    ------
    InputError
        If a sphere has no embedding.
    """
    by_name = {embedding.component.name: embedding for embedding in embeddings}
    for sphere in domain.spheres:
        if sphere.name not in by_name:
            raise InputError(
                f"component {sphere.name}: expected its embedding, found embeddings of "
                f"{', '.join(by_name) or 'nothing'}"
            )
    return ShapeSampler(tuple(by_name[sphere.name] for sphere in domain.spheres))


def sample(shape: ShapeSampler, template: Template, directions: FloatArray) -> FloatArray:
    """Return the positions on a shape of the template's points, moved to the given directions.

    Parameters
    ----------
    shape : ShapeSampler
    template : Template
        Says which sphere and which curve each point belongs to.
    directions : (P, 3) float64
        Unit vectors; of a point on a curve only the angle about the circle's centre counts.

    Returns
    -------
    points : (P, 3) float64, mm
        In the shape's input coordinates.

    Raises
    ------
    InputError
        If the number of directions differs, or a curve of the template is not on the shape.
    ConvergenceError
        If an embedding is folded.
    """
    return _sampled(shape, template, directions, derivative=False)[0]


def sample_with_derivative(
    shape: ShapeSampler, template: Template, directions: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the positions of `sample` and their derivative with respect to the directions.

    Parameters and errors are those of `sample`.

    Returns
    -------
    points : (P, 3) float64, mm
    jacobian : (P, 3, 3) float64, mm / rad
        ``jacobian[p] @ t`` is the change of position for a tangential step t of the direction;
        zero along the direction itself. For a point on a curve only the component along the
        circle counts; for an interior point beyond a rim only the one along the rim.
    """
    return _sampled(shape, template, directions, derivative=True)


def pull_back(shape: ShapeSampler, component: int, positions: FloatArray) -> FloatArray:
    """Return the directions whose positions on a component are closest to given positions.

    Parameters
    ----------
    shape : ShapeSampler
    component : int
        Index of the component (and of its sphere).
    positions : (n, 3) float64, mm
        In the shape's input coordinates; moved to the closest point of the surface.

    Returns
    -------
    directions : (n, 3) float64
    """
    part = shape.components[component]
    tree = surface_tree(part.component.vertices, part.component.faces)
    return pulled_back(tree, part.directions, positions)


def pulled_back(tree: SurfaceTree, directions: FloatArray, positions: FloatArray) -> FloatArray:
    """Return the directions of the points of a surface closest to positions (n, 3).

    The inverse of gnomonic barycentric interpolation on a surface with one direction per vertex.
    """
    closest = closest_points(tree, positions)
    corners = directions[tree.faces[closest.faces]]  # (n, 3, 3)
    return normalised(np.einsum("nk,nkd->nd", closest.barycentric, corners))


def _sampled(
    shape: ShapeSampler, template: Template, directions: FloatArray, derivative: bool
) -> tuple[FloatArray, FloatArray]:
    if directions.shape != template.points.shape:
        raise InputError(
            f"directions: expected one per template point, shape {template.points.shape}, found "
            f"{directions.shape}"
        )
    points = np.zeros((len(directions), 3))
    jacobian = np.zeros((len(directions) if derivative else 0, 3, 3))
    for index, part in enumerate(shape.components):
        inside = np.flatnonzero((template.sphere == index) & (template.curve < 0))
        queries = directions[inside]
        locator = part.locator
        points[inside], slopes = interpolated(
            locator.points,
            locator.faces,
            locator.n_faces,
            part.component.vertices,
            queries,
            containing_triangles(locator, queries),
            derivative,
        )
        if derivative:
            jacobian[inside] = slopes
    for index in np.unique(template.curve[template.curve >= 0]):
        on_curve = np.flatnonzero(template.curve == index)
        part = shape.components[template.sphere[on_curve[0]]]
        curve = _curve(part, template.curves[index])
        points[on_curve], slopes = interpolated_on_curve(
            curve.frame,
            curve.first_angle,
            curve.sign,
            curve.positions,
            part.component.vertices[curve.loop],
            directions[on_curve],
            derivative,
        )
        if derivative:
            jacobian[on_curve] = slopes
    return points, jacobian


def _curve(part: Embedding, name: str) -> PlacedCurve:
    if name not in part.curves:
        raise InputError(
            f"component {part.component.name}: expected the template's curve {name}, found "
            f"{', '.join(part.curves) or 'no opening'}"
        )
    return part.curves[name]
