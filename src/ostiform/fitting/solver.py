"""Maximum a posteriori shape and pose: Gauss-Newton with Student-t weights and estimated noise.

Unknowns are the standard normal coefficients z of the prior and an increment of the pose. With
observations r = direction . (goal - point) of rows J, the iteration maximises

    -1/2 |z|^2 - sum_i w_i (nu + d_i) / 2 log(1 + |r_i|^2 / (nu s^2)),

a Student-t likelihood of nu degrees of freedom and scale s, by expectation-maximisation: every
observation gets the weight (nu + d) / (nu + |r|^2 / s^2), the linear problem is solved, and s^2 is
the weighted mean square over the number of observations less what the unknowns took (Lange,
Little & Taylor 1989; MacKay 1992 for the latter). The data are paired anew every time.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial.transform import Rotation

from ostiform.arrays import BoolArray, FloatArray
from ostiform.fitting.kernels import design_rows
from ostiform.fitting.observations import (
    CONTOURS,
    KINDS,
    POINTS,
    Data,
    Observations,
    model_surface,
    observations,
)
from ostiform.fitting.prior import FitPrior
from ostiform.fitting.types import FitSettings, Pose, placed

__all__ = ["Rules", "Solution", "State", "linear_system", "moved", "placed_points", "solve"]

STUDENT_DOF = 3.0
"""Of the data's distribution: heavy enough for a fifth of outliers."""

STUDENT_PEAK = 2.0 / (np.pi * np.sqrt(3.0))
"""Density of that distribution, of scale 1, at zero."""

OUTLIER_REACH = 0.25
"""Of the shape's size: outliers are spread over distances from 0 to this."""

SHARE_BOUNDS = (0.5, 0.99)
"""Of the share of the data that is no outlier: with fewer than half there is no telling."""

NOISE_DOF = 5.0
"""How many observations the guess of the noise is worth."""

LEAST_SHARE = 0.2
"""At least this share of the observations counts for the noise, whatever the unknowns took."""

NEAR_SD = np.radians(30.0)
"""Standard deviation of the rotation where the pose is nearly known."""

FREE_SD = 10.0
"""Of a free pose: rotation in radians, translation in sizes of the shape: no constraint."""

SCALE_SD = 0.2
"""Of the logarithm of the scale."""

LONGEST_TURN = 0.3
"""Radians in one step, which keeps the linearisation honest."""

SETTLED = 0.01
"""Largest move of a point, in edges of the model, at which the shape has settled."""


@dataclass(frozen=True, slots=True)
class Rules:
    """What one run of the solver does.

    Attributes
    ----------
    use_field : bool
        Whether the leftover field is unknown; otherwise it counts as noise.
    gated : bool
        As in `observations`.
    stride : int
        Takes every so manieth point of the model.
    most_iterations : int
    """

    use_field: bool
    gated: bool
    stride: int
    most_iterations: int


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Where a fit is: the pose, and the coefficients of modes and field."""

    pose: Pose
    coefficients: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Where a run of the solver ended.

    Attributes
    ----------
    state : State
    noise : (5,) float64, mm
        Scale of every kind of data.
    shares : (5,) float64
        Of every kind of data, the share that is of the shape and no outlier.
    has_settled : bool
    iterations : int
    """

    state: State
    noise: FloatArray
    shares: FloatArray
    has_settled: bool
    iterations: int


@dataclass(frozen=True, slots=True, eq=False)
class LinearSystem:
    """The linear problem at one state.

    Attributes
    ----------
    rows : (n, C + D) float64
        Of the coefficients, then of the pose.
    rest : (n,) float64, mm
    squared : (m,) float64, mm^2
        Of every observation.
    """

    rows: FloatArray
    rest: FloatArray
    squared: FloatArray


def placed_points(prior: FitPrior, state: State) -> FloatArray:
    """Return the points (Q, 3) of a state in the target's frame."""
    n_modes = prior.modes.shape[2]
    coefficients = state.coefficients
    shape = prior.mean + prior.modes @ coefficients[:n_modes]
    if len(coefficients) > n_modes:
        shape = shape + prior.field @ coefficients[n_modes:].reshape(-1, 3)
    return placed(state.pose, shape)


def pose_size(settings: FitSettings) -> int:
    """Return the number of unknowns of the pose."""
    if settings.pose == "known":
        return 0
    return 7 if settings.scaling == "similarity" else 6


def pose_rows(
    points: FloatArray, directions: FloatArray, centre: FloatArray, count: int
) -> FloatArray:
    """Return how far points (n, 3) move along directions per turn, shift and growth."""
    arm = points - centre
    columns = [np.cross(arm, directions), directions]
    if count == 7:
        columns.append(np.einsum("ni,ni->n", arm, directions)[:, None])
    rows: FloatArray = np.concatenate(columns, axis=1)[:, :count]
    return rows


def linear_system(
    prior: FitPrior,
    state: State,
    points: FloatArray,
    seen: Observations,
    use_field: bool,
    n_pose: int,
) -> LinearSystem:
    """Return the linear problem of some observations of placed points (Q, 3)."""
    pose = state.pose
    turned = np.ascontiguousarray(pose.scale * (seen.directions @ pose.rotation))
    field = prior.field if use_field else prior.field[:, :0]
    shape_rows = design_rows(
        prior.modes, np.ascontiguousarray(field), seen.corners, seen.barycentric, turned
    )
    at = np.einsum("nk,nki->ni", seen.barycentric, points[seen.corners])
    rest = np.einsum("ni,ni->n", seen.directions, seen.goals - at)
    rows = shape_rows
    if n_pose:
        centre = points.mean(axis=0)
        rows = np.concatenate([shape_rows, pose_rows(at, seen.directions, centre, n_pose)], axis=1)
    squared: FloatArray = np.bincount(seen.owner, rest**2, minlength=len(seen.weight)).astype(
        np.float64
    )
    return LinearSystem(rows, rest, squared)


def prior_information(
    prior: FitPrior, state: State, n_shape: int, settings: FitSettings
) -> tuple[FloatArray, FloatArray]:
    """Return the precisions of all unknowns and the pull towards the prior's mean."""
    n_pose = pose_size(settings)
    precision = np.ones(n_shape + n_pose)
    pull = np.zeros(n_shape + n_pose)
    pull[:n_shape] = -state.coefficients[:n_shape]
    if n_pose:
        is_near = settings.pose == "near"
        precision[n_shape : n_shape + 3] = 1.0 / (NEAR_SD if is_near else FREE_SD) ** 2
        precision[n_shape + 3 : n_shape + 6] = 1.0 / (FREE_SD * prior.size) ** 2
        if is_near:
            turn = Rotation.from_matrix(state.pose.rotation).as_rotvec()
            pull[n_shape : n_shape + 3] = -turn / NEAR_SD**2
        if n_pose == 7:
            precision[-1] = 1.0 / SCALE_SD**2
            pull[-1] = -np.log(state.pose.scale) / SCALE_SD**2
    return precision, pull


def moved(state: State, step: FloatArray, centre: FloatArray, n_shape: int) -> State:
    """Return the state after a step of coefficients and pose."""
    coefficients = state.coefficients.copy()
    coefficients[:n_shape] += step[:n_shape]
    pose = state.pose
    change = step[n_shape:]
    if len(change):
        turn = change[:3]
        angle = float(np.linalg.norm(turn))
        if angle > LONGEST_TURN:
            turn = turn * (LONGEST_TURN / angle)
        growth = float(np.exp(np.clip(change[6], -0.3, 0.3))) if len(change) == 7 else 1.0
        spin = Rotation.from_rotvec(turn).as_matrix()
        pose = Pose(
            pose.scale * growth,
            _orthonormal(spin @ pose.rotation),
            growth * spin @ (pose.translation - centre) + centre + change[3:6],
        )
    return State(pose, coefficients)


def solve(
    prior: FitPrior, data: Data, start: State, settings: FitSettings, rules: Rules
) -> Solution:
    """Run the iteration from a start."""
    n_modes = prior.modes.shape[2]
    n_shape = n_modes + (3 * prior.field.shape[1] if rules.use_field else 0)
    n_pose = pose_size(settings)
    coefficients = np.zeros(n_shape)
    shared = min(n_shape, len(start.coefficients))
    coefficients[:shared] = start.coefficients[:shared]
    state = State(start.pose, coefficients)
    points = placed_points(prior, state)
    noise: FloatArray | None = None
    shares = np.ones(len(KINDS))
    for iteration in range(1, rules.most_iterations + 1):
        model = model_surface(prior, data, points)
        seen = observations(prior, data, model, rules.gated, rules.stride)
        system = linear_system(prior, state, points, seen, rules.use_field, n_pose)
        discount = 1.0 if rules.use_field else independent_share(prior, seen)
        if noise is None:
            noise = starting_noise(prior, seen, system, settings, rules.use_field)
        belongs = inlier_probabilities(prior, seen, system, noise, shares)
        shares = inlier_shares(seen, belongs)
        weights = discount * belongs * student_weights(seen, system, noise)
        precision, pull = prior_information(prior, state, n_shape, settings)
        information = np.diag(precision)
        parts: list[tuple[int, FloatArray]] = []
        for kind in np.unique(seen.kind):
            of_kind = seen.kind[seen.owner] == kind
            root = np.sqrt(weights[seen.owner[of_kind]])[:, None] / noise[kind]
            scaled = system.rows[of_kind] * root
            part = scaled.T @ scaled
            parts.append((int(kind), part))
            information = information + part
            pull = pull + scaled.T @ (root[:, 0] * system.rest[of_kind])
        factor = cho_factor(information, lower=True)
        step = cho_solve(factor, pull)
        covariance = cho_solve(factor, np.eye(len(step)))
        state = moved(state, step, points.mean(axis=0), n_shape)
        following = placed_points(prior, state)
        change = float(np.sqrt(((following - points) ** 2).sum(axis=1).max()))
        points = following
        left = system.rest - system.rows @ step
        squared = np.bincount(seen.owner, left**2, minlength=len(seen.weight))
        evidence = [
            _evidence(
                seen.kind == kind,
                discount * belongs * seen.weight * seen.size,
                weights * squared,
                taken,
            )
            for kind, taken in ((k, float((covariance * part).sum())) for k, part in parts)
        ]
        for (kind, _), found in zip(parts, evidence, strict=True):
            noise[kind] = updated_noise(prior, settings, found, rules.use_field)
        if change < SETTLED * prior.edge:
            return Solution(state, noise, shares, True, iteration)
    if noise is None:
        noise = np.full(len(KINDS), prior.edge)
    return Solution(state, noise, shares, False, rules.most_iterations)


def student_weights(seen: Observations, system: LinearSystem, noise: FloatArray) -> FloatArray:
    """Return the weight (m,) of every observation."""
    scaled = system.squared / noise[seen.kind] ** 2
    weights: FloatArray = seen.weight * (STUDENT_DOF + seen.size) / (STUDENT_DOF + scaled)
    return weights


def inlier_probabilities(
    prior: FitPrior,
    seen: Observations,
    system: LinearSystem,
    noise: FloatArray,
    shares: FloatArray,
) -> FloatArray:
    """Return the probability (m,) that each observation is of the shape.

    Points and contours may be outliers, spread evenly over distances up to a quarter of the
    shape's size; all else is of the shape.
    """
    scale = noise[seen.kind]
    scaled = system.squared / scale**2
    density = STUDENT_PEAK / scale * (1.0 + scaled / STUDENT_DOF) ** (-0.5 * (STUDENT_DOF + 1.0))
    background = 1.0 / (OUTLIER_REACH * prior.size)
    own = np.clip(shares, *SHARE_BOUNDS)[seen.kind]
    probability = own * density / (own * density + (1.0 - own) * background)
    found: FloatArray = np.where(np.isin(seen.kind, (POINTS, CONTOURS)), probability, 1.0)
    return found


def inlier_shares(seen: Observations, belongs: FloatArray) -> FloatArray:
    """Return the share (5,) of every kind of data that is of the shape."""
    total = np.bincount(seen.kind, seen.weight, minlength=len(KINDS))
    inside = np.bincount(seen.kind, seen.weight * belongs, minlength=len(KINDS))
    shares: FloatArray = np.where(total > 0.0, inside / np.maximum(total, 1e-300), 1.0)
    return shares


def independent_share(prior: FitPrior, seen: Observations) -> float:
    """Return the share of the observations that are independent where the field is noise.

    Misfits of neighbours within the field's length are one and the same.
    """
    patches = prior.area / (np.pi * prior.leftover.length**2)
    return float(min(1.0, max(patches, 10.0) / float((seen.weight * seen.size).sum())))


def guessed_noise(prior: FitPrior, settings: FitSettings) -> float:
    """Return what the noise is taken to be before the data say, mm: half an edge of the model."""
    return 0.5 * prior.edge if settings.noise_mm is None else settings.noise_mm


def starting_noise(
    prior: FitPrior,
    seen: Observations,
    system: LinearSystem,
    settings: FitSettings,
    use_field: bool,
) -> FloatArray:
    """Return scales (5,) that take in most of the data where they start."""
    floor = np.hypot(guessed_noise(prior, settings), 0.0 if use_field else prior.deviation)
    noise = np.full(len(KINDS), floor)
    for kind in np.unique(seen.kind):
        root = np.sqrt((system.squared / seen.size)[seen.kind == kind])
        noise[kind] = max(floor, 1.5 * float(np.median(root)))
    return noise


@dataclass(frozen=True, slots=True)
class Evidence:
    """What one kind of data says about its noise.

    Attributes
    ----------
    count : float
        Independent rows.
    taken : float
        Of these, how many the unknowns took.
    energy : float, mm^2
        Weighted sum of the squared misfits.
    """

    count: float
    taken: float
    energy: float


def _evidence(
    chosen: BoolArray, counts: FloatArray, energies: FloatArray, taken: float
) -> Evidence:
    return Evidence(float(counts[chosen].sum()), taken, float(energies[chosen].sum()))


def updated_noise(
    prior: FitPrior, settings: FitSettings, evidence: Evidence, use_field: bool
) -> float:
    """Return the scale of one kind of data for the next iteration, mm."""
    floor = prior.noise_variance if use_field else prior.deviation**2
    if settings.noise_mm is not None:
        return float(np.sqrt(settings.noise_mm**2 + floor))
    left = max(evidence.count - evidence.taken, LEAST_SHARE * evidence.count)
    guess = guessed_noise(prior, settings) ** 2 + prior.noise_variance
    energy = evidence.energy + NOISE_DOF * guess
    return float(np.sqrt(max(energy / (left + NOISE_DOF), floor)))


def _orthonormal(rotation: FloatArray) -> FloatArray:
    u, _, vt = np.linalg.svd(rotation)
    nearest: FloatArray = u @ vt
    return nearest
