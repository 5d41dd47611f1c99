"""The term that keeps template triangles from being squeezed flat by the warps."""

import numpy as np
import pytest

from ostiform.correspondence.control_points import (
    basis_of,
    boundary_control_points,
    no_control_points,
)
from ostiform.correspondence.fields import circle_table, flow
from ostiform.correspondence.state import WarpState
from ostiform.correspondence.terms.crowding import Crowding, crowding_residuals
from tests.oracles.warped_shapes import triangulated, two_part_domain


def crowding_value(template, directions):
    return Crowding(template).value(WarpState(directions, directions), np.eye(4))


@pytest.fixture(scope="module")
def squeezed():
    domain = two_part_domain()
    template = triangulated(domain, 300)
    circles = circle_table(domain, template)
    spheres = len(domain.spheres)
    basis = basis_of(no_control_points(), boundary_control_points(circles, 1), circles, spheres)
    coefficients = np.random.default_rng(2).normal(0.0, 0.012, len(basis))
    return basis, template, flow(basis, template, template.points, coefficients)


def test_the_template_itself_is_not_crowded(squeezed):
    basis, template, _ = squeezed
    residuals, derivatives = crowding_residuals(basis, template, template.points)
    assert crowding_value(template, template.points) == 0.0
    assert residuals.shape == (0,)
    assert derivatives.shape == (0, len(basis))


def test_the_residuals_add_up_to_the_value(squeezed):
    basis, template, directions = squeezed
    residuals, _ = crowding_residuals(basis, template, directions)
    assert len(residuals) > 0
    np.testing.assert_allclose(
        residuals @ residuals, crowding_value(template, directions), rtol=1e-12
    )


def test_the_derivative_is_that_of_finite_differences(squeezed):
    basis, template, directions = squeezed
    residuals, derivatives = crowding_residuals(basis, template, directions)
    slope = 2.0 * residuals @ derivatives  # (D,)
    step = 1e-6
    for field in range(len(basis)):
        values = [
            crowding_value(
                template, flow(basis, template, directions, side * step * np.eye(len(basis))[field])
            )
            for side in (-1.0, 1.0)
        ]
        difference = (values[1] - values[0]) / (2.0 * step)
        np.testing.assert_allclose(difference, slope[field], atol=1e-4 * np.abs(slope).max())


def test_a_turned_triangle_costs_infinitely_much(squeezed):
    _, template, _ = squeezed
    turned = template.points.copy()
    first, second = template.faces[0, :2]
    turned[[first, second]] = turned[[second, first]]
    assert crowding_value(template, turned) == np.inf
