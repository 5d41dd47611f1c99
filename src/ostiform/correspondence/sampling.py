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
from numba import njit

from ostiform.arrays import FloatArray, IntArray, frozen_floats
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
        points[inside], slopes = _interpolate(
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
        points[on_curve], slopes = _interpolate_on_curve(
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


@njit(cache=True)
def _interpolate_on_curve(
    frame: FloatArray,
    first_angle: float,
    sign: float,
    positions: FloatArray,
    vertices: FloatArray,
    queries: FloatArray,
    derivative: bool,
) -> tuple[FloatArray, FloatArray]:
    # Fraction sin u / (sin u + sin v) of the chord (see `locate_on_curve`), u and v the angles to
    # the edge's ends; its derivative by the angle is sin(u + v) / (sin u + sin v)^2, and that of
    # the angle by the direction points along the circle, over the distance from its axis.
    points = np.empty((len(queries), 3))
    jacobian = np.zeros((len(queries) if derivative else 0, 3, 3))
    for q in range(len(queries)):
        x = (queries[q] * frame[0]).sum()
        y = (queries[q] * frame[1]).sum()
        along = (sign * (np.arctan2(y, x) - first_angle)) % (2.0 * np.pi)
        edge = np.searchsorted(positions, along, side="right") - 1
        edge = min(max(edge, 0), len(positions) - 2)
        length = positions[edge + 1] - positions[edge]
        before = min(max(along - positions[edge], 0.0), length)
        both = np.sin(before) + np.sin(length - before)
        fraction = np.sin(before) / both
        for d in range(3):
            chord = vertices[edge + 1, d] - vertices[edge, d]
            points[q, d] = vertices[edge, d] + fraction * chord
            if derivative:
                slope = sign * chord * np.sin(length) / both**2 / (x * x + y * y)
                for e in range(3):
                    jacobian[q, d, e] = slope * (x * frame[1, e] - y * frame[0, e])
    return points, jacobian


@njit(cache=True)
def _interpolate(
    corners: FloatArray,
    faces: IntArray,
    n_faces: int,
    positions: FloatArray,
    queries: FloatArray,
    triangles: IntArray,
    derivative: bool,
) -> tuple[FloatArray, FloatArray]:
    # With n_0 = b x c, n_1 = c x a, n_2 = a x b: weights w_i = n_i . p, barycentric w_i / sum w,
    # position x = sum w_i x_i / sum w, and dx/dp = sum (x_i - x) n_i' / sum w. Beyond a rim (in a
    # fan, whose third corner is the apex) w_2 is left out. Differences from p keep the digits.
    points = np.zeros((len(queries), 3))
    jacobian = np.zeros((len(queries) if derivative else 0, 3, 3))
    normals = np.empty((3, 3))
    weights = np.empty(3)
    for q in range(len(queries)):
        p = queries[q]
        t = triangles[q]
        used = 3 if t < n_faces else 2
        total = 0.0
        for i in range(used):
            u, v = corners[faces[t, (i + 1) % 3]], corners[faces[t, (i + 2) % 3]]
            ex, ey, ez = v[0] - u[0], v[1] - u[1], v[2] - u[2]
            normals[i, 0] = u[1] * ez - u[2] * ey  # u x v = u x (v - u)
            normals[i, 1] = u[2] * ex - u[0] * ez
            normals[i, 2] = u[0] * ey - u[1] * ex
            weights[i] = 0.0
            for d in range(3):
                weights[i] += normals[i, d] * (p[d] - u[d])
            weights[i] = max(weights[i], 0.0)
            total += weights[i]
        if total <= 0.0:  # the centre of a hole: the middle of its fan triangle's rim edge
            weights[:] = 1.0
            total = float(used)
        for i in range(used):
            for d in range(3):
                points[q, d] += weights[i] / total * positions[faces[t, i], d]
        if not derivative:
            continue
        for i in range(used):
            along = 0.0
            for d in range(3):
                along += normals[i, d] * p[d]
            for d in range(3):
                excess = (positions[faces[t, i], d] - points[q, d]) / total
                for e in range(3):
                    jacobian[q, d, e] += excess * (normals[i, e] - along * p[e])
    return points, jacobian
