"""The template of a population: its mean surface, remeshed, on the base domain (design 4).

Triangles that are equilateral in the domain are not so on the shapes, and an even sampling of the
domain starves long veins. So the mean of the shapes is remeshed isotropically and its vertices
are carried back to the domain, where they become the template. Done twice: the first, from an
even mesh of the domain, finds the regions that it samples too thinly; the second is the result.
"""

from dataclasses import dataclass

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.correspondence.sampling import ShapeSampler, pulled_back, sample
from ostiform.correspondence.shapes import GivenShapes, as_shapes
from ostiform.correspondence.untangled_template import fold_free_triangulation
from ostiform.domain import (
    BaseDomain,
    Circle,
    Template,
    assembled_template,
    curve_names,
    graded_template,
    with_levels,
)
from ostiform.errors import InputError
from ostiform.surface import (
    RemeshRules,
    distances_to_surface,
    isotropic_remeshed,
    normalised,
    surface_tree,
)

DECIMALS = 6

DENSITY = 2.0
"""Points of the meshes on which the mean surface is computed, over those of the template."""

START_ITERATIONS = 8
"""Smoothing steps of the first mesh of the domain, which need not be good."""

LEVEL_RATIOS = (16, 4)
"""A level has this many times fewer points than the template; coarsest first."""

SMALLEST_LEVEL = 12
"""Points per curve of a level, below which it is left out."""


@dataclass(frozen=True, slots=True)
class TemplateCoverage:
    """How well a shape is covered by the points of a template.

    Attributes
    ----------
    largest_mm : float
        Largest distance from a vertex of the shape to the sampled surface.
    diameter_mm : float
        Diagonal of the shape's bounding box.
    """

    largest_mm: float
    diameter_mm: float

    @property
    def ratio(self) -> float:
        """The largest distance over the diameter."""
        return self.largest_mm / self.diameter_mm


def population_template(
    shapes: GivenShapes,
    domain: BaseDomain,
    n_points: int,
    poses: FloatArray,
) -> Template:
    """Return a template that is nearly equilateral and even on the population's mean surface.

    Rim and seam points lie exactly on their circles and evenly along the mean of each curve. The
    result does not depend on the order of the shapes.

    Parameters
    ----------
    shapes : Shapes or sequence of ShapeSampler
    domain : BaseDomain
    n_points : int
        Points of the template, reached to within 2 %.
    poses : (N, 4, 4) float64
        From each shape's input coordinates to the population's common pose.

    Returns
    -------
    Template
        Fold-free, with nested levels of about a sixteenth and a quarter of its points where these
        leave room for the curves.

    Raises
    ------
    InputError
        If there is no shape, the poses do not match, or the points are too few for the curves.
    ConvergenceError
        If the number of points is not reached.
    """
    if len(shapes) == 0 or poses.shape != (len(shapes), 4, 4):
        raise InputError(
            f"population template: expected one 4 x 4 pose for each of at least one shape, found "
            f"{len(shapes)} shapes and poses of shape {poses.shape}"
        )
    dense = graded_template(domain, round(DENSITY * n_points), iterations=START_ITERATIONS)
    dense = _remeshed_template(
        domain, dense, mean_surface(shapes, dense, poses), DENSITY * n_points
    )
    template = _remeshed_template(domain, dense, mean_surface(shapes, dense, poses), n_points)
    fewest = SMALLEST_LEVEL * max(len(template.curves), 1)
    total = len(template.points)
    counts = [total // ratio for ratio in LEVEL_RATIOS if total // ratio >= fewest]
    return with_levels(template, domain, counts, mean_surface(shapes, template, poses))


def mean_surface(shapes: GivenShapes, template: Template, poses: FloatArray) -> FloatArray:
    """Return the mean (P, 3) in millimetres of the shapes sampled at a template's own points.

    To a millionth of a millimetre: sums of floating-point numbers depend on their order, poses
    that were fitted together too, and remeshing would magnify the last bit.
    """
    points = np.stack(as_shapes(shapes).each(_posed, list(poses), template))  # (N, P, 3)
    mean: FloatArray = np.round(points.mean(axis=0), DECIMALS)
    return mean


def _posed(shape: ShapeSampler, pose: FloatArray, template: Template) -> FloatArray:
    posed: FloatArray = sample(shape, template, template.points) @ pose[:3, :3].T + pose[:3, 3]
    return posed


def template_coverage(shape: ShapeSampler, template: Template) -> TemplateCoverage:
    """Return how far any vertex of a shape is from the shape sampled at the template's points."""
    sampled = sample(shape, template, template.points)
    vertices = np.concatenate([part.component.vertices for part in shape.components])
    return TemplateCoverage(
        largest_mm=float(distances_to_surface(vertices, sampled, template.faces).max()),
        diameter_mm=float(np.linalg.norm(np.ptp(vertices, axis=0))),
    )


def _remeshed_template(
    domain: BaseDomain, dense: Template, mean: FloatArray, n_points: float
) -> Template:
    areas = _sphere_areas(dense, mean, len(domain.spheres))
    points, sphere, curve, faces = [], [], [], []
    count = 0
    for index in range(len(domain.spheres)):
        wanted = round(n_points * areas[index] / areas.sum())
        new_points, new_curve, new_faces = _remeshed_sphere(domain, dense, mean, index, wanted)
        points.append(new_points)
        sphere.append(np.full(len(new_points), index, dtype=np.int64))
        curve.append(new_curve)
        faces.append(new_faces + count)
        count += len(new_points)
    return assembled_template(
        domain,
        np.concatenate(points),
        np.concatenate(sphere),
        np.concatenate(curve),
        np.concatenate(faces),
    )


def _remeshed_sphere(
    domain: BaseDomain, dense: Template, mean: FloatArray, index: int, n_points: int
) -> tuple[FloatArray, IntArray, IntArray]:
    sphere = domain.spheres[index]
    own = np.flatnonzero(dense.sphere == index)
    local = np.full(len(dense.points), -1, dtype=np.int64)
    local[own] = np.arange(len(own))
    in_sphere = dense.sphere[dense.faces[:, 0]] == index
    faces = local[dense.faces[in_sphere]]
    loops = [local[dense.loops[name]] for name in sphere.curves]
    fewest = int(np.clip(n_points / (8 * len(loops) + 1), 6, 12))
    remeshed = isotropic_remeshed(
        mean[own],
        faces,
        n_vertices=n_points,
        curves=loops,
        labels=dense.face_part[in_sphere],
        rules=RemeshRules(fewest_on_curve=fewest),
    )
    directions = pulled_back(
        surface_tree(mean[own], faces), dense.points[own], remeshed.vertices
    )  # (n, 3)
    curve = np.full(len(directions), -1, dtype=np.int64)
    circles = list(sphere.curves.values())
    for position, (circle, loop, new_loop) in enumerate(
        zip(circles, loops, remeshed.curves, strict=True)
    ):
        directions[new_loop] = _evenly_on_circle(
            circle, dense.points[own[loop]], mean[own[loop]], remeshed.vertices[new_loop]
        )
        curve[new_loop] = position
    directions, new_faces = fold_free_triangulation(
        directions, remeshed.faces, curve, circles, [name in sphere.rims for name in sphere.curves]
    )
    names = curve_names(domain)
    of_domain = np.array([names.index(name) for name in sphere.curves] + [-1], dtype=np.int64)
    return directions, of_domain[curve], new_faces


def _evenly_on_circle(
    circle: Circle, directions: FloatArray, polyline: FloatArray, points: FloatArray
) -> FloatArray:
    # Directions at equal arc length along a closed polyline whose vertices have directions on the
    # circle, as many as there are points, as near to them as possible.
    closed = np.concatenate([polyline, polyline[:1]])
    lengths = np.linalg.norm(np.diff(closed, axis=0), axis=1)
    arcs = np.concatenate([[0.0], np.cumsum(lengths)])
    total = arcs[-1]
    along = _arc_lengths(closed, arcs, points)
    even = total * np.arange(len(points)) / len(points)
    offset = np.mod(along - even - (along[0] - even[0]) + 0.5 * total, total) - 0.5 * total
    even = np.mod(even + along[0] + offset.mean(), total)
    edge = np.clip(np.searchsorted(arcs, even, side="right") - 1, 0, len(lengths) - 1)
    fraction = (even - arcs[edge]) / lengths[edge]
    around = np.concatenate([directions, directions[:1]])
    chords = (1.0 - fraction)[:, None] * around[edge] + fraction[:, None] * around[edge + 1]
    # The chord point seen from the circle's axis: the inverse of locating an angle on the curve.
    return circle.points(circle.angles(normalised(chords)))


def _arc_lengths(closed: FloatArray, arcs: FloatArray, points: FloatArray) -> FloatArray:
    start, chord = closed[:-1], np.diff(closed, axis=0)  # (m, 3)
    squared = np.einsum("mi,mi->m", chord, chord)
    offset = points[:, None, :] - start  # (n, m, 3)
    fraction = np.clip(np.einsum("nmi,mi->nm", offset, chord) / squared, 0.0, 1.0)
    gap = offset - fraction[:, :, None] * chord
    nearest = np.einsum("nmi,nmi->nm", gap, gap).argmin(axis=1)
    rows = np.arange(len(points))
    along: FloatArray = arcs[nearest] + fraction[rows, nearest] * np.sqrt(squared[nearest])
    return along


def _sphere_areas(template: Template, positions: FloatArray, n_spheres: int) -> FloatArray:
    corners = positions[template.faces]
    areas = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    owner = template.sphere[template.faces[:, 0]]  # (F,)
    return np.array([areas[owner == index].sum() for index in range(n_spheres)])
