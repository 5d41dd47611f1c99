"""Lloyd relaxation over the shapes: no shape is covered worse, and nothing else changes."""

import numpy as np
import pytest

from ostiform.correspondence import lloyd
from ostiform.correspondence.fields import circle_table, flow, global_fields, orientation_share
from ostiform.correspondence.lloyd import Coverage, differences_of, relaxed
from ostiform.correspondence.sampling import sample
from ostiform.correspondence.shapes import ShapesInMemory
from ostiform.surface import closest_points, exact_orientations, surface_tree
from tests.oracles.warped_shapes import (
    one_part_domain,
    triangulated,
    two_part_domain,
    warped_family,
    with_level,
)


@pytest.fixture(scope="module", params=[one_part_domain, two_part_domain])
def crowded(request):
    """A family, its template, and points that one boost has crowded on one side in all shapes."""
    domain = request.param()
    family = warped_family(domain, 4, np.random.default_rng(2), n_vertices=900)
    template = with_level(triangulated(domain, 300), domain, 120)
    circles = circle_table(domain, template)
    fields = global_fields(circles, 0)
    moved = flow(fields, template, template.points, np.array([0.0, 0, 0, 0.03, 0.02, 0.12]))
    directions = np.stack([moved] * len(family.samplers))
    return family, template, circles, directions


def cover(family, template, directions):
    """Largest distances from vertices to the sampled surface and to a point, by another route."""
    surface = point = 0.0
    for shape, own in zip(family.samplers, directions, strict=True):
        points = sample(shape, template, own)
        vertices = shape.components[0].component.vertices
        found = closest_points(surface_tree(points, template.faces), vertices)
        surface = max(surface, found.distances.max())
        gaps = np.linalg.norm(vertices[:, None] - points, axis=2)
        point = max(point, gaps.min(axis=1).max())
    return surface, point


def test_crowded_points_relax_until_every_shape_is_covered_better(crowded):
    family, template, circles, directions = crowded
    shapes = ShapesInMemory(family.samplers)
    before = cover(family, template, directions)
    found, moved = relaxed(shapes, template, circles, directions)
    after = cover(family, found, moved)
    for was, now in zip(before, after, strict=True):
        assert now < 0.95 * was


def test_the_same_material_point_is_moved_in_template_and_shapes(crowded):
    # All shapes carry the points by one warp here, so they must agree to the last bit.
    family, template, circles, directions = crowded
    found, moved = relaxed(ShapesInMemory(family.samplers), template, circles, directions)
    assert np.abs(found.points - template.points).max() > 1e-3
    for own in moved[1:]:
        np.testing.assert_array_equal(own, moved[0])
    identity = np.stack([template.points] * len(directions))
    found, moved = relaxed(ShapesInMemory(family.samplers), template, circles, identity)
    np.testing.assert_allclose(moved[0], found.points, atol=1e-12)


def test_triangles_stay_and_points_of_circles_stay_on_them(crowded):
    family, template, circles, directions = crowded
    found, moved = relaxed(ShapesInMemory(family.samplers), template, circles, directions)
    np.testing.assert_array_equal(found.faces, template.faces)
    levels = [(np.arange(len(found.points)), found.faces)]
    levels += [(level.index, level.faces) for level in found.levels]
    for points in (found.points, *moved):
        assert (exact_orientations(points, found.faces) > 0).all()
        for row, circle in enumerate(circles):
            own = points[template.curve == row]
            np.testing.assert_allclose(own @ circle[:3], np.cos(circle[3]), atol=1e-12)
    for index, faces in levels:
        assert (exact_orientations(found.points[index], faces) > 0).all()


def test_the_order_of_the_shapes_does_not_matter(crowded):
    family, template, circles, directions = crowded
    there = np.random.default_rng(4).permutation(len(directions))
    varied = directions.copy()
    varied[0] = template.points
    first, moved = relaxed(ShapesInMemory(family.samplers), template, circles, varied)
    other = ShapesInMemory(tuple(family.samplers[index] for index in there))
    second, turned = relaxed(other, template, circles, varied[there])
    np.testing.assert_allclose(second.points, first.points, atol=1e-10)
    np.testing.assert_allclose(turned, moved[there], atol=1e-10)


def test_derivatives_of_the_points_are_unit_tangents(crowded):
    _, template, circles, _ = crowded
    along = differences_of(template, circles).of(template.points)  # (P, 3, 2)
    inside = template.curve < 0
    outward = np.einsum("pk,pka->pa", template.points, along)
    lengths = np.linalg.norm(along, axis=1)
    # Chords of the sphere dip inward by half their squared length: the mesh is that coarse.
    assert np.abs(outward[inside]).max() < 0.15
    np.testing.assert_allclose(lengths[inside], 1.0, atol=0.05)
    np.testing.assert_allclose(lengths[~inside, 1], 0.0, atol=0.0)


def test_derivatives_of_linear_functions_are_exact_inside(crowded):
    _, template, circles, _ = crowded
    differences = differences_of(template, circles)
    along = differences.of(template.points)
    linear = np.array([[1.0, 2.0, -1.0], [0.5, -0.3, 0.2], [0.0, 1.0, 3.0]])
    np.testing.assert_allclose(
        differences.of(template.points @ linear.T), linear @ along, atol=1e-12
    )
    np.testing.assert_allclose(differences.of(np.ones_like(template.points)), 0.0, atol=1e-12)


def test_a_cover_over_another_is_its_worst_ratio():
    found = Coverage(2.0, 1.0, 0.5, 3.0)
    assert found.over(Coverage(1.0, 1.0, 1.0, 1.0)) == 3.0
    assert found.over(Coverage(1.0, 0.25, 1.0, 1.0)) == 4.0
    assert found.over(Coverage(1.0, 1.0, 0.1, 1.0)) == 5.0


def test_points_that_cover_the_shapes_well_enough_stay(crowded, monkeypatch):
    family, template, circles, directions = crowded
    monkeypatch.setattr(lloyd, "ENOUGH", 10.0)
    found, moved = relaxed(ShapesInMemory(family.samplers), template, circles, directions)
    np.testing.assert_array_equal(found.points, template.points)
    np.testing.assert_array_equal(moved, directions)


def test_no_triangle_is_squeezed_however_hard_the_points_are_pulled(crowded, monkeypatch):
    family, template, circles, directions = crowded
    monkeypatch.setattr(lloyd, "DAMPING", 3.0)
    found, moved = relaxed(ShapesInMemory(family.samplers), template, circles, directions)
    assert orientation_share(template, found.points) >= lloyd.LEAST_SHARE
    for points in (found.points, *moved):
        assert (exact_orientations(points, found.faces) > 0).all()


def test_surfaces_that_are_covered_exactly_are_no_trouble():
    domain = one_part_domain()
    family = warped_family(domain, 2, np.random.default_rng(2), n_vertices=300, warp=0.0, twist=0.0)
    template = triangulated(domain, 300)
    identity = np.stack([template.points] * 2)
    assert cover(family, template, identity)[0] < 1e-9
    circles = circle_table(domain, template)
    found, moved = relaxed(ShapesInMemory(family.samplers), template, circles, identity)
    assert cover(family, found, moved)[0] < 1e-6
