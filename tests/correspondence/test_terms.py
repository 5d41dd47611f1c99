"""Every term of the objective through the same interface: exact slopes, and one sum."""

from dataclasses import replace

import numpy as np
import pytest

from ostiform.correspondence.fields import flow, orientation_share
from ostiform.correspondence.objective import (
    population_values,
    shape_terms,
    system,
    value,
    values,
)
from ostiform.correspondence.shape_step import about, propose, start
from ostiform.correspondence.terms.coherence import coherence_about, coherence_form
from ostiform.correspondence.terms.crowding import Crowding
from ostiform.correspondence.terms.landmarks import template_marks
from tests.correspondence.test_shape_step import LEAST_SLOPE, bench
from tests.correspondence.test_user_landmarks import marked
from tests.oracles.warped_shapes import one_part_domain

NAMES = ("length", "coherence", "metric", "displacement", "crowding", "landmarks")


@pytest.fixture(scope="module")
def shape():
    """A sampler in a state away from the template, its level, and all terms."""
    fine = bench(one_part_domain(), n_vertices=6000, count=4)
    samplers = marked(fine.family, 0.5)
    level = replace(fine.level, marks=template_marks(samplers, fine.level.coarse))
    mean = fine.population.aligned.mean(axis=0)
    coherence = coherence_form(coherence_about(mean, fine.weights, 1e4), mean)
    forms = {**fine.forms, "coherence": coherence}
    terms = shape_terms(forms, level, level.metric, samplers[0].marks)
    amounts = 0.01 * np.random.default_rng(8).normal(size=len(level.basis))
    moved = level.template.points
    while orientation_share(level.template, moved) > 0.4:
        moved = flow(level.basis, level.template, moved, amounts)
    return samplers[0], start(samplers[0], level, moved), level, terms


def test_these_are_all_terms(shape):
    assert tuple(shape[3]) == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_every_term_has_a_taylor_remainder_of_second_order(shape, rng, name):
    sampler, state, level, terms = shape
    term, still = terms[name], np.eye(4)
    direction = rng.normal(size=len(level.basis))
    before = term.value(state, still)
    assert before > 0.0
    slope = 2.0 * term.system(about(sampler, state, level, still)).half_gradient @ direction
    # The crowding term is steep: its third derivative shows at longer steps.
    steps = np.array([0.02, 0.01, 0.005]) * (0.1 if name == "crowding" else 1.0)
    remainders = []
    for step in steps:
        moved = flow(level.basis, level.template, state.directions, step * direction)
        after = term.value(start(sampler, level, moved), still)
        remainders.append(abs(after - before - step * slope))
    assert np.polyfit(np.log(steps), np.log(remainders), 1)[0] > LEAST_SLOPE


def test_the_objective_is_the_sum_of_its_terms_in_value_and_system(shape):
    sampler, state, level, terms = shape
    still = np.eye(4)
    each = values(terms, state, still)
    assert tuple(each) == NAMES
    np.testing.assert_allclose(value(terms, state, still), sum(each.values()))
    at = about(sampler, state, level, still)
    total, parts = system(terms, at), [term.system(at) for term in terms.values()]
    np.testing.assert_allclose(
        total.half_gradient, sum(part.half_gradient for part in parts), rtol=1e-12
    )
    matrices = [part.matrix for part in parts if part.matrix is not None]
    assert len(matrices) == 4  # metric, displacement, crowding, landmarks
    np.testing.assert_allclose(total.matrix, sum(matrices), rtol=1e-12)
    inertias = [part.inertia for part in parts if part.inertia is not None]
    np.testing.assert_allclose(total.inertia, sum(inertias), rtol=1e-12)


def test_a_step_of_the_sum_is_that_of_its_dense_matrix(shape):
    sampler, state, level, terms = shape
    still = np.eye(4)
    at = about(sampler, state, level, still)
    total = system(terms, at)
    points, count = len(level.index), len(level.basis)
    jacobian = np.zeros((points, 3, count))
    for point in range(points):
        own = slice(at.fields.starts[point], at.fields.starts[point + 1])
        jacobian[point][:, at.fields.fields[own]] += at.turned[own].T
    matrix = total.matrix + np.einsum("q,qkd,qke->de", total.inertia, jacobian, jacobian)
    matrix -= total.explained @ total.explained.T
    diagonal = np.diagonal(matrix)
    matrix = matrix + state.damping * np.diag(np.maximum(diagonal, 1e-3 * diagonal.mean()))
    expected = -np.linalg.solve(matrix, total.half_gradient)
    found = propose(sampler, state, level, terms, still).coefficients
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())


def test_a_population_pays_the_sum_over_its_shapes(shape):
    _, state, level, _ = shape
    terms = {"crowding": Crowding(level.template), "displacement": level.displacement}
    transforms = np.broadcast_to(np.eye(4), (3, 4, 4))
    found = population_values([terms] * 3, [state] * 3, transforms)
    for name, own in values(terms, state, np.eye(4)).items():
        np.testing.assert_allclose(found[name], 1.5 * own)
