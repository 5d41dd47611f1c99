"""One shape's step: exact gradients, decreasing objectives, no turned triangle."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from ostiform.arrays import FloatArray
from ostiform.correspondence import CorrespondenceSettings, correspond
from ostiform.correspondence.build import shared_metric_of_template
from ostiform.correspondence.checkpoint import Callbacks, LevelStatus, Population
from ostiform.correspondence.conjugate_gradient import conjugate_gradient_sweep
from ostiform.correspondence.control_points import (
    basis_of,
    boundary_control_points,
    insert_interior,
    no_control_points,
)
from ostiform.correspondence.fields import circle_table, flow, global_fields, orientation_share
from ostiform.correspondence.hierarchy import annealed_cut_offs
from ostiform.correspondence.level import WarpLevel, warp_level
from ostiform.correspondence.objective import population_values, shape_terms, value
from ostiform.correspondence.shape_step import (
    advance,
    gradient,
    propose,
    start,
)
from ostiform.correspondence.state import WarpState
from ostiform.correspondence.sweeps import (
    SweepObjective,
    area_shares,
    current_metric,
    joint_sweep,
    run_sweeps,
)
from ostiform.correspondence.terms.coherence import coherence_about, coherence_value
from ostiform.correspondence.terms.description_length import (
    cut_off_eigenvalue,
    description_length,
    majoriser,
    spectrum,
)
from ostiform.correspondence.terms.displacement import (
    displacement_penalty,
)
from ostiform.correspondence.terms.distance import euclidean_form
from ostiform.correspondence.terms.metric import metric_term, with_reference
from ostiform.correspondence.warp import Warps
from ostiform.domain import Template
from tests.oracles.warped_shapes import (
    WarpedFamily,
    one_part_domain,
    triangulated,
    two_part_domain,
    warped_family,
)

# The sampled surface is piecewise linear: its kinks spoil the second order of the remainder where
# points cross edges, less on finer meshes. Observed slopes lie between 1.9 and 2.1.
LEAST_SLOPE = 1.7


@dataclass(frozen=True)
class Bench:
    """A population on one level, without any alignment."""

    family: WarpedFamily
    template: Template
    weights: FloatArray
    level: WarpLevel
    population: Population
    l_cut: float

    @property
    def forms(self):
        found = spectrum(self.population.aligned, self.weights)
        return {"length": majoriser(found, self.weights, self.l_cut)}

    @property
    def terms(self):
        return shape_terms(self.forms, self.level, self.level.metric, None)


def bench(domain, *, metric=100.0, stretch=100.0, n_vertices=2500, count=5) -> Bench:
    family = warped_family(
        domain, count, np.random.default_rng(11), n_vertices=n_vertices, warp=0.1, twist=0.05
    )
    template = triangulated(domain, 250)
    circles = circle_table(domain, template)
    identity = np.broadcast_to(np.eye(4), (count, 4, 4))
    weights = np.full(len(template.points), 1.0 / len(template.points))
    interior = insert_interior(no_control_points(), template, 25.0 * template.points, 2)
    basis = basis_of(interior, boundary_control_points(circles, 2), circles, 1)
    term = metric_term(template, 25.0 * template.points, metric)
    level = warp_level(template, len(weights), weights, basis, (stretch, stretch), term)
    states = tuple(start(shape, level, template.points) for shape in family.samplers)
    population = Population(states, identity)
    level = replace(level, metric=with_reference(term, population.landmarks))
    l_cut = cut_off_eigenvalue(0.3, count, len(template.points))
    return Bench(family, template, weights, level, population, l_cut)


@pytest.fixture(scope="module", params=[one_part_domain, two_part_domain])
def fine(request) -> Bench:
    return bench(request.param(), n_vertices=6000, count=4)


@pytest.fixture(scope="module", params=[one_part_domain, two_part_domain])
def population(request) -> Bench:
    return bench(request.param())


@pytest.mark.parametrize("kind", ["global", "interior", "boundary"])
def test_the_gradient_has_a_taylor_remainder_of_second_order(fine, rng, kind):
    level, state = fine.level, fine.population.states[0]
    control = level.basis.control
    n_interior = control.max() + 1 - 3 * len(level.basis.circles)
    chosen = {
        "global": control < 0,
        "interior": (control >= 0) & (control < n_interior),
        "boundary": control >= n_interior,
    }[kind]
    direction = rng.normal(size=len(level.basis)) * chosen
    terms = fine.terms
    before = value(terms, state, np.eye(4))
    slope = gradient(fine.family.samplers[0], state, level, terms, np.eye(4)) @ direction
    steps = np.array([0.02, 0.01, 0.005])
    remainders = []
    for step in steps:
        moved = flow(level.basis, level.template, state.directions, step * direction)
        after = value(terms, start(fine.family.samplers[0], level, moved), np.eye(4))
        remainders.append(abs(after - before - step * slope))
    order = np.polyfit(np.log(steps), np.log(remainders), 1)[0]
    assert order > LEAST_SLOPE


def test_the_displacement_penalty_does_not_depend_on_how_finely_the_template_is_drawn():
    found = []
    for count in (400, 1600):
        template = triangulated(one_part_domain(), count)
        index = np.arange(len(template.points))
        weights = np.full(len(index), 1.0 / len(index))
        basis = global_fields(np.zeros((0, 8)), 0)
        penalty = displacement_penalty(template, index, weights, (100.0, 10.0), basis)
        bent = template.points + 0.05 * np.sin(3.0 * template.points[:, [1, 2, 0]])
        found.append(penalty.value(WarpState(bent, bent), np.eye(4)))
    # Points on the rims weigh more on the coarse template: the boundary share scales with h.
    np.testing.assert_allclose(found[0], found[1], rtol=0.1)


def test_an_accepted_step_lowers_the_shapes_own_objective(population):
    terms = population.terms
    accepted = 0
    for sampler, state in zip(
        population.family.samplers, population.population.states, strict=True
    ):
        wanted = propose(sampler, state, population.level, terms, np.eye(4)).coefficients
        after, step = advance(sampler, state, population.level, terms, np.eye(4), wanted)
        before = value(terms, state, np.eye(4))
        if step.coefficients.any():
            accepted += 1
            assert value(terms, after, np.eye(4)) < before
        assert orientation_share(population.template, after.directions) > 0.0
    assert accepted > 0


def test_an_ascent_step_is_refused_and_only_tightens_the_damping(population):
    terms = population.terms
    sampler, state = population.family.samplers[0], population.population.states[0]
    uphill = gradient(sampler, state, population.level, terms, np.eye(4))
    uphill *= 0.05 / np.linalg.norm(uphill)
    after, step = advance(sampler, state, population.level, terms, np.eye(4), uphill)
    assert not step.coefficients.any()
    assert after.damping > state.damping
    np.testing.assert_array_equal(after.directions, state.directions)


def test_a_violent_step_is_shortened_before_it_turns_a_triangle(population, rng):
    level, state = population.level, population.population.states[0]
    # An objective that any motion lowers: the target lies far away in every direction.
    far = euclidean_form(1e3 * population.template.points, population.weights, 1e-6)
    terms = shape_terms({"distance": far}, level, replace(level.metric, strength=0.0), None)
    wanted = 30.0 * rng.normal(size=len(level.basis))
    after, step = advance(population.family.samplers[0], state, level, terms, np.eye(4), wanted)
    part = step.coefficients / wanted
    np.testing.assert_allclose(part, part[0])
    assert 0.0 <= part[0] < 1.0
    assert orientation_share(population.template, after.directions) >= 0.1


def sum_of_terms(bench, current, forms_value):
    """The objective of a population: what it charges the aligned points for, and the others."""
    metric = current_metric(current, bench.level)
    terms = [shape_terms({}, bench.level, metric, None)] * len(current.states)
    others = population_values(terms, current.states, current.transforms)
    return forms_value + sum(others.values())


def test_description_length_and_penalty_never_rise_at_frozen_weights(population):
    current = population.population
    found = []
    for _ in range(6):
        length = description_length(current.aligned, population.weights, population.l_cut)
        found.append(sum_of_terms(population, current, length))
        now = replace(population, population=current)
        current, _ = joint_sweep(
            population.family.samplers,
            current,
            population.level,
            (now.forms,) * len(current.states),
            current_metric(current, population.level),
        )
    assert (np.diff(found) <= 1e-9 * found[0]).all()
    assert found[-1] < 0.98 * found[0]


def swept_once(population):
    return joint_sweep(
        population.family.samplers,
        population.population,
        population.level,
        (population.forms,) * len(population.population.states),
        current_metric(population.population, population.level),
    )


def test_a_sweep_leaves_no_velocity_common_to_all_shapes(population):
    _, outcome = swept_once(population)
    assert outcome.accepted == len(population.population.states)
    assert outcome.drift < 1e-10


def test_the_steps_of_a_sweep_lead_where_it_led(population):
    moved, outcome = swept_once(population)
    warps = Warps(population.family.ids, (population.level.basis,), (outcome.steps,))
    template = population.template
    for index, state in enumerate(moved.states):
        carried = warps.at(index)(template.points, template.sphere)
        np.testing.assert_array_equal(carried, state.directions)


@pytest.mark.parametrize("strength", [0.0, 2e5])
def test_conjugate_gradients_lower_the_objective_and_follow_their_seed(population, strength):
    mean = population.population.aligned.mean(axis=0)
    coherence = coherence_about(mean, population.weights, strength)

    def swept(seed):
        return conjugate_gradient_sweep(
            population.family.samplers,
            population.population,
            population.level,
            population.l_cut,
            coherence,
            np.random.default_rng(seed),
        )[0]

    def reached(current):
        length = description_length(current.aligned, population.weights, population.l_cut)
        rough = coherence_value(coherence, current.aligned)
        return sum_of_terms(population, current, length + rough)

    first, again = swept(1), swept(1)
    assert reached(first) < reached(population.population)
    np.testing.assert_array_equal(first.landmarks, again.landmarks)


def test_every_status_is_reached(population):
    def run(take, tolerance, sweeps):
        chosen = SweepObjective(lambda current: {"length": 1.0}, take, lambda current: current)
        return run_sweeps(
            population.population,
            len(population.level.basis),
            chosen,
            ("optimal", 2),
            (sweeps, tolerance),
            Callbacks(),
        )

    real = swept_once(population)

    def still(accepted, expected):
        outcome = replace(real[1], accepted=accepted, expected=expected)
        return lambda current: (current, outcome)

    assert run(still(3, 0.0), 1e-3, 3).status is LevelStatus.CONVERGED
    assert run(still(0, 1e9), 1e-3, 3).status is LevelStatus.STALLED
    assert run(still(3, 1e9), 1e-3, 3).status is LevelStatus.SWEEP_LIMIT
    assert len(run(still(3, 1e9), 1e-3, 3).records) == 4


def test_cut_offs_fall_geometrically_to_the_noise():
    cut_offs = np.array(annealed_cut_offs(0.01, 10.0, 5))
    np.testing.assert_allclose(cut_offs[0], 10.0)
    np.testing.assert_allclose(cut_offs[-1], 0.01)
    np.testing.assert_allclose(cut_offs[1:] / cut_offs[:-1], 0.1)
    np.testing.assert_allclose(annealed_cut_offs(0.01, 10.0, 2), [0.01])
    np.testing.assert_allclose(annealed_cut_offs(0.01, 1e-6, 3), [0.01, 0.01])
    assert annealed_cut_offs(0.01, 10.0, 1) == ()


def test_area_shares_sum_to_one(population):
    shares = area_shares(population.population.landmarks, population.template.faces)
    np.testing.assert_allclose(shares.sum(axis=1), 1.0)


def test_progress_hears_of_every_sweep():
    domain = one_part_domain()
    family = warped_family(domain, 3, np.random.default_rng(2), n_vertices=400)
    template = triangulated(domain, 150)
    settings = CorrespondenceSettings(levels=2, n_points=150, n_optimised=100, sweeps=2)
    shared = shared_metric_of_template(family.samplers, family.ids, domain, template, settings)
    heard = []
    trained = correspond(family.samplers, family.ids, shared, settings, heard.append)
    swept = [record for record in trained["optimal"].history if record.sweep > 0]
    assert heard == swept
