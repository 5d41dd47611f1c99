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

from ostiform.arrays import FloatArray
from ostiform.fitting.data import KINDS, Data
from ostiform.fitting.linear import (
    State,
    linear_system,
    moved,
    placed_points,
    pose_size,
    prior_information,
)
from ostiform.fitting.noise import (
    evidence_of,
    independent_share,
    inlier_probabilities,
    inlier_shares,
    starting_noise,
    student_weights,
    updated_noise,
)
from ostiform.fitting.observations import model_surface, observations
from ostiform.fitting.prior import FitPrior
from ostiform.fitting.settings import FitSettings

SETTLED = 0.01
"""Largest move of a point, in edges of the model, at which the shape has settled."""


TURNED_BACK = 0.5
"""Share of a step that is taken where it turns back on the last one: pairs that swap to and fro
between two sets would never settle."""


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
    move = np.zeros_like(points)
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
        following_state = moved(state, step, points.mean(axis=0), n_shape)
        following = placed_points(prior, following_state)
        if float(((following - points) * move).sum()) < 0.0:
            step = TURNED_BACK * step
            following_state = moved(state, step, points.mean(axis=0), n_shape)
            following = placed_points(prior, following_state)
        move = following - points
        change = float(np.sqrt((move**2).sum(axis=1).max()))
        state, points = following_state, following
        left = system.rest - system.rows @ step
        squared = np.bincount(seen.owner, left**2, minlength=len(seen.weight))
        evidence = [
            evidence_of(
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
