"""The posterior of a cycle (Laplace approximation): its covariance, shapes at any time, draws."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from ostiform.arrays import FloatArray
from ostiform.fitting.kernels import design_rows
from ostiform.fitting.linear import LinearSystem, pose_rows, pose_size
from ostiform.fitting.noise import inlier_probabilities, student_weights
from ostiform.fitting.posterior import FISHER
from ostiform.fitting.sequence_data import SequenceData
from ostiform.fitting.sequence_prior import SequencePrior
from ostiform.fitting.sequence_solver import (
    SequenceSolution,
    SequenceState,
    linearised,
    normal_equations,
    phase_points,
    prior_terms,
    stepped,
    turning_centre,
)
from ostiform.fitting.sequence_types import SequenceFit
from ostiform.fitting.settings import FitSettings
from ostiform.fitting.typical import FieldEnergy
from ostiform.surface import vertex_normals


@dataclass(frozen=True, slots=True, eq=False)
class SequencePosterior:
    """Gaussian posterior of all unknowns.

    Attributes
    ----------
    root : (U, U) float64
        Columns whose outer products sum to the covariance: modes by temporal function, field
        likewise, pose, shifts.
    gain : (K, K) float64
        How much of the variance of the mean shape's modes the data determine.
    energy : FieldEnergy
        Of the field, in units of what the prior expects.
    outlier_share : float
    """

    root: FloatArray
    gain: FloatArray
    energy: FieldEnergy
    outlier_share: float


def sequence_posterior(
    prior: SequencePrior,
    data: SequenceData,
    solution: SequenceSolution,
    settings: FitSettings,
    shift_sd: float,
) -> SequencePosterior:
    """Return the posterior distribution at a solution with the field.

    The variances of modes and field are those that the solution found likely for this cycle; how
    typical it is, is judged by the prior's own.
    """
    space, state = prior.space, solution.state
    n_modes, n_field = state.modes.shape[1], state.field.shape[1]
    at = linearised(prior, data, state, pose_size(settings), gated=True)
    whole = LinearSystem(np.zeros((0, 0)), np.zeros(0), at.squared)
    noise = solution.noise
    belongs = inlier_probabilities(space, at.seen, whole, noise, solution.shares)
    weights = FISHER * belongs * student_weights(at.seen, whole, noise)
    of_data, _ = normal_equations(
        prior, data, at, weights / noise[at.seen.kind] ** 2, (n_modes, n_field)
    )
    of_prior, _ = prior_terms(prior, state, settings, shift_sd)
    plain = _root(of_data + of_prior)
    first, last = state.modes.size, state.modes.size + state.field.size
    variances = np.repeat(prior.field_variances, n_field)
    unseen = (plain[first:last] ** 2).sum(axis=1)
    found = state.field.ravel() ** 2
    total = float(variances.sum())
    energy = FieldEnergy(
        found=float(found.sum()),
        unseen=float(unseen.sum()),
        prior=total,
        dof=total**2 / max(float((variances**2).sum()), 1e-300),
    )
    of_prior, _ = prior_terms(prior, state, settings, shift_sd, solution.scales)
    far = at.squared > 9.0 * at.seen.size * noise[at.seen.kind] ** 2
    own = plain[:n_modes]
    spread = np.linalg.inv(prior.precision)[:n_modes, :n_modes]
    return SequencePosterior(
        root=_root(of_data + of_prior),
        gain=spread - own @ own.T,
        energy=energy,
        outlier_share=float((at.seen.weight * far).sum() / at.seen.weight.sum()),
    )


def deviations_at(
    prior: SequencePrior, state: SequenceState, root: FloatArray, n_pose: int, time: float
) -> tuple[FloatArray, FloatArray]:
    """Return the standard deviations of the points at a time, along normals and per coordinate.

    Parameters
    ----------
    prior : SequencePrior
    state : SequenceState
    root : (U, D) float64
    n_pose : int
    time : float

    Returns
    -------
    normal, overall : (P,) float64, mm
        Of the points in the data's frame, the pose's uncertainty included.
    """
    space = prior.space
    count = len(space.model.mean)
    points = phase_points(prior, state, time)
    faces = space.model.mesh.faces
    normals = vertex_normals(points[:count], faces)
    factors = _phase_root(prior, state, root, n_pose, time)  # (C + D, U)
    covariance = factors @ factors.T
    helper = np.eye(3)[np.abs(normals).argmin(axis=1)]
    across = np.cross(normals, helper)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    variances = []
    for directions in (normals, across, np.cross(normals, across)):
        rows = _rows(prior, state, points, directions, n_pose)
        variances.append(((rows @ covariance) * rows).sum(axis=1) + space.noise_variance)
    return np.sqrt(variances[0]), np.sqrt(np.mean(variances, axis=0))


def drawn_states(
    prior: SequencePrior, state: SequenceState, root: FloatArray, n_pose: int, count: int
) -> tuple[SequenceState, ...]:
    """Return states drawn from the posterior: in pairs about the mean, always the same ones."""
    rng = np.random.default_rng(0)
    centre = turning_centre(prior, state.pose)
    half = rng.normal(size=(count // 2, root.shape[1]))
    steps = np.concatenate([half, -half]) @ root.T
    return tuple(stepped(state, step, centre, n_pose) for step in steps)


def fit_state(prior: SequencePrior, fit: SequenceFit) -> SequenceState:
    """Return the state that a fit ended in; shifts aside."""
    n_modes = prior.mean.shape[1]
    n_slow = len(prior.field_variances)
    return SequenceState(
        fit.pose,
        fit.coefficients[:, :n_modes],
        fit.coefficients[:n_slow, n_modes:],
        np.zeros((len(fit.shifts), 3)),
    )


def _root(information: FloatArray) -> FloatArray:
    """Return the upper triangular root of the inverse: ``inverse = root root^T``."""
    lower = cholesky(information, lower=True)
    inverse: FloatArray = solve_triangular(lower, np.eye(len(lower)), lower=True).T
    return inverse


def _phase_root(
    prior: SequencePrior, state: SequenceState, root: FloatArray, n_pose: int, time: float
) -> FloatArray:
    """Return the root of the covariance of a phase's modes, field and pose (C + D, U)."""
    phi = prior.design(np.array([time]))[0]
    n_modes, n_field = state.modes.size, state.field.size
    modes = root[:n_modes].reshape(*state.modes.shape, -1)
    field = root[n_modes : n_modes + n_field].reshape(*state.field.shape, -1)
    pose = root[n_modes + n_field : n_modes + n_field + n_pose]
    return np.concatenate(
        [
            np.tensordot(phi, modes, axes=1),
            np.tensordot(phi[: len(field)], field, axes=1),
            pose,
        ]
    )


def _rows(
    prior: SequencePrior,
    state: SequenceState,
    points: FloatArray,
    directions: FloatArray,
    n_pose: int,
) -> FloatArray:
    space = prior.space
    count = len(space.model.mean)
    corners = np.repeat(np.arange(count)[:, None], 3, axis=1)
    single = np.tile([1.0, 0.0, 0.0], (count, 1))
    turned = np.ascontiguousarray(state.pose.scale * (directions @ state.pose.rotation))
    field = space.field if state.field.shape[1] else space.field[:, :0]
    rows = design_rows(space.modes, np.ascontiguousarray(field), corners, single, turned)
    if not n_pose:
        return rows
    centre = turning_centre(prior, state.pose)
    return np.concatenate([rows, pose_rows(points[:count], directions, centre, n_pose)], axis=1)
