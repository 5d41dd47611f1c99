from dataclasses import replace

import numpy as np
import pytest

from ostiform.correspondence import pull_back, sample, sample_with_derivative, sampler
from ostiform.domain import Circle, graded_template
from ostiform.embedding import placed_curves
from ostiform.errors import InputError
from ostiform.surface import distances_to_surface, normalised
from tests.star_shapes import (
    closed_domain,
    cup_domain,
    heart_domain,
    star_embedding,
    two_sphere_domain,
    wavy,
)

DOMAIN = heart_domain()
HEART = star_embedding(DOMAIN.spheres[0], wavy(0.15), 2500)
SHAPE = sampler([HEART], DOMAIN)
TEMPLATE = graded_template(DOMAIN, 900, iterations=5)


def tangents(rng, template=TEMPLATE):
    steps = rng.normal(size=template.points.shape)
    steps -= np.einsum("ni,ni->n", steps, template.points)[:, None] * template.points
    for index, circle in enumerate(DOMAIN.spheres[0].curves.values()):
        on = template.curve == index
        along = normalised(np.cross(circle.center, template.points[on]))
        steps[on] = np.einsum("ni,ni->n", steps[on], along)[:, None] * along
    return steps


def moved(steps, h):
    """Template points moved by h along the steps, curve points round their circle."""
    directions = normalised(TEMPLATE.points + h * steps)
    for index, circle in enumerate(DOMAIN.spheres[0].curves.values()):
        on = TEMPLATE.curve == index
        directions[on] = circle.points(circle.angles(directions[on]))
    return directions


def test_vertices_of_the_mesh_are_sampled_at_themselves():
    template = replace_points(HEART.directions)
    points = sample(SHAPE, template, HEART.directions)
    np.testing.assert_allclose(points, HEART.component.vertices, atol=1e-9)


def replace_points(directions):
    """A template without triangles whose points are the vertices of the heart."""
    curve = np.full(len(directions), -1)
    loops = {**HEART.component.rims}
    loops.update({seam.first: loop for seam, loop in HEART.component.seams.items()})
    for index, name in enumerate(TEMPLATE.curves):
        curve[loops[name]] = index
    return replace(
        TEMPLATE,
        points=directions,
        sphere=np.zeros(len(directions), dtype=np.int64),
        part=np.zeros(len(directions), dtype=np.int64),
        curve=curve,
        loops={},
    )


def test_samples_lie_on_the_surface_and_near_the_smooth_one():
    points = sample(SHAPE, TEMPLATE, TEMPLATE.points)
    component = HEART.component
    assert distances_to_surface(points, component.vertices, component.faces).max() < 1e-9
    smooth = wavy(0.15)(TEMPLATE.points)[:, None] * TEMPLATE.points
    edge = 30 * np.sqrt(8 * np.pi / np.sqrt(3) / 2500)
    assert np.linalg.norm(points - smooth, axis=1).max() < 0.1 * edge


def test_rim_and_seam_points_lie_on_their_own_polyline():
    points = sample(SHAPE, TEMPLATE, TEMPLATE.points)
    component = HEART.component
    loops = {**component.rims, **{seam.first: loop for seam, loop in component.seams.items()}}
    for name, loop in loops.items():
        segments = np.stack([loop, np.roll(loop, -1), np.roll(loop, -1)], axis=1)
        gaps = distances_to_surface(points[TEMPLATE.loops[name]], component.vertices, segments)
        assert gaps.max() < 1e-6


def test_seam_sampling_is_continuous_with_either_side():
    seam = TEMPLATE.loops["LV.mitral"]
    rng = np.random.default_rng(3)
    angles = rng.uniform(0, 2 * np.pi, len(seam))
    circle = DOMAIN.spheres[0].curves["LV.mitral"]
    directions = TEMPLATE.points.copy()
    directions[seam] = circle.points(angles)
    on_curve = sample(SHAPE, TEMPLATE, directions)[seam]
    free = replace(TEMPLATE, curve=np.where(TEMPLATE.curve == 5, -1, TEMPLATE.curve))
    for tilt in (1e-9, -1e-9):
        nearby = directions.copy()
        nearby[seam] = normalised(directions[seam] + [0, 0, tilt])
        np.testing.assert_allclose(sample(SHAPE, free, nearby)[seam], on_curve, atol=1e-6)


def test_the_derivative_has_a_quadratic_remainder(rng):
    steps = tangents(rng)
    points, jacobian = sample_with_derivative(SHAPE, TEMPLATE, TEMPLATE.points)
    np.testing.assert_array_equal(points, sample(SHAPE, TEMPLATE, TEMPLATE.points))
    change = np.einsum("nij,nj->ni", jacobian, steps)
    sizes = 10.0 ** np.array([-3.5, -4.0, -4.5, -5.0])
    remainders = []
    for h in sizes:
        after = sample(SHAPE, TEMPLATE, moved(steps, h))
        remainders.append(np.linalg.norm(after - points - h * change, axis=1))
    for points_of in (TEMPLATE.curve < 0, TEMPLATE.curve >= 0):
        # The median leaves out the few points that cross an edge of the mesh on the way.
        medians = np.median(np.array(remainders)[:, points_of], axis=1)
        slopes = np.diff(np.log(medians)) / np.diff(np.log(sizes))
        assert np.abs(slopes - 2).max() < 0.15


def test_the_derivative_along_the_direction_itself_is_zero():
    _, jacobian = sample_with_derivative(SHAPE, TEMPLATE, TEMPLATE.points)
    along = np.einsum("nij,nj->ni", jacobian, TEMPLATE.points)
    assert np.abs(along).max() < 1e-10 * np.abs(jacobian).max()


def test_points_beyond_a_rim_move_along_it_only():
    circle = DOMAIN.spheres[0].rims["LV.aortic"]
    loop = TEMPLATE.loops["LV.aortic"]
    inner = Circle(circle.center, 0.5 * circle.radius)
    directions = TEMPLATE.points.copy()
    directions[loop] = inner.points(circle.angles(directions[loop]))
    free = replace(TEMPLATE, curve=np.where(TEMPLATE.curve == 0, -1, TEMPLATE.curve))
    points, jacobian = sample_with_derivative(SHAPE, free, directions)
    np.testing.assert_allclose(
        points[loop], sample(SHAPE, TEMPLATE, TEMPLATE.points)[loop], atol=1e-9
    )
    radial = normalised(
        circle.center - directions[loop] * (directions[loop] @ circle.center)[:, None]
    )
    moving = np.einsum("nij,nj->ni", jacobian[loop], radial)
    assert np.abs(moving).max() < 1e-9 * np.abs(jacobian[loop]).max()


def test_sampling_follows_a_rigid_motion_of_the_shape(rng):
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    component = replace(HEART.component, vertices=HEART.component.vertices @ rotation.T + [5, 6, 7])
    other = sampler([replace(HEART, component=component)], DOMAIN)
    points, jacobian = sample_with_derivative(SHAPE, TEMPLATE, TEMPLATE.points)
    turned, turned_jacobian = sample_with_derivative(other, TEMPLATE, TEMPLATE.points)
    np.testing.assert_allclose(turned, points @ rotation.T + [5, 6, 7], atol=1e-9)
    np.testing.assert_allclose(turned_jacobian, rotation @ jacobian, atol=1e-8)


def test_pulling_back_inverts_sampling():
    points = sample(SHAPE, TEMPLATE, TEMPLATE.points)
    inside = TEMPLATE.curve < 0
    back = pull_back(SHAPE, 0, points[inside])
    np.testing.assert_allclose(back, TEMPLATE.points[inside], atol=1e-9)


def test_components_are_sampled_on_their_own_spheres():
    domain = two_sphere_domain()
    cup = star_embedding(cup_domain().spheres[0], lambda u: np.full(len(u), 10.0), 400)
    ball = star_embedding(closed_domain().spheres[0], lambda u: np.full(len(u), 20.0), 400)
    template = graded_template(domain, 300, iterations=3)
    points = sample(sampler([ball, cup], domain), template, template.points)
    radii = np.linalg.norm(points, axis=1)
    assert radii[template.sphere == 0].max() < 10.001
    assert radii[template.sphere == 1].min() > 19
    with pytest.raises(InputError, match="expected its embedding"):
        sampler([cup], domain)


def test_directions_of_the_wrong_shape_are_refused():
    with pytest.raises(InputError, match="one per template point"):
        sample(SHAPE, TEMPLATE, TEMPLATE.points[:-1])


def test_a_shape_without_one_of_the_openings_is_refused():
    rims = {n: loop for n, loop in HEART.component.rims.items() if n != "LA.RSPV"}
    component = replace(HEART.component, rims=rims)
    with pytest.raises(InputError, match=r"LA\.RSPV"):
        placed_curves(component, DOMAIN.spheres[0], HEART.directions)


def test_a_template_with_another_curve_is_refused():
    curves = ("LV.other", *TEMPLATE.curves[1:])
    with pytest.raises(InputError, match=r"LV\.other"):
        sample(SHAPE, replace(TEMPLATE, curves=curves), TEMPLATE.points)
