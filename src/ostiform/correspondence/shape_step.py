"""One shape's Gauss-Newton step on its own least-squares problem: pure, so it can be mapped.

The objective of a shape is the sum of its terms (see `objective`). A step proposes coefficients of
the basis fields at the current positions; an advance composes their flow onto the current map and
accepts it only if the objective of the shape falls and no triangle of the template is turned over
or nearly so.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.linalg.blas import dsyrk

from ostiform.arrays import FloatArray
from ostiform.correspondence.assembly_kernels import normal_matrix
from ostiform.correspondence.fields import fastest_point, flow, orientation_share
from ostiform.correspondence.level import WarpLevel
from ostiform.correspondence.objective import Terms, system, value
from ostiform.correspondence.sampling import ShapeSampler, sample
from ostiform.correspondence.state import Linearised, WarpState, linearised
from ostiform.correspondence.terms.term import System
from ostiform.correspondence.warp import Step, no_step

# No point travels farther in one step (radians); longer steps are scaled down, which keeps the
# linearisation of the surface and two Runge-Kutta steps honest.
LONGEST_STEP = 0.15

# A template triangle keeps at least this share of its initial determinant.
LEAST_ORIENTATION_SHARE = 0.05

# Levenberg damping relative to the mean diagonal of the normal matrix: its limits, and the factors
# after a full step and after a shortened or refused one.
LEAST_DAMPING, MOST_DAMPING = 1e-6, 1e3
EASE, TIGHTEN = 1.0 / 3.0, 4.0

HALVINGS = 5


@dataclass(frozen=True, slots=True, eq=False)
class Proposal:
    """A step that a shape would like to take.

    Attributes
    ----------
    coefficients : (D,) float64
    half_gradient : (D,) float64
        Half the derivative of the shape's objective. Minus its product with the coefficients is
        the decrease that the quadratic model promises: the squared gradient in the metric of its
        Hessian, so a measure of the gradient without units.
    """

    coefficients: FloatArray
    half_gradient: FloatArray


def start(sampler: ShapeSampler, level: WarpLevel, directions: FloatArray) -> WarpState:
    """Return the state of a shape whose template points are at `directions` (P, 3)."""
    return WarpState(directions, sample(sampler, level.coarse, directions[level.index]))


def about(
    sampler: ShapeSampler, state: WarpState, level: WarpLevel, transform: FloatArray
) -> Linearised:
    """Return the first order of a shape about its state, in the fields of a level."""
    return linearised(sampler, state, level.basis, level.coarse, level.index, transform)


def gradient(
    sampler: ShapeSampler,
    state: WarpState,
    level: WarpLevel,
    terms: Terms,
    transform: FloatArray,
) -> FloatArray:
    """Return the derivative (D,) of the objective by the coefficients of a flow composed on top."""
    return 2.0 * system(terms, about(sampler, state, level, transform)).half_gradient


def propose(
    sampler: ShapeSampler,
    state: WarpState,
    level: WarpLevel,
    terms: Terms,
    transform: FloatArray,
) -> Proposal:
    """Return a Levenberg-damped Gauss-Newton step of one shape.

    Parameters
    ----------
    sampler : ShapeSampler
    state : WarpState
    level : WarpLevel
    terms : mapping of str to Term
        See `objective.shape_terms`.
    transform : (4, 4) float64
        From input to aligned coordinates.
    """
    at = about(sampler, state, level, transform)
    total = system(terms, at)
    lower = _lower_triangle(total, at)
    diagonal = np.diagonal(lower).copy()
    least = 1e-3 * max(float(diagonal.mean()), np.finfo(float).tiny)
    np.fill_diagonal(lower, diagonal + state.damping * np.maximum(diagonal, least))
    factor = cho_factor(lower, lower=True, overwrite_a=True, check_finite=False)
    return Proposal(-cho_solve(factor, total.half_gradient), total.half_gradient)


def _lower_triangle(total: System, at: Linearised) -> FloatArray:
    """Return half the Gauss-Newton matrix (D, D) in Fortran order; its lower triangle counts."""
    count = len(at.basis)
    matrix = np.zeros((count, count)) if total.matrix is None else total.matrix
    if total.inertia is not None:
        moved = at.scaled(np.sqrt(total.inertia))
        matrix += normal_matrix(at.fields.starts, at.fields.fields, moved, count)
    lower: FloatArray = matrix.T  # a C array's transpose is what BLAS takes
    if total.explained is not None:
        lower = dsyrk(-1.0, total.explained.T, 1.0, lower, trans=1, lower=1, overwrite_c=1)
    return lower


def advance(
    sampler: ShapeSampler,
    state: WarpState,
    level: WarpLevel,
    terms: Terms,
    transform: FloatArray,
    coefficients: FloatArray,
) -> tuple[WarpState, Step]:
    """Return the state after the longest acceptable part of a step, and that part.

    Accepted is what lowers the shape's objective and leaves every template triangle at least a
    twentieth of its initial determinant; a step refused at every length leaves the state but for
    its damping.
    """
    before = value(terms, state, transform)
    fastest = fastest_point(level.basis, level.coarse, state.directions[level.index], coefficients)
    part = min(1.0, LONGEST_STEP / max(fastest, np.finfo(float).tiny))
    limited = part < 1.0
    floor = min(LEAST_ORIENTATION_SHARE, orientation_share(level.template, state.directions))
    for halving in range(HALVINGS + 1):
        step = Step(part * coefficients, part * fastest)
        directions = flow(
            level.basis, level.template, state.directions, step.coefficients, fastest=step.fastest
        )
        if orientation_share(level.template, directions) >= floor:
            landmarks = sample(sampler, level.coarse, directions[level.index])
            trial = WarpState(directions, landmarks, state.damping)
            if value(terms, trial, transform) < before:
                factor = EASE if halving == 0 and not limited else 1.0 if halving <= 1 else TIGHTEN
                return replace(trial, damping=_clipped(state.damping * factor)), step
        part *= 0.5
    refused = replace(state, damping=_clipped(state.damping * TIGHTEN**2))
    return refused, no_step(len(coefficients))


def _clipped(damping: float) -> float:
    return min(max(damping, LEAST_DAMPING), MOST_DAMPING)
