"""The posterior distribution at the end of a fit (Laplace approximation), and what it says."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve, eigh

from ostiform.arrays import FloatArray
from ostiform.fitting.data import Data
from ostiform.fitting.kernels import design_rows, point_covariances
from ostiform.fitting.linear import (
    linear_system,
    placed_points,
    pose_rows,
    pose_size,
    prior_information,
)
from ostiform.fitting.noise import STUDENT_DOF, inlier_probabilities, student_weights
from ostiform.fitting.observations import model_surface, observations
from ostiform.fitting.prior import FitPrior
from ostiform.fitting.settings import FitSettings
from ostiform.fitting.solver import Solution
from ostiform.fitting.types import ShapeFit
from ostiform.fitting.typical import FieldEnergy, field_energy, field_scale

KEPT_VARIANCE = 0.99
"""Share of a shape's uncertainty that its leading directions hold."""

MOST_DIRECTIONS = 120

FISHER = (STUDENT_DOF + 1.0) / (STUDENT_DOF + 3.0)
"""Information of a Student-t observation over that of its weighted square (Lange et al. 1989)."""


@dataclass(frozen=True, slots=True, eq=False)
class Posterior:
    """Gaussian posterior of all unknowns and what follows from it.

    Attributes
    ----------
    covariance : (C + D, C + D) float64
        Of coefficients and pose, the field's variance being this shape's own.
    prior_covariance : (C, C) float64
        Of the coefficients, under the prior's field variance.
    energy : FieldEnergy
    point_covariance : (P, 3, 3) float64, mm^2
    scores : (K,) float64, mm
    score_covariance : (K, K) float64, mm^2
    pose_sd : (3,) float64
        Rotation in degrees, translation in mm, scale.
    outlier_share : float
    """

    covariance: FloatArray
    prior_covariance: FloatArray
    energy: FieldEnergy
    point_covariance: FloatArray
    scores: FloatArray
    score_covariance: FloatArray
    pose_sd: FloatArray
    outlier_share: float


def posterior_of(
    prior: FitPrior, data: Data, solution: Solution, settings: FitSettings
) -> Posterior:
    """Return the posterior distribution at a solution with the leftover field."""
    state = solution.state
    n_pose, n_shape = pose_size(settings), len(state.coefficients)
    points = placed_points(prior, state)
    seen = observations(prior, data, model_surface(prior, data, points), gated=True)
    system = linear_system(prior, state, points, seen, True, n_pose)
    belongs = inlier_probabilities(prior, seen, system, solution.noise, solution.shares)
    weights = belongs * student_weights(seen, system, solution.noise)
    per_row = FISHER * weights[seen.owner] / solution.noise[seen.kind[seen.owner]] ** 2
    scaled = system.rows * np.sqrt(per_row)[:, None]
    precision, _ = prior_information(prior, state, n_shape, settings)
    information = scaled.T @ scaled
    scores, to_scores = _scores(prior, state.coefficients)
    plain = _inverse(information + np.diag(precision))
    energy = field_energy(prior, state.coefficients, plain[:n_shape, :n_shape], to_scores)
    precision[prior.modes.shape[2] : n_shape] /= field_scale(prior, energy)
    covariance = _inverse(information + np.diag(precision))
    far = system.squared > 9.0 * seen.size * solution.noise[seen.kind] ** 2
    shape_covariance = covariance[:n_shape, :n_shape]
    deviations = np.sqrt(np.diag(covariance)[n_shape:])
    pose_sd = np.zeros(3)
    if n_pose:
        pose_sd[0] = np.degrees(np.sqrt((deviations[:3] ** 2).mean()))
        pose_sd[1] = np.sqrt((deviations[3:6] ** 2).mean())
        pose_sd[2] = state.pose.scale * deviations[6] if n_pose == 7 else 0.0
    return Posterior(
        covariance=covariance,
        prior_covariance=plain[:n_shape, :n_shape],
        energy=energy,
        point_covariance=_point_covariance(prior, solution, points, covariance, n_pose),
        scores=scores,
        score_covariance=to_scores @ shape_covariance @ to_scores.T,
        pose_sd=pose_sd,
        outlier_share=float((seen.weight * far).sum() / seen.weight.sum()),
    )


def shape_deviations(prior: FitPrior, fit: ShapeFit, most: int = MOST_DIRECTIONS) -> FloatArray:
    """Return the leading directions in which a fitted shape is uncertain, in the target's frame.

    Parameters
    ----------
    prior : FitPrior
        That the fit was made with.
    fit : ShapeFit
    most : int
        Directions at most.

    Returns
    -------
    rows : (Q, P, 3) float64, mm
        Their outer products sum to the covariance of the points, without the pose's, but for one
        per cent of it or what so many directions leave.
    """
    count, n_modes = len(prior.model.mean), prior.modes.shape[2]
    values, vectors = eigh(fit.coefficient_covariance)
    coefficients = (vectors * np.sqrt(np.maximum(values, 0.0))).T  # (C, C)
    rows = np.tensordot(coefficients[:, :n_modes], prior.modes[:count], axes=(1, 2))  # (C, P, 3)
    of_field = coefficients[:, n_modes:].reshape(len(rows), -1, 3)  # (C, M, 3)
    rows = rows + np.einsum("pm,cmd->cpd", prior.field[:count], of_field, optimize=True)
    scaled = rows * np.sqrt(prior.model.weights)[:, None]
    flat = scaled.reshape(len(rows), -1)
    variances, turns = eigh(flat @ flat.T)
    order = np.argsort(variances)[::-1]
    held = np.cumsum(np.maximum(variances[order], 0.0))
    kept = min(int(np.searchsorted(held, KEPT_VARIANCE * held[-1])) + 1, most)
    leading: FloatArray = np.tensordot(turns[:, order[:kept]].T, rows, axes=1)
    return fit.pose.scale * leading @ fit.pose.rotation.T


def _scores(prior: FitPrior, coefficients: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the scores (K,) in all modes of the model, and the matrix from the coefficients."""
    model = prior.model
    count, n_modes = len(model.mean), prior.modes.shape[2]
    weighted = model.modes * model.weights[:, None]  # (K, P, 3)
    from_modes = weighted.reshape(len(weighted), -1) @ prior.modes[:count].reshape(-1, n_modes)
    from_field = np.einsum("kpd,pm->kmd", weighted, prior.field[:count], optimize=True)
    matrix = np.concatenate([from_modes, from_field.reshape(len(weighted), -1)], axis=1)
    scores: FloatArray = matrix @ coefficients
    return scores, matrix


def _point_covariance(
    prior: FitPrior,
    solution: Solution,
    points: FloatArray,
    covariance: FloatArray,
    n_pose: int,
) -> FloatArray:
    count = len(prior.model.mean)
    pose = solution.state.pose
    axes = np.tile(np.eye(3), (count, 1))
    corners = np.repeat(np.repeat(np.arange(count), 3)[:, None], 3, axis=1)
    barycentric = np.tile([1.0, 0.0, 0.0], (3 * count, 1))
    turned = np.ascontiguousarray(pose.scale * (axes @ pose.rotation))
    rows = design_rows(prior.modes, prior.field, corners, barycentric, turned)
    if n_pose:
        at = np.repeat(points[:count], 3, axis=0)
        rows = np.concatenate([rows, pose_rows(at, axes, points.mean(axis=0), n_pose)], axis=1)
    spread = rows @ covariance
    found: FloatArray = point_covariances(rows, spread)
    noise = pose.scale**2 * prior.noise_variance
    return found + noise * np.eye(3)


def _inverse(information: FloatArray) -> FloatArray:
    inverse = cho_solve(cho_factor(information, lower=True), np.eye(len(information)))
    symmetric: FloatArray = 0.5 * (inverse + inverse.T)
    return symmetric
