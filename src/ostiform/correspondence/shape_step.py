"""One shape's Gauss-Newton step on its own least-squares problem: pure, so it can be mapped.

The objective of a shape is ``z^T W z + penalty``: a quadratic form of its scaled, aligned
landmarks (Euclidean at level 1, the majoriser of the description length after) and the penalty on
its accumulated displacement. A step proposes coefficients of the basis fields at the current
positions; an advance composes their flow onto the current map and accepts it only if the
objective of the shape falls and no triangle of the template is turned over or nearly so.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.linalg.blas import dsyrk

from ostiform.arrays import FloatArray, IntArray
from ostiform.correspondence.assembly_kernels import (
    landmark_derivatives,
    motion_derivatives,
    normal_matrix,
    pulled_back,
    score_derivatives,
)
from ostiform.correspondence.crowding import crowding_residuals, crowding_value
from ostiform.correspondence.description_length import QuadraticForm, form_product, form_value
from ostiform.correspondence.landmarks import (
    LandmarkTerm,
    TemplateMarks,
    landmark_force,
    landmark_jacobian_rows,
    landmark_value,
)
from ostiform.correspondence.metric import MetricTerm, metric_residuals, metric_value
from ostiform.correspondence.metric_kernels import metric_system
from ostiform.correspondence.penalty import (
    DisplacementPenalty,
    penalty_force,
    penalty_hessian,
    penalty_value,
)
from ostiform.correspondence.sampling import ShapeSampler, sample, sample_with_derivative
from ostiform.correspondence.warps import (
    FieldBasis,
    active,
    fastest_point,
    flow,
    orientation_share,
)
from ostiform.domain import Template

# No point travels farther in one step (radians); longer steps are scaled down, which keeps the
# linearisation of the surface and two Runge-Kutta steps honest.
LONGEST_STEP = 0.15

# A template triangle keeps at least this share of its initial determinant.
LEAST_ORIENTATION_SHARE = 0.05

# Levenberg damping relative to the mean diagonal of the normal matrix: start, limits, and the
# factors after a full step and after a shortened or refused one.
FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e-6, 1e3
EASE, TIGHTEN = 1.0 / 3.0, 4.0

HALVINGS = 5

# Motions with less than this of the largest share are left out of a step's matrix (not of its
# gradient): half of them, whose curvature is then overestimated by little.
LEAST_SHARE_FELT = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class WarpState:
    """Where one shape's warp stands.

    Attributes
    ----------
    directions : (P, 3) float64
        Every template point's current position on its sphere.
    landmarks : (Q, 3) float64, mm
        The shape sampled at the optimiser's points, input coordinates.
    damping : float
        Levenberg damping of the next step.
    """

    directions: FloatArray
    landmarks: FloatArray
    damping: float = FIRST_DAMPING


@dataclass(frozen=True, slots=True, eq=False)
class WarpLevel:
    """What the shapes share during the sweeps of one level.

    Attributes
    ----------
    template : Template
        All P points: they are carried along and kept free of turned triangles.
    coarse : Template
        The Q points at which the objective is evaluated.
    index : (Q,) int64
        Their indices in `template`.
    basis : FieldBasis
        D fields.
    penalty : DisplacementPenalty
        On the Q points.
    curvature : (D, D) float64
        Half the penalty's second derivative at the identity warp.
    metric : MetricTerm
        Its reference is the mean of the conformal sampling; sweeps bring it up to date.
    marks : TemplateMarks or None
        Where the users' landmarks lie.
    terms : tuple of LandmarkTerm or None
        Of the shapes of the population that the level is swept with; empty without landmarks.
    """

    template: Template
    coarse: Template
    index: IntArray
    basis: FieldBasis
    penalty: DisplacementPenalty
    curvature: FloatArray
    metric: MetricTerm
    marks: TemplateMarks | None = None
    terms: tuple[LandmarkTerm | None, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class ShapeGoal:
    """What a shape's own least-squares problem measures beside its displacement.

    Attributes
    ----------
    form : QuadraticForm
        Of the Q aligned landmarks.
    metric : MetricTerm
        Of their edges.
    landmarks : LandmarkTerm or None
        Of the shape's own landmarks.
    """

    form: QuadraticForm
    metric: MetricTerm
    landmarks: LandmarkTerm | None = None


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


def warp_level(
    template: Template,
    coarse: Template,
    index: IntArray,
    basis: FieldBasis,
    penalty: DisplacementPenalty,
    metric: MetricTerm,
    marks: TemplateMarks | None = None,
    terms: tuple[LandmarkTerm | None, ...] = (),
) -> WarpLevel:
    """Return the shared values of a level, with the penalty's curvature at the identity."""
    fields = active(basis, coarse, coarse.points)
    curvature = penalty_hessian(penalty, fields, len(basis))
    return WarpLevel(template, coarse, index, basis, penalty, curvature, metric, marks, terms)


def start(sampler: ShapeSampler, level: WarpLevel, directions: FloatArray) -> WarpState:
    """Return the state of a shape whose template points are at `directions` (P, 3)."""
    return WarpState(directions, sample(sampler, level.coarse, directions[level.index]))


def objective(state: WarpState, level: WarpLevel, goal: ShapeGoal, transform: FloatArray) -> float:
    """Return ``z^T W z + penalty`` of a shape, all terms in it."""
    aligned = state.landmarks @ transform[:3, :3].T + transform[:3, 3]
    return (
        form_value(goal.form, aligned)
        + penalty_value(level.penalty, state.directions[level.index])
        + metric_value(goal.metric, state.landmarks)
        + landmark_value(goal.landmarks, state.landmarks)
        + crowding_value(level.template, state.directions)
    )


def gradient(
    sampler: ShapeSampler,
    state: WarpState,
    level: WarpLevel,
    goal: ShapeGoal,
    transform: FloatArray,
) -> FloatArray:
    """Return the derivative (D,) of the objective by the coefficients of a flow composed on top."""
    return 2.0 * _system(sampler, state, level, goal, transform).half_gradient


def propose(
    sampler: ShapeSampler,
    state: WarpState,
    level: WarpLevel,
    goal: ShapeGoal,
    transform: FloatArray,
) -> Proposal:
    """Return a Levenberg-damped Gauss-Newton step of one shape.

    Parameters
    ----------
    sampler : ShapeSampler
    state : WarpState
    level : WarpLevel
    goal : ShapeGoal
    transform : (4, 4) float64
        From input to aligned coordinates.
    """
    system = _system(sampler, state, level, goal, transform)
    half_gradient, hessian = system.half_gradient, system.hessian
    scores = score_derivatives(
        system.starts,
        system.fields,
        system.moved,
        np.ascontiguousarray(goal.form.modes.T),
        len(hessian),
    )  # (D, R)
    shares = goal.form.shares
    felt = shares > LEAST_SHARE_FELT * shares.max(initial=0.0)
    along = motion_derivatives(
        system.starts,
        system.fields,
        system.moved,
        np.ascontiguousarray(goal.form.motions[felt].T),
        len(hessian),
    ).reshape(len(hessian), -1)  # (D, 3S)
    hessian = hessian + level.curvature
    hessian += goal.form.scale * normal_matrix(
        system.starts, system.fields, system.moved, len(hessian)
    )
    explained = np.concatenate(
        [
            scores * np.sqrt(goal.form.gains),
            along * np.sqrt(np.tile(shares[felt], 3)),
        ],
        axis=1,
    )  # (D, R + 3S)
    lower = hessian.T  # a C array's transpose is what BLAS takes; it fills one triangle
    if explained.shape[1]:
        lower = dsyrk(-1.0, explained.T, 1.0, lower, trans=1, lower=1, overwrite_c=1)
    diagonal = np.diagonal(lower).copy()
    least = 1e-3 * max(float(diagonal.mean()), np.finfo(float).tiny)
    np.fill_diagonal(lower, diagonal + state.damping * np.maximum(diagonal, least))
    factor = cho_factor(lower, lower=True, overwrite_a=True, check_finite=False)
    coefficients = -cho_solve(factor, half_gradient)
    return Proposal(coefficients, half_gradient)


def advance(
    sampler: ShapeSampler,
    state: WarpState,
    level: WarpLevel,
    goal: ShapeGoal,
    transform: FloatArray,
    coefficients: FloatArray,
) -> tuple[WarpState, float]:
    """Return the state after the longest acceptable part of a step, and that part (0 to 1).

    Accepted is what lowers the shape's objective and leaves every template triangle at least a
    twentieth of its initial determinant; a step refused at every length leaves the state but for
    its damping.
    """
    before = objective(state, level, goal, transform)
    fastest = fastest_point(level.basis, level.coarse, state.directions[level.index], coefficients)
    part = min(1.0, LONGEST_STEP / max(fastest, np.finfo(float).tiny))
    limited = part < 1.0
    floor = min(LEAST_ORIENTATION_SHARE, orientation_share(level.template, state.directions))
    for halving in range(HALVINGS + 1):
        directions = flow(
            level.basis,
            level.template,
            state.directions,
            part * coefficients,
            fastest=part * fastest,
        )
        if orientation_share(level.template, directions) >= floor:
            landmarks = sample(sampler, level.coarse, directions[level.index])
            trial = WarpState(directions, landmarks, state.damping)
            if objective(trial, level, goal, transform) < before:
                factor = EASE if halving == 0 and not limited else 1.0 if halving <= 1 else TIGHTEN
                return replace(trial, damping=_clipped(state.damping * factor)), part
        part *= 0.5
    return replace(state, damping=_clipped(state.damping * TIGHTEN**2)), 0.0


def _clipped(damping: float) -> float:
    return min(max(damping, LEAST_DAMPING), MOST_DAMPING)


@dataclass(frozen=True, slots=True, eq=False)
class _System:
    """Half the gradient (D,), half the matrix (D, D) of the terms beside the form, a Jacobian.

    Those are the metric term, the users' landmarks and the crowding term.
    The Jacobian of the scaled, aligned landmarks is sparse: `moved` (A, 3) for the active fields.
    """

    half_gradient: FloatArray
    hessian: FloatArray
    starts: IntArray
    fields: IntArray
    moved: FloatArray


def _system(
    sampler: ShapeSampler,
    state: WarpState,
    level: WarpLevel,
    goal: ShapeGoal,
    transform: FloatArray,
) -> _System:
    directions = state.directions[level.index]
    fields = active(level.basis, level.coarse, directions)
    points, derivatives = sample_with_derivative(sampler, level.coarse, directions)
    linear = np.ascontiguousarray(transform[:3, :3])
    moved = landmark_derivatives(
        fields.starts, fields.vectors, derivatives, linear, goal.form.root_weights
    )
    force = form_product(goal.form, points @ linear.T + transform[:3, 3])
    count = len(level.basis)
    half_gradient = pulled_back(fields.starts, fields.fields, moved, force, count)
    half_gradient += pulled_back(
        fields.starts,
        fields.fields,
        fields.vectors,
        penalty_force(level.penalty, directions),
        count,
    )
    hessian = np.zeros((count, count))
    if goal.metric.strength > 0.0 or goal.landmarks is not None:
        unscaled = landmark_derivatives(
            fields.starts, fields.vectors, derivatives, np.eye(3), np.ones(len(points))
        )
    if goal.metric.strength > 0.0:
        slope, hessian = metric_system(
            points,
            goal.metric.edges,
            metric_residuals(goal.metric, points),
            goal.metric.strength * goal.metric.weights,
            fields.starts,
            fields.fields,
            unscaled,
            count,
        )
        half_gradient += slope
    if goal.landmarks is not None:
        pull = landmark_force(goal.landmarks, points)
        half_gradient += pulled_back(fields.starts, fields.fields, unscaled, pull, count)
        rows = landmark_jacobian_rows(goal.landmarks, fields.starts, fields.fields, unscaled, count)
        hessian = hessian + rows.T @ rows
    residuals, slopes = crowding_residuals(level.basis, level.template, state.directions)
    half_gradient += residuals @ slopes
    hessian = hessian + slopes.T @ slopes
    return _System(half_gradient, hessian, fields.starts, fields.fields, moved)
