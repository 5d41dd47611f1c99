"""Lloyd relaxation: the points cover every shape at least as well after the warps as before them.

Warps carry points together here and apart there, and with few points a gap shows. Where on the
tissue a point lies is free as long as it is the same place in all shapes, so the points are moved
by one common motion towards what they cover worst: Lloyd's relaxation over all shapes at once,
every piece of surface weighted by a high power of its distance, so that the worst distances fall
first (a centroidal Voronoi tessellation for a high norm; Levy and Liu 2010).

A point moves to an affine combination of itself and its neighbours, with the same coefficients in
the template and in every shape: the material point it stands for changes, the correspondence does
not. Points of rims and seams move along their circles.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from ostiform.arrays import BoolArray, FloatArray, IntArray, read_only
from ostiform.correspondence.field_kernels import determinants
from ostiform.correspondence.sampling import ShapeSampler, sample
from ostiform.correspondence.shapes import Shapes
from ostiform.domain import Circle, Template
from ostiform.surface import (
    closest_points,
    face_areas,
    normalised,
    surface_tree,
    unique_edges,
    vertex_areas,
    weighted_quantile,
)

POWER = 12
"""Of the distances, over the start's worst, by which surface pulls points. The largest distances
fall first, as in a norm of order 14."""

REACHING = 4.0
"""How much more distances from points pull than those from the sampled surface."""

MILD, MILD_POWER = 0.03, 4
"""Weight and power of the distances from the sampled surface over 95 % of the start's: these
spread points evenly where nothing is urgent."""

INERTIA = 0.05
"""Weight with which a point holds its place; a cell as large as the mean one, at the start's worst
distance from the sampled surface in one shape, has 1."""

DAMPING, SLOWING = 0.4, 0.1
"""Share of the way that a step goes at first (as weights follow a high power of the distances,
whole steps overshoot), and how it shrinks from round to round."""

ENOUGH, ROUNDS = 0.99, 16
"""Worst distance over the start's at which points stay where they are, and most rounds."""

LEAST_SHARE = 0.2
"""Of its determinant that a triangle keeps, in the template and in every shape."""

EXACT = 1e-6
"""Of the square root of a surface's area: distances below it are none."""

MOST_FREEZES = 8
"""How often points at the corners of squeezed triangles are stopped before a step is given up."""


@dataclass(frozen=True, slots=True)
class Coverage:
    """How far surfaces are from their sampling, over all shapes.

    Attributes
    ----------
    surface : float, mm
        Largest distance from a vertex to the sampled surface.
    surface_95, mean_95 : float, mm
        95 % of that distance over area: of the worst shape, and mean over the shapes.
    point : float, mm
        Largest distance from a vertex to the nearest point.
    """

    surface: float
    surface_95: float
    mean_95: float
    point: float

    def over(self, other: "Coverage") -> float:
        """Return the largest of the ratios to other distances."""
        return max(
            self.surface / other.surface,
            self.surface_95 / other.surface_95,
            self.mean_95 / other.mean_95,
            self.point / other.point,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Differences:
    """Derivatives of values at the template's points by a motion of the points.

    Attributes
    ----------
    first, second : (P, P) sparse
        Along two tangents of the sphere: of the linear function that fits the values at a point's
        neighbours best. A point of a circle has the first only, along the circle, from its two
        neighbours there.
    """

    first: sparse.csr_array
    second: sparse.csr_array

    def of(self, values: FloatArray) -> FloatArray:
        """Return the derivatives (P, 3, 2) of values (P, 3)."""
        return np.stack([self.first @ values, self.second @ values], axis=2)


@dataclass(frozen=True, slots=True, eq=False)
class _SurveyInputs:
    """What the survey of every shape needs."""

    template: Template
    differences: Differences
    start: Coverage


@dataclass(frozen=True, slots=True, eq=False)
class _Survey:
    """Distances of one shape, and what pulls its points.

    Attributes
    ----------
    coverage : Coverage
    weight : (P,) float64
        Of all that pulls a point.
    pull : (P, 2) float64
        Weighted offsets along the two tangents.
    metric : (P, 2, 2) float64
        Scalar products of the tangents' images on the shape, mm^2.
    """

    coverage: Coverage
    weight: FloatArray
    pull: FloatArray
    metric: FloatArray


def relaxed(
    shapes: Shapes, template: Template, circles: FloatArray, directions: FloatArray
) -> tuple[Template, FloatArray]:
    """Return the template and the points of all shapes, moved together to cover every shape.

    They stay where they are if they cover the shapes well enough: then it is the given template.

    Parameters
    ----------
    shapes : Shapes
        N.
    template : Template
    circles : (K, 8) float64
        See `fields.circle_table`.
    directions : (N, P, 3) float64
        Where the warps have put the template's points.

    Returns
    -------
    template : Template
        The same triangles, other points.
    directions : (N, P, 3) float64
        To first order, as affine combinations of what was given; the warps have the last word.
    """
    start = _template_coverage(shapes, template)
    first = moved = best = template, directions
    least = np.inf
    for number in range(1, ROUNDS + 1):
        differences = differences_of(moved[0], circles)
        inputs = _SurveyInputs(moved[0], differences, start)
        surveys = shapes.each(_surveyed, list(moved[1]), inputs)
        reached = _joined([survey.coverage for survey in surveys]).over(start)
        if reached < least:
            least, best = reached, moved
        if reached <= ENOUGH or number == ROUNDS:
            break
        motion = DAMPING / (1.0 + SLOWING * (number - 1)) * _motion(surveys, template.curve)
        moved = _stepped(first, moved, differences, motion, circles)
    return best


def _template_coverage(shapes: Shapes, template: Template) -> Coverage:
    """Return how shapes are covered by the template's own points."""
    return _joined(shapes.each(_coverage_of, [None] * len(shapes), template))


def _joined(coverages: Sequence[Coverage]) -> Coverage:
    return Coverage(
        surface=max(one.surface for one in coverages),
        surface_95=max(one.surface_95 for one in coverages),
        mean_95=float(np.mean([one.mean_95 for one in coverages])),
        point=max(one.point for one in coverages),
    )


def _coverage_of(shape: ShapeSampler, _item: None, template: Template) -> Coverage:
    points = sample(shape, template, template.points)
    vertices, areas = _vertices(shape)
    gaps = closest_points(surface_tree(points, template.faces), vertices).distances
    return _coverage(gaps, areas, _nearest(points, vertices)[0])


def _coverage(gaps: FloatArray, areas: FloatArray, reaches: FloatArray) -> Coverage:
    least = EXACT * float(np.sqrt(areas.sum()))
    most = max(weighted_quantile(gaps, areas, 0.95), least)
    return Coverage(
        surface=max(float(gaps.max()), least),
        surface_95=most,
        mean_95=most,
        point=max(float(reaches.max()), least),
    )


def _nearest(points: FloatArray, places: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return how far the nearest point is from each place (n, 3), and which one it is."""
    distances, index = cKDTree(points).query(places)
    return np.asarray(distances), np.asarray(index)


def _vertices(shape: ShapeSampler) -> tuple[FloatArray, FloatArray]:
    """Return the vertices (V, 3) of all components and their areas."""
    meshes = [part.component for part in shape.components]
    return (
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([vertex_areas(mesh.vertices, mesh.faces) for mesh in meshes]),
    )


def _middles(shape: ShapeSampler) -> tuple[FloatArray, FloatArray]:
    """Return the middles (F, 3) of the triangles of all components and their areas."""
    meshes = [part.component for part in shape.components]
    return (
        np.concatenate([mesh.vertices[mesh.faces].mean(axis=1) for mesh in meshes]),
        np.concatenate([face_areas(mesh.vertices, mesh.faces) for mesh in meshes]),
    )


def _surveyed(shape: ShapeSampler, directions: FloatArray, inputs: _SurveyInputs) -> _Survey:
    template, start = inputs.template, inputs.start
    points = sample(shape, template, directions)
    vertices, areas = _vertices(shape)
    middles, of_middles = _middles(shape)
    cells = len(points) / areas.sum()
    # Every vertex and every middle pulls the nearest point by its distance from it,
    places = np.concatenate([vertices, middles])
    reaches, nearest = _nearest(points, places)
    shares = 0.5 * cells * np.concatenate([areas, of_middles])
    # and every vertex the corners of the triangle nearest to it by its distance from that.
    found = closest_points(surface_tree(points, template.faces), vertices)
    urgency = (found.distances / start.surface) ** POWER
    urgency += MILD * (found.distances / start.mean_95) ** MILD_POWER
    beside = (cells * areas * urgency)[:, None]
    index = np.concatenate([nearest, template.faces[found.faces].ravel()])
    weights = np.concatenate(
        [REACHING * shares * (reaches / start.point) ** POWER, (beside * found.barycentric).ravel()]
    )
    offsets = np.concatenate([places, np.repeat(vertices, 3, axis=0)]) - points[index]
    count = len(points)
    pulls = [np.bincount(index, weights * offsets[:, axis], count) for axis in range(3)]
    along = inputs.differences.of(points)  # (P, 3, 2)
    return _Survey(
        coverage=_coverage(found.distances, areas, reaches[: len(vertices)]),
        weight=np.asarray(np.bincount(index, weights, count), np.float64),
        pull=np.einsum("pka,kp->pa", along, np.stack(pulls)),
        metric=np.einsum("pka,pkb->pab", along, along),
    )


def _motion(surveys: Sequence[_Survey], curve: IntArray) -> FloatArray:
    """Return how far (P, 2) every point moves along its tangents: to what all shapes agree on."""
    matrix: FloatArray = np.zeros_like(surveys[0].metric)
    pull: FloatArray = np.zeros_like(surveys[0].pull)
    for survey in surveys:
        share = survey.weight + INERTIA / len(surveys)
        matrix = matrix + share[:, None, None] * survey.metric
        pull = pull + survey.pull
    matrix[:, 1, 1] += np.where(curve >= 0, 1.0, 0.0)  # the second tangent of a circle is nothing
    motion = np.linalg.solve(matrix, pull[..., None])[..., 0]
    return np.asarray(motion, dtype=np.float64)


def _stepped(
    first: tuple[Template, FloatArray],
    moved: tuple[Template, FloatArray],
    differences: Differences,
    motion: FloatArray,
    circles: FloatArray,
) -> tuple[Template, FloatArray]:
    """Return template and points after a motion; corners of triangles it would squeeze stay."""
    template, directions = moved
    for _ in range(MOST_FREEZES):
        points, *others = (
            _carried(own, template.curve, differences, motion, circles)
            for own in (template.points, *directions)
        )
        squeezed = squeezed_points(first, (points, np.stack(others)))
        if not squeezed.any():
            return replace(template, points=points), np.stack(others)
        motion = np.where(squeezed[:, None], 0.0, motion)
    return moved


def squeezed_points(
    first: tuple[Template, FloatArray], moved: tuple[FloatArray, FloatArray]
) -> BoolArray:
    """Return which points (P,) are corners of triangles that a motion has squeezed.

    Parameters
    ----------
    first : (Template, (N, P, 3) float64)
        The template, of which all levels count, and the directions on the shapes.
    moved : ((P, 3) float64, (N, P, 3) float64)
        The points of the template and the directions after the motion.
    """
    template, points = first[0], moved[0]
    squeezed = _squeezed_corners(template.faces, template.points, points)
    for level in template.levels:
        own = _squeezed_corners(level.faces, template.points[level.index], points[level.index])
        squeezed[level.index] |= own
    for before, after in zip(first[1], moved[1], strict=True):
        squeezed |= _squeezed_corners(template.faces, before, after)
    return squeezed


def _squeezed_corners(faces: IntArray, before: FloatArray, after: FloatArray) -> BoolArray:
    squeezed = np.zeros(len(before), dtype=bool)
    room = LEAST_SHARE * determinants(read_only(before), faces)
    squeezed[faces[determinants(read_only(after), faces) < room]] = True
    return squeezed


def _carried(
    points: FloatArray,
    curve: IntArray,
    differences: Differences,
    motion: FloatArray,
    circles: FloatArray,
) -> FloatArray:
    """Return directions (P, 3) of the material points after a motion (P, 2)."""
    moved = normalised(points + np.einsum("pka,pa->pk", differences.of(points), motion))
    for row, circle in enumerate(circles):
        on = Circle(circle[:3], float(circle[3]))
        own = curve == row
        moved[own] = on.points(on.angles(moved[own]))
    return moved


def _tangents(points: FloatArray) -> FloatArray:
    """Return two orthonormal tangents (P, 2, 3) of the sphere at unit vectors (P, 3)."""
    aside = np.eye(3)[np.abs(points).argmin(axis=1)]
    first = normalised(np.cross(aside, points))
    return np.stack([first, np.cross(points, first)], axis=1)


def differences_of(template: Template, circles: FloatArray) -> Differences:
    """Return what differentiates values at a template's points; see `Differences`.

    Parameters
    ----------
    template : Template
    circles : (K, 8) float64
        See `fields.circle_table`.
    """
    frames = _tangents(template.points)
    count = len(template.points)
    edges = unique_edges(template.faces)[0]
    rows, columns = np.concatenate([edges, edges[:, ::-1]]).T
    inside = template.curve[rows] < 0
    rows, columns = rows[inside], columns[inside]
    offsets = template.points[columns] - template.points[rows]
    local = np.einsum("eak,ek->ea", frames[rows], offsets)  # (E, 2)
    for row, circle in enumerate(circles):
        own = np.flatnonzero(template.curve == row)
        angles = Circle(circle[:3], float(circle[3])).angles(template.points[own])
        order = np.argsort(angles)
        ring, after = own[order], np.roll(own[order], -1)
        gaps = np.mod(np.roll(angles[order], -1) - angles[order], 2.0 * np.pi)
        along = np.stack([np.sin(circle[3]) * gaps, np.zeros(len(ring))], axis=1)
        rows, columns = np.concatenate([rows, ring, after]), np.concatenate([columns, after, ring])
        local = np.concatenate([local, along, -along])
    moments = np.zeros((count, 2, 2))
    np.add.at(moments, rows, local[:, :, None] * local[:, None, :])
    moments[:, 1, 1] += np.where(template.curve >= 0, 1.0, 0.0)
    factors = np.einsum("eab,eb->ea", np.linalg.inv(moments)[rows], local)  # (E, 2)
    first, second = (
        sparse.csr_array((factors[:, axis], (rows, columns)), shape=(count, count))
        for axis in range(2)
    )
    return Differences(_without_means(first), _without_means(second))


def _without_means(matrix: sparse.csr_array) -> sparse.csr_array:
    """Return the matrix with a diagonal that makes it vanish for constant values."""
    return sparse.csr_array(matrix - sparse.diags_array(matrix.sum(axis=1)))
