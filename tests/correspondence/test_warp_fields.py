import numpy as np
import pytest

from ostiform.correspondence.control_points import (
    basis_of,
    boundary_control_points,
    insert_interior,
    no_control_points,
)
from ostiform.correspondence.fields import (
    active,
    bump_fields,
    circle_table,
    flow,
    global_fields,
    join_fields,
    twist_fields,
)
from ostiform.correspondence.flow_kernels import velocities
from ostiform.correspondence.merged_velocity import merged_velocity
from ostiform.surface import exact_orientations
from ostiform.surface.sphere import spherical_fibonacci
from tests.oracles.warped_shapes import one_part_domain, triangulated, two_part_domain

ON_CIRCLE = 1e-12  # radians; points on circles are put back exactly


@pytest.fixture(params=[one_part_domain, two_part_domain])
def domain(request):
    return request.param()


@pytest.fixture
def template(domain):
    return triangulated(domain, 800)


@pytest.fixture
def basis(domain, template):
    circles = circle_table(domain, template)
    centers = spherical_fibonacci(16)
    own = np.zeros(len(centers), np.int64)
    bases = [bump_fields(circles, own, centers, np.full(16, 0.9), np.arange(16))]
    bases += [global_fields(circles, 0)]
    bases += [
        twist_fields(circles, row, 2 * np.pi * np.arange(3) / 3, 0.5, np.arange(3))
        for row in range(len(circles))
    ]
    return join_fields(bases, circles)


def random_coefficients(basis, rng, size):
    return size * rng.uniform(-1.0, 1.0, len(basis))


def test_points_on_circles_stay_on_them_and_slide(domain, template, basis, rng):
    moved = flow(basis, template, template.points, random_coefficients(basis, rng, 0.1))
    for number, circle in enumerate(domain.spheres[0].curves.values()):
        on = template.curve == number
        angles = np.arctan2(
            np.linalg.norm(np.cross(moved[on], circle.center), axis=1), moved[on] @ circle.center
        )
        np.testing.assert_allclose(angles, circle.radius, atol=ON_CIRCLE)
        assert np.linalg.norm(moved[on] - template.points[on], axis=1).max() > 1e-3


def test_warps_of_moderate_size_keep_every_triangle_turned_outward(template, basis, rng):
    for _ in range(5):
        moved = flow(basis, template, template.points, random_coefficients(basis, rng, 0.05))
        np.testing.assert_allclose(np.linalg.norm(moved, axis=1), 1.0, atol=1e-12)
        assert (exact_orientations(moved, template.faces) > 0).all()


def test_parts_stay_on_their_side_of_the_seam(rng):
    domain = two_part_domain()
    template = triangulated(domain, 800)
    circles = circle_table(domain, template)
    centers = spherical_fibonacci(16)
    basis = bump_fields(circles, np.zeros(16, np.int64), centers, np.full(16, 0.9), np.arange(16))
    moved = flow(basis, template, template.points, random_coefficients(basis, rng, 0.3))
    interior = template.curve < 0
    np.testing.assert_array_equal(
        np.sign(moved[interior, 2]), np.sign(template.points[interior, 2])
    )


def test_a_flow_is_undone_by_its_reverse(template, basis, rng):
    coefficients = random_coefficients(basis, rng, 0.1)
    there = flow(basis, template, template.points, coefficients, steps=32)
    back = flow(basis, template, there, -coefficients, steps=32)
    np.testing.assert_allclose(back, template.points, atol=1e-6)


def test_the_flow_converges_with_its_steps(template, basis, rng):
    coefficients = random_coefficients(basis, rng, 0.2)
    exact = flow(basis, template, template.points, coefficients, steps=128)
    errors = [
        np.abs(flow(basis, template, template.points, coefficients, steps=n) - exact).max()
        for n in (4, 16)
    ]
    assert errors[1] < errors[0] / 16.0  # at least second order in spite of the C2 kernels


def test_active_fields_are_the_derivative_of_the_flow_at_rest(template, basis, rng):
    coefficients = random_coefficients(basis, rng, 1.0)
    fields = active(basis, template, template.points)
    derivative = np.zeros_like(template.points)
    for point in range(len(template.points)):
        chosen = slice(fields.starts[point], fields.starts[point + 1])
        derivative[point] = coefficients[fields.fields[chosen]] @ fields.vectors[chosen]
    steps = 10.0 ** -np.arange(2.0, 4.1, 0.5)
    remainders = [
        np.abs(
            flow(basis, template, template.points, h * coefficients)
            - template.points
            - h * derivative
        ).max()
        for h in steps
    ]
    order = np.polyfit(np.log(steps), np.log(remainders), 1)[0]
    assert 1.9 < order < 2.1


def test_the_summed_velocity_is_that_of_the_fields(domain, template, rng):
    circles = circle_table(domain, template)
    interior = insert_interior(no_control_points(), template, 25.0 * template.points, 2)
    spheres = len(domain.spheres)
    basis = basis_of(interior, boundary_control_points(circles, 3), circles, spheres)
    coefficients = rng.normal(size=len(basis))
    fields = active(basis, template, template.points)
    expected = np.zeros_like(template.points)
    for point in range(len(expected)):
        own = slice(fields.starts[point], fields.starts[point + 1])
        expected[point] = coefficients[fields.fields[own]] @ fields.vectors[own]
    merged = merged_velocity(basis.table, basis.labels, basis.circles, coefficients)
    found = velocities(template.points, template.sphere, template.curve, *merged)
    np.testing.assert_allclose(found, expected, atol=1e-12)
