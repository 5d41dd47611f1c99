"""The metric term: what it measures, what it leaves free, and that it alone finds the way back."""

import numpy as np
import pytest

from ostiform.correspondence.state import WarpState
from ostiform.correspondence.terms.metric import (
    metric_residuals,
    metric_term,
    with_reference,
)
from tests.oracles.warped_shapes import one_part_domain, triangulated, two_part_domain


def metric_value(term, shape):
    return term.value(WarpState(shape, shape), np.eye(4))


@pytest.fixture
def template():
    return triangulated(two_part_domain(), 300)


@pytest.fixture
def shapes(template, rng):
    return 25.0 * template.points + rng.normal(scale=0.5, size=(5, *template.points.shape))


def test_a_shape_like_its_population_costs_nothing(template):
    term = metric_term(template, 25.0 * template.points, 100.0)
    np.testing.assert_allclose(metric_value(term, 25.0 * template.points), 0.0, atol=1e-20)


def test_rigid_motion_and_size_cost_nothing(template, shapes):
    term = with_reference(metric_term(template, shapes[0], 100.0), shapes)
    turn = np.linalg.qr(np.arange(9.0).reshape(3, 3) ** 2 + np.eye(3))[0]
    moved = 1.7 * shapes[1] @ turn.T + [3.0, -2.0, 8.0]
    np.testing.assert_allclose(metric_residuals(term, moved), metric_residuals(term, shapes[1]))


def test_parts_may_grow_apart_at_no_cost(template):
    term = metric_term(template, 25.0 * template.points, 100.0)
    north = template.points[:, 2:] > 1e-6
    grown = 25.0 * template.points * np.where(north, np.exp(0.3), 1.0)
    residuals = metric_residuals(term, grown)
    # Edges across the seam's row of triangles are stretched unlike their part; the others agree.
    same_side = north[term.edges[:, 0], 0] == north[term.edges[:, 1], 0]
    for part in (0, 1):
        of_part = residuals[(term.part == part) & same_side & (north[term.edges[:, 0], 0] == part)]
        assert np.ptp(of_part) < 1e-12
        assert abs(of_part[0]) < 0.15


def test_the_value_is_the_weighted_variance_of_logarithmic_lengths():
    template = triangulated(one_part_domain(), 200)
    shape = template.points * [20.0, 25.0, 30.0]
    term = metric_term(template, 25.0 * template.points, 7.0)
    ends = shape[term.edges]
    lengths = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
    deviation = np.log(lengths) - term.reference
    mean = np.average(deviation, weights=term.weights)
    variance = np.average((deviation - mean) ** 2, weights=term.weights)
    np.testing.assert_allclose(metric_value(term, shape), 7.0 * variance)


def test_the_reference_is_where_the_population_costs_least(template, shapes, rng):
    term = with_reference(metric_term(template, shapes[0], 1.0), shapes)
    best = sum(metric_value(term, shape) for shape in shapes)
    for _ in range(5):
        other = with_reference(term, shapes + rng.normal(scale=0.2, size=shapes.shape))
        assert sum(metric_value(other, shape) for shape in shapes) > best
