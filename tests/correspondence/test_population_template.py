import numpy as np
import pytest

from ostiform.correspondence import (
    mean_surface,
    population_template,
    sample,
    sampler,
    template_coverage,
)
from ostiform.correspondence.untangled_template import fold_free_triangulation
from ostiform.domain import graded_template, triangle_quality
from ostiform.errors import InputError
from ostiform.surface import count_flipped, euler_characteristic, half_edges
from tests.star_shapes import (
    closed_domain,
    cup_domain,
    heart_domain,
    star_embedding,
    two_sphere_domain,
    wavy,
)

DOMAIN = heart_domain()
SHAPES = [
    sampler([star_embedding(DOMAIN.spheres[0], wavy(0.15, phase), 1800, seed)], DOMAIN)
    for seed, phase in enumerate((0.0, 0.7, 1.4))
]
STILL = np.tile(np.eye(4), (3, 1, 1))
TEMPLATE = population_template(SHAPES, DOMAIN, 1200, STILL)


def test_the_template_has_the_wanted_number_of_points_and_no_folds():
    assert abs(len(TEMPLATE.points) - 1200) <= 24
    assert count_flipped(TEMPLATE.points, TEMPLATE.faces) == 0
    assert euler_characteristic(TEMPLATE.faces) == -3


def test_the_template_is_nearly_equilateral_on_every_shape():
    for shape in SHAPES:
        quality = triangle_quality(sample(shape, TEMPLATE, TEMPLATE.points), TEMPLATE.faces)
        assert quality.mean > 0.94
        assert quality.min_angle > 8


def test_curve_points_lie_on_their_circles_and_loops_keep_their_part_on_the_left():
    for index, circle in enumerate(DOMAIN.spheres[0].curves.values()):
        on = TEMPLATE.points[TEMPLATE.curve == index]
        assert len(on) >= 8
        np.testing.assert_allclose(on @ circle.center, np.cos(circle.radius), atol=1e-12)
    for ostium, loop in TEMPLATE.loops.items():
        part = TEMPLATE.parts.index(ostium.split(".")[0])
        edges = {tuple(e) for e in half_edges(TEMPLATE.faces[TEMPLATE.face_part == part]).tolist()}
        assert set(zip(loop.tolist(), np.roll(loop, -1).tolist(), strict=True)) <= edges


def test_rims_are_sampled_evenly_on_the_mean_surface():
    mean = mean_surface(SHAPES, TEMPLATE, STILL)
    for loop in TEMPLATE.loops.values():
        steps = np.linalg.norm(mean[loop] - np.roll(mean[loop], -1, axis=0), axis=1)
        # Chords of a curved rim differ a little where arcs do not.
        np.testing.assert_allclose(steps, steps.mean(), rtol=0.1)


def test_no_shape_is_left_uncovered():
    for shape in SHAPES:
        coverage = template_coverage(shape, TEMPLATE)
        assert coverage.diameter_mm > 60
        assert coverage.ratio < 0.015


def test_the_order_of_the_shapes_does_not_matter():
    other = population_template(SHAPES[::-1], DOMAIN, 1200, STILL)
    np.testing.assert_array_equal(other.points, TEMPLATE.points)
    np.testing.assert_array_equal(other.faces, TEMPLATE.faces)


def test_the_mean_follows_the_poses_and_is_the_mean():
    pose = STILL.copy()
    pose[:, :3, 3] = [[3.0, 0, 0], [0, 3.0, 0], [0, 0, 3.0]]
    points = np.stack([sample(shape, TEMPLATE, TEMPLATE.points) for shape in SHAPES])
    expected = points.mean(axis=0) + 1.0
    np.testing.assert_allclose(mean_surface(SHAPES, TEMPLATE, pose), expected, rtol=0, atol=1e-6)


def test_levels_are_part_of_the_template():
    total = len(TEMPLATE.points)
    assert [len(level.index) for level in TEMPLATE.levels] == [total // 16, total // 4]


def test_components_share_the_points_by_area():
    domain = two_sphere_domain()
    cup = star_embedding(cup_domain().spheres[0], lambda u: np.full(len(u), 10.0), 500)
    ball = star_embedding(closed_domain().spheres[0], lambda u: np.full(len(u), 20.0), 500)
    shape = sampler([cup, ball], domain)
    template = population_template([shape], domain, 800, np.eye(4)[None])
    share = (template.sphere == 1).mean()
    np.testing.assert_allclose(share, 4 / 4.96, atol=0.03)  # the cup lacks a cap of 4 %
    assert count_flipped(template.points, template.faces) == 0


def test_poses_must_match_the_shapes():
    with pytest.raises(InputError, match="one 4 x 4 pose"):
        population_template(SHAPES, DOMAIN, 1200, STILL[:2])
    with pytest.raises(InputError, match="at least one shape"):
        population_template([], DOMAIN, 1200, np.zeros((0, 4, 4)))


def cup_mesh():
    template = graded_template(cup_domain(), 300, iterations=10)
    circle = cup_domain().spheres[0].curves["LV.mitral"]
    return template, [circle], [True]


def test_a_vertex_that_crossed_an_edge_is_repaired_in_place():
    template, circles, is_rim = cup_mesh()
    points = template.points.copy()
    vertex = int(np.argmin(points[:, 2]))
    face = template.faces[(template.faces == vertex).any(axis=1)][0]
    others = face[face != vertex]
    opposite = points[others].mean(axis=0)
    points[vertex] = points[vertex] + 1.3 * (opposite - points[vertex])
    points[vertex] /= np.linalg.norm(points[vertex])
    assert count_flipped(points, template.faces) > 0
    repaired, faces = fold_free_triangulation(
        points, template.faces, template.curve, circles, is_rim
    )
    assert count_flipped(repaired, faces) == 0
    assert euler_characteristic(faces) == euler_characteristic(template.faces)
    assert (np.linalg.norm(repaired - points, axis=1) > 1e-12).sum() < 20


def test_a_hopeless_triangulation_is_replaced_by_the_delaunay_one(rng):
    template, circles, is_rim = cup_mesh()
    order = np.arange(len(template.points))
    free = np.flatnonzero(template.curve < 0)
    order[free] = rng.permutation(free)
    shuffled = template.points[order]
    repaired, faces = fold_free_triangulation(
        shuffled, template.faces, template.curve, circles, is_rim
    )
    assert count_flipped(repaired, faces) == 0
    assert euler_characteristic(faces) == 1
    np.testing.assert_array_equal(repaired[template.curve >= 0], shuffled[template.curve >= 0])
