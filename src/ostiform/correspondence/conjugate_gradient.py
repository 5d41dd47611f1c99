"""The paper's optimiser: one surface after another, in random order, by conjugate gradients.

Every surface's warp descends ``(N - 1) F + coherence + penalty`` with all other surfaces fixed,
along Polak-Ribiere directions with the analytic gradient (HY 2.3, reference 18). The increments
of a surface are composed flows, so the gradient is always taken at the identity, where it is
exact.
"""

from dataclasses import replace

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.correspondence.coherence import Coherence, coherence_form, joined_forms
from ostiform.correspondence.crowding import crowding_value
from ostiform.correspondence.description_length import (
    form_value,
    length_of_spectrum,
    majoriser,
    spectrum,
)
from ostiform.correspondence.landmarks import landmark_term, landmark_value
from ostiform.correspondence.metric import metric_value
from ostiform.correspondence.penalty import penalty_value
from ostiform.correspondence.sampling import ShapeSampler, sample
from ostiform.correspondence.shape_step import (
    LEAST_ORIENTATION_SHARE,
    LONGEST_STEP,
    ShapeGoal,
    WarpLevel,
    WarpState,
    gradient,
)
from ostiform.correspondence.shapes import GivenShapes, as_shapes
from ostiform.correspondence.sweeps import (
    Population,
    SweepOutcome,
    current_metric,
    sweep_outcome,
)
from ostiform.correspondence.warps import fastest_point, flow, orientation_share

STEPS_PER_SURFACE = 5

# Armijo's constant, and how often a step is halved before the surface is left alone.
SUFFICIENT_DECREASE = 1e-4
HALVINGS = 8

# The first trial step moves the fastest point this far (radians).
FIRST_MOVE = 0.03


def conjugate_gradient_sweep(
    shapes: GivenShapes,
    population: Population,
    level: WarpLevel,
    l_cut: float,
    coherence: Coherence,
    rng: np.random.Generator,
) -> tuple[Population, SweepOutcome]:
    """Return the population after every surface was optimised once, in random order.

    Parameters
    ----------
    shapes : Shapes or sequence of ShapeSampler
        Taken one after the other, in this process.
    population : Population
    level : WarpLevel
    l_cut : float
        mm^2.
    coherence : Coherence
        With the root weights of the Q landmarks.
    rng : numpy.random.Generator
        Permutes the surfaces.
    """
    count = len(population.states)
    kept = as_shapes(shapes)
    current = population
    taken = np.zeros((count, len(level.basis)))
    promised = 0.0
    for shape in rng.permutation(count):
        state, steps, expected = _optimised_surface(
            kept.at(int(shape)), current, int(shape), level, l_cut, coherence
        )
        states = (*current.states[:shape], state, *current.states[shape + 1 :])
        current = replace(current, states=states)
        taken[shape] = steps
        promised += expected
    return current, sweep_outcome(population, current, taken, promised / max(count - 1, 1))


def _optimised_surface(
    sampler: ShapeSampler,
    population: Population,
    shape: int,
    level: WarpLevel,
    l_cut: float,
    coherence: Coherence,
) -> tuple[WarpState, FloatArray, float]:
    """Return the state of one surface after a few steps, their sum, and the first decrease hoped.

    The hoped decrease is that along the gradient with the first trial's length.
    """
    aligned = population.aligned.copy()
    transform = population.transforms[shape]
    middle, root_weights = aligned.mean(axis=0), coherence.root_weights[:, None]
    weights = coherence.root_weights**2
    count = len(aligned)
    others = coherence_form(coherence, (count * middle - aligned[shape]) / (count - 1))
    scaled = ((aligned - middle) * root_weights).reshape(len(aligned), -1)  # (N, 3Q)
    gram = scaled @ scaled.T
    metric = current_metric(population, level)
    term = landmark_term(level.marks, sampler.marks)

    def cost(state: WarpState) -> float:
        own = _aligned(state, transform)
        row = (own - middle) * root_weights
        trial = scaled.copy()
        trial[shape] = row.ravel()
        changed = gram.copy()
        changed[shape] = changed[:, shape] = trial @ trial[shape]
        length = length_of_spectrum(_covariance_eigenvalues(changed), l_cut)
        # moving one shape moves the mean: about it, all terms together change as this one does
        rough = (1.0 - 1.0 / count) * form_value(others, own)
        penalty = penalty_value(level.penalty, state.directions[level.index])
        penalty += landmark_value(term, state.landmarks)
        penalty += crowding_value(level.template, state.directions)
        return (count - 1) * length + rough + penalty + metric_value(metric, state.landmarks)

    state = population.states[shape]
    total = np.zeros(len(level.basis))
    value, direction, before = cost(state), np.zeros_like(total), np.zeros_like(total)
    move, promised = FIRST_MOVE, 0.0
    for _ in range(STEPS_PER_SURFACE):
        aligned[shape] = _aligned(state, transform)
        form = majoriser(spectrum(aligned, weights), weights, l_cut)
        form = joined_forms(form, coherence_form(coherence, form.target))
        slope = gradient(sampler, state, level, ShapeGoal(form, metric, term), transform)
        momentum = max(0.0, float(slope @ (slope - before)) / float(before @ before or np.inf))
        direction = momentum * direction - slope
        if slope @ direction >= 0.0:
            direction = -slope
        descent = float(slope @ direction)
        fastest = fastest_point(level.basis, level.coarse, state.directions[level.index], direction)
        if fastest == 0.0 or descent == 0.0:
            break
        length = min(move, LONGEST_STEP) / fastest
        promised = promised or -0.5 * length * descent
        accepted = None
        for _halving in range(HALVINGS):
            trial = _moved(sampler, state, level, length * direction)
            reached = np.inf if trial is None else cost(trial)
            if reached < value + SUFFICIENT_DECREASE * length * descent:
                accepted = trial
                break
            length *= 0.5
        if accepted is None:
            break
        state, value, before = accepted, reached, slope
        total += length * direction
        move = 2.0 * length * fastest
    return state, total, promised


def _aligned(state: WarpState, transform: FloatArray) -> FloatArray:
    moved: FloatArray = state.landmarks @ transform[:3, :3].T + transform[:3, 3]
    return moved


def _covariance_eigenvalues(gram: FloatArray) -> FloatArray:
    """Return the eigenvalues of the covariance from the Gram matrix of uncentred rows."""
    centred = gram - gram.mean(axis=0)
    centred = centred - centred.mean(axis=1)[:, None]
    values: FloatArray = np.linalg.eigvalsh(centred)[1:] / (len(gram) - 1)
    return np.maximum(values, 0.0)


def _moved(
    sampler: ShapeSampler, state: WarpState, level: WarpLevel, coefficients: FloatArray
) -> WarpState | None:
    """Return the state after a flow, or None if it turns a template triangle over."""
    directions = flow(level.basis, level.template, state.directions, coefficients)
    floor = min(LEAST_ORIENTATION_SHARE, orientation_share(level.template, state.directions))
    if orientation_share(level.template, directions) < floor:
        return None
    return replace(
        state,
        directions=directions,
        landmarks=sample(sampler, level.coarse, directions[level.index]),
    )
