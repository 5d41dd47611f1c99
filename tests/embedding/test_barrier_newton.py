"""Newton minimisation on the sphere: rims turn, nothing folds, the status is true."""

import numpy as np
import pytest

from ostiform.embedding.continuation import continued
from ostiform.embedding.energy import EnergyWeights, energy_value
from ostiform.embedding.newton import MovingRim, map_problem, minimised
from ostiform.embedding.reference import surface_reference
from ostiform.surface import count_flipped, spherical_areas
from tests.oracles.spherical_domains import circle, domain_of_circles

WEIGHTS = EnergyWeights(0.0, 1.0, 1.0)


@pytest.fixture(scope="module")
def domain():
    rims = {"A.p": circle(0, 0, 20), "A.q": circle(100, 0, 10), "A.r": circle(120, 150, 8)}
    return domain_of_circles(rims, count=600, pole="A.p")


def _problem(domain, moving=True):
    component, sphere, identity = domain
    is_fixed = np.zeros(len(identity), dtype=bool)
    for rim in component.rims.values():
        is_fixed[rim] = True
    rims = [
        MovingRim(rim, sphere.rims[name], sphere.rims[name].angles(identity[rim]))
        for name, rim in component.rims.items()
    ]
    area = float(spherical_areas(identity, component.faces).sum())
    reference = surface_reference(component.vertices, component.faces, area)
    return map_problem(component.faces, reference, is_fixed, rims if moving else ()), is_fixed


def _disturbed(identity, is_fixed, rng, amount=0.01):
    directions = identity + amount * rng.normal(size=identity.shape) * ~is_fixed[:, None]
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def test_a_disturbed_identity_returns_to_the_identity(domain, rng):
    component, _, identity = domain
    problem, is_fixed = _problem(domain, moving=False)
    start = _disturbed(identity, is_fixed, rng)
    result = minimised(problem, start, WEIGHTS, 0.0, 40, 1e-10)
    assert result.has_converged
    assert result.least_ratio > 0.0
    # chords of a sphere are not flat: the minimum is the identity only up to their curvature
    np.testing.assert_allclose(result.directions, identity, atol=0.01)
    np.testing.assert_allclose(result.directions[is_fixed], identity[is_fixed], atol=1e-15)
    assert count_flipped(result.directions, component.faces) == 0


def test_rims_turn_back_on_their_circles(domain, rng):
    component, sphere, identity = domain
    problem, is_fixed = _problem(domain)
    turned = identity.copy()
    offsets = np.array([0.3, -0.4, 0.5])
    for rim, offset in zip(problem.rims, offsets, strict=True):
        turned[rim.loop] = rim.circle.points(rim.angles + offset)
    start = minimised(_problem(domain, moving=False)[0], turned, WEIGHTS, 0.1, 30, 1e-6).directions
    assert count_flipped(start, component.faces) == 0
    result = minimised(problem, start, WEIGHTS, 0.0, 60, 1e-9, rotations=offsets)
    # one turn of everything about no axis is free here: three circles fix the frame
    np.testing.assert_allclose(result.rotations, 0.0, atol=0.02)
    for name, rim in component.rims.items():
        cosines = result.directions[rim] @ sphere.rims[name].center
        np.testing.assert_allclose(cosines, np.cos(sphere.rims[name].radius), atol=1e-12)


def test_every_step_lowers_the_energy_and_keeps_the_map_upright(domain, rng):
    _, _, identity = domain
    problem, is_fixed = _problem(domain)
    current = _disturbed(identity, is_fixed, rng)
    reference = problem.reference
    kernel = (problem.faces, reference.gradients, reference.areas, WEIGHTS.as_array(), 0.0)
    energies = [energy_value(current, *kernel)[0]]
    rotations = np.zeros(3)
    for _ in range(4):
        result = minimised(problem, current, WEIGHTS, 0.0, 1, 1e-12, rotations)
        current, rotations = result.directions, result.rotations
        assert result.least_ratio > 0.0
        energies.append(result.energy)
    assert (np.diff(energies) < 0.0).all()


def test_too_few_iterations_are_reported(domain, rng):
    problem, is_fixed = _problem(domain)
    start = _disturbed(domain[2], is_fixed, rng)
    result = minimised(problem, start, WEIGHTS, 0.0, 1, 1e-12)
    assert not result.has_converged
    assert result.iterations == 1


def test_a_folded_start_is_refused_by_the_exact_barrier(domain):
    component, _, identity = domain
    problem, is_fixed = _problem(domain)
    folded = identity.copy()
    folded[np.flatnonzero(~is_fixed)[0]] *= -1.0
    result = minimised(problem, folded, WEIGHTS, 0.0, 10, 1e-6)
    assert result.energy == np.inf
    assert not result.has_converged
    assert result.iterations == 0
    np.testing.assert_array_equal(result.directions, folded)


def test_nothing_free_is_nothing_to_do(domain):
    component, _, identity = domain
    everything = np.ones(len(identity), dtype=bool)
    problem = map_problem(component.faces, _problem(domain)[0].reference, everything)
    assert problem.n_dofs == 0
    result = minimised(problem, identity, WEIGHTS, 0.0, 10, 1e-6)
    np.testing.assert_array_equal(result.directions, identity)


def test_short_steps_end_the_patience(domain, rng):
    # one nearly collapsed triangle caps every step of the exact barrier
    component, _, identity = domain
    problem, is_fixed = _problem(domain)
    start = identity.copy()
    triangle = component.faces[(~is_fixed[component.faces]).all(axis=1)][10]
    far, one, two = triangle
    middle = start[one] + start[two]
    start[far] = (1.0 - 1e-9) * middle / np.linalg.norm(middle) + 1e-9 * start[far]
    start[far] /= np.linalg.norm(start[far])
    assert count_flipped(start, component.faces) == 0
    hurried = minimised(problem, start, WEIGHTS, 0.0, 60, 1e-6, patience=1)
    patient = minimised(problem, start, WEIGHTS, 0.0, 60, 1e-6)
    assert hurried.iterations <= patient.iterations


def test_the_continuation_reaches_the_same_minimum_from_a_bad_start(domain, rng):
    component, _, identity = domain
    problem, is_fixed = _problem(domain)
    good = continued(problem, identity, WEIGHTS, is_fixed, 1e-7, 60)
    start = _disturbed(identity, is_fixed, rng, 0.02)
    assert count_flipped(start, component.faces) == 0
    bad = continued(problem, start, WEIGHTS, is_fixed, 1e-7, 60)
    assert good.has_converged
    assert bad.has_converged
    np.testing.assert_allclose(bad.energy, good.energy, rtol=1e-5)
    np.testing.assert_allclose(bad.directions, good.directions, atol=5e-3)


def test_the_continuation_recovers_when_its_iterations_run_out(domain, rng):
    component, _, identity = domain
    problem, is_fixed = _problem(domain)
    start = _disturbed(identity, is_fixed, rng, 0.02)
    result = continued(problem, start, WEIGHTS, is_fixed, 1e-16, 1)
    assert not result.has_converged
    assert count_flipped(result.directions, component.faces) == 0
