"""Sampling: where the points of the template lie on a shape, and how they move (end of HY 2.2).

An interior point is located in the spherical triangulation of its shape's embedding and
interpolated with gnomonic barycentric coordinates; a point of a rim or a seam is located by its
angle on that curve, so it lies on the input's own polyline and a seam point is one point for both
parts. The derivative of the position with respect to the direction is analytic; it jumps where a
point crosses an edge of the shape's mesh, as any piecewise linear map's does.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ostiform.arrays import FloatArray, IntArray, frozen_floats
from ostiform.correspondence.sampling_kernels import interpolated, interpolated_on_curve
from ostiform.domain import BaseDomain, Circle, Sphere, Template, tangent_frame
from ostiform.embedding import Embedding
from ostiform.errors import InputError
from ostiform.surface import (
    Component,
    SphereLocator,
    SurfaceTree,
    closest_points,
    containing_triangles,
    curve_positions,
    normalised,
    sphere_locator,
    surface_tree,
)


@dataclass(frozen=True, slots=True, eq=False)
class CurveSampler:
    """A rim or a seam of a shape, and where its vertices lie on their circle.

    Attributes
    ----------
    circle : Circle
    first_angle : float
        Of the first vertex about the circle's centre, radians.
    sign : float
        1 where the angle increases along the curve, -1 where it decreases.
    positions : (n + 1,) float64
        Angle travelled from the first vertex to each, and back to the first, radians.
    points : (n + 1, 3) float64, mm
        Of the vertices in order; the first again at the end.
    frame : (3, 3) float64
        Rows e1, e2 of the circle's tangent frame, and its centre.
    """

    circle: Circle
    first_angle: float
    sign: float
    positions: FloatArray
    points: FloatArray
    frame: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class ComponentSampler:
    """One component of a shape on its sphere, prepared for sampling.

    Attributes
    ----------
    name : str
    locator : SphereLocator
    directions : (V, 3) float64
    vertices : (V, 3) float64, mm
    faces : (F, 3) int64
    curves : mapping of str to CurveSampler
        By the names of `Sphere.curves`.
    """

    name: str
    locator: SphereLocator
    directions: FloatArray
    vertices: FloatArray
    faces: IntArray
    curves: Mapping[str, CurveSampler]


@dataclass(frozen=True, slots=True, eq=False)
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

    names: tuple[str, ...]
    positions: FloatArray
    sd_mm: FloatArray

    def __post_init__(self) -> None:
        """Check the arrays and make them read-only."""
        count = len(self.names)
        object.__setattr__(self, "positions", frozen_floats(self.positions, (count, 3), "marks"))
        object.__setattr__(self, "sd_mm", frozen_floats(self.sd_mm, (count,), "sd of marks"))
        if (self.sd_mm <= 0.0).any():
            raise InputError(
                f"landmark {self.names[int(self.sd_mm.argmin())]}: expected a standard deviation "
                f"above 0 mm, found {self.sd_mm.min():g}"
            )


@dataclass(frozen=True, slots=True, eq=False)
class ShapeSampler:
    """A shape prepared for sampling, one component per sphere of the base domain, in its order.

    Attributes
    ----------
    components : tuple of ComponentSampler
    marks : SurfaceMarks or None
        The user's landmarks on it.
    """

    components: tuple[ComponentSampler, ...]
    marks: SurfaceMarks | None = None


def sampler(embeddings: Sequence[Embedding], domain: BaseDomain) -> ShapeSampler:
    """Prepare a shape for sampling from the embeddings of its components.

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
        If a sphere has no embedding, or a component lacks one of its sphere's rims or seams.
    """
    by_name = {embedding.component.name: embedding for embedding in embeddings}
    for sphere in domain.spheres:
        if sphere.name not in by_name:
            raise InputError(
                f"component {sphere.name}: expected its embedding, found embeddings of "
                f"{', '.join(by_name) or 'nothing'}"
            )
    return ShapeSampler(
        tuple(_component_sampler(by_name[sphere.name], sphere) for sphere in domain.spheres)
    )


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
    return pulled_back(surface_tree(part.vertices, part.faces), part.directions, positions)


def pulled_back(tree: SurfaceTree, directions: FloatArray, positions: FloatArray) -> FloatArray:
    """Return the directions of the points of a surface closest to positions (n, 3).

    The inverse of gnomonic barycentric interpolation on a surface with one direction per vertex.
    """
    closest = closest_points(tree, positions)
    corners = directions[tree.faces[closest.faces]]  # (n, 3, 3)
    return normalised(np.einsum("nk,nkd->nd", closest.barycentric, corners))


def _component_sampler(embedding: Embedding, sphere: Sphere) -> ComponentSampler:
    component, directions = embedding.component, embedding.directions
    locator = sphere_locator(directions, component.faces)
    curves = {}
    for name, circle in sphere.curves.items():
        loop = _curve_loop(component, name)
        angles = circle.angles(directions[loop])
        positions, sign = curve_positions(angles)
        curves[name] = CurveSampler(
            circle=circle,
            first_angle=float(angles[0]),
            sign=sign,
            positions=positions,
            points=component.vertices[np.append(loop, loop[0])],
            frame=np.stack([*tangent_frame(circle.center), circle.center]),
        )
    return ComponentSampler(
        name=sphere.name,
        locator=locator,
        directions=directions,
        vertices=component.vertices,
        faces=component.faces,
        curves=curves,
    )


def _curve_loop(component: Component, name: str) -> IntArray:
    by_name = {
        **component.rims,
        **{seam.first: loop for seam, loop in component.seams.items()},
    }
    if name not in by_name:
        raise InputError(
            f"component {component.name}: expected the opening or seam {name} of its sphere, "
            f"found {', '.join(by_name) or 'no opening'}"
        )
    return by_name[name]


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
    for index, component in enumerate(shape.components):
        inside = np.flatnonzero((template.sphere == index) & (template.curve < 0))
        queries = directions[inside]
        locator = component.locator
        points[inside], slopes = interpolated(
            locator.points,
            locator.faces,
            locator.n_faces,
            component.vertices,
            queries,
            containing_triangles(locator, queries),
            derivative,
        )
        if derivative:
            jacobian[inside] = slopes
    for index in np.unique(template.curve[template.curve >= 0]):
        on_curve = np.flatnonzero(template.curve == index)
        curve = _curve_sampler(shape, template, int(template.sphere[on_curve[0]]), int(index))
        points[on_curve], slopes = interpolated_on_curve(
            curve.frame,
            curve.first_angle,
            curve.sign,
            curve.positions,
            curve.points,
            directions[on_curve],
            derivative,
        )
        if derivative:
            jacobian[on_curve] = slopes
    return points, jacobian


def _curve_sampler(
    shape: ShapeSampler, template: Template, sphere: int, index: int
) -> CurveSampler:
    name = template.curves[index]
    curves = shape.components[sphere].curves
    if name not in curves:
        raise InputError(
            f"component {shape.components[sphere].name}: expected the template's curve {name}, "
            f"found {', '.join(curves) or 'no opening'}"
        )
    return curves[name]
