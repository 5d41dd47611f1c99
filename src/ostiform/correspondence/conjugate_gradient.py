"""The paper's optimiser: one surface after another, in random order, by conjugate gradients.

Every surface's warp descends ``(N - 1) F + coherence + penalty`` with all other surfaces fixed,
along Polak-Ribiere directions with the analytic gradient (HY 2.3, reference 18). The increments
of a surface are composed flows, so the gradient is always taken at the identity, where it is
exact.
"""

from dataclasses import dataclass, replace

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.correspondence.checkpoint import Population
from ostiform.correspondence.fields import fastest_point, flow, orientation_share
from ostiform.correspondence.level import WarpLevel
from ostiform.correspondence.objective import Terms, shape_terms, value
from ostiform.correspondence.sampling import ShapeSampler, sample
from ostiform.correspondence.shape_step import LEAST_ORIENTATION_SHARE, LONGEST_STEP, gradient
from ostiform.correspondence.shapes import GivenShapes, as_shapes
from ostiform.correspondence.state import Linearised, WarpState, aligned_landmarks
from ostiform.correspondence.sweeps import SweepOutcome, current_metric, sweep_outcome
from ostiform.correspondence.terms.coherence import Coherence, coherence_form
from ostiform.correspondence.terms.description_length import (
    length_of_spectrum,
    majoriser,
    spectrum,
)
from ostiform.correspondence.terms.term import System
from ostiform.correspondence.warp import Step, steps_of

STEPS_PER_SURFACE = 5

# Armijo's constant, and how often a step is halved before the surface is left alone.
SUFFICIENT_DECREASE = 1e-4
HALVINGS = 8

# The first trial step moves the fastest point this far (radians).
FIRST_MOVE = 0.03


@dataclass(frozen=True, slots=True, eq=False)
class LengthOfOne:
    """(N - 1) times the description length of a population, as one of its shapes moves.

    Attributes
    ----------
    aligned : (N, Q, 3) float64, mm
        All shapes before.
    shape : int
        The one that moves.
    weights : (Q,) float64
    l_cut : float
        mm^2.
    middle : (Q, 3) float64
        Mean of all before.
    scaled : (N, 3Q) float64
        Scaled deviations from it.
    gram : (N, N) float64
        Their scalar products.
    """

    aligned: FloatArray
    shape: int
    weights: FloatArray
    l_cut: float
    middle: FloatArray
    scaled: FloatArray
    gram: FloatArray

    def value(self, state: WarpState, transform: FloatArray) -> float:
        """Return the term where the shape is now."""
        own = aligned_landmarks(state, transform)
        row = ((own - self.middle) * np.sqrt(self.weights)[:, None]).ravel()
        products = self.scaled @ row
        products[self.shape] = row @ row
        changed = self.gram.copy()
        changed[self.shape] = changed[:, self.shape] = products
        length = length_of_spectrum(_covariance_eigenvalues(changed), self.l_cut)
        return (len(self.aligned) - 1) * length

    def system(self, at: Linearised) -> System:
        """Return the system of the majoriser, which touches the length where the shape is now."""
        aligned = self.aligned.copy()
        aligned[self.shape] = aligned_landmarks(at.state, at.transform)
        return majoriser(spectrum(aligned, self.weights), self.weights, self.l_cut).system(at)


def length_of_one(
    aligned: FloatArray, shape: int, weights: FloatArray, l_cut: float
) -> LengthOfOne:
    """Return the description length as a term of one shape of a population (N, Q, 3)."""
    middle = aligned.mean(axis=0)
    scaled = ((aligned - middle) * np.sqrt(weights)[:, None]).reshape(len(aligned), -1)
    return LengthOfOne(aligned, shape, weights, l_cut, middle, scaled, scaled @ scaled.T)


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
    taken: list[list[Step]] = [[] for _ in range(count)]
    promised = 0.0
    for shape in rng.permutation(count):
        state, steps, expected = _optimised_surface(
            kept.at(int(shape)), current, int(shape), level, l_cut, coherence
        )
        states = (*current.states[:shape], state, *current.states[shape + 1 :])
        current = replace(current, states=states)
        taken[shape] = steps
        promised += expected
    steps_taken = steps_of(taken, len(level.basis))
    return current, sweep_outcome(population, current, steps_taken, promised / max(count - 1, 1))


def _optimised_surface(
    sampler: ShapeSampler,
    population: Population,
    shape: int,
    level: WarpLevel,
    l_cut: float,
    coherence: Coherence,
) -> tuple[WarpState, list[Step], float]:
    """Return the state of one surface after a few steps, these, and the first decrease hoped.

    The hoped decrease is that along the gradient with the first trial's length.
    """
    aligned = population.aligned
    transform = population.transforms[shape]
    count = len(aligned)
    # Moving one shape moves the mean: about the mean of the others, all shapes' terms together
    # change as (1 - 1 / N) of this one's does.
    middle = (aligned.sum(axis=0) - aligned[shape]) / (count - 1)
    weaker = replace(coherence, strength=(1.0 - 1.0 / count) * coherence.strength)
    forms: Terms = {
        "length": length_of_one(aligned, shape, coherence.root_weights**2, l_cut),
        "coherence": coherence_form(weaker, middle),
    }
    terms = shape_terms(forms, level, current_metric(population, level), sampler.marks)
    state = population.states[shape]
    cost = value(terms, state, transform)
    steps: list[Step] = []
    direction, before = np.zeros(len(level.basis)), np.zeros(len(level.basis))
    move, promised = FIRST_MOVE, 0.0
    for _ in range(STEPS_PER_SURFACE):
        slope = gradient(sampler, state, level, terms, transform)
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
            step = Step(length * direction, length * fastest)
            trial = _moved(sampler, state, level, step)
            reached = np.inf if trial is None else value(terms, trial, transform)
            if reached < cost + SUFFICIENT_DECREASE * length * descent:
                accepted = trial
                break
            length *= 0.5
        if accepted is None:
            break
        state, cost, before = accepted, reached, slope
        steps.append(step)
        move = 2.0 * length * fastest
    return state, steps, promised


def _covariance_eigenvalues(gram: FloatArray) -> FloatArray:
    """Return the eigenvalues of the covariance from the Gram matrix of uncentred rows."""
    centred = gram - gram.mean(axis=0)
    centred = centred - centred.mean(axis=1)[:, None]
    values: FloatArray = np.linalg.eigvalsh(centred)[1:] / (len(gram) - 1)
    return np.maximum(values, 0.0)


def _moved(
    sampler: ShapeSampler, state: WarpState, level: WarpLevel, step: Step
) -> WarpState | None:
    """Return the state after a flow, or None if it turns a template triangle over."""
    directions = flow(
        level.basis, level.template, state.directions, step.coefficients, fastest=step.fastest
    )
    floor = min(LEAST_ORIENTATION_SHARE, orientation_share(level.template, state.directions))
    if orientation_share(level.template, directions) < floor:
        return None
    return replace(
        state,
        directions=directions,
        landmarks=sample(sampler, level.coarse, directions[level.index]),
    )
