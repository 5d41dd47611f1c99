"""The linear problem of one iteration: modes, field and pose, and a step along them."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ostiform.arrays import FloatArray
from ostiform.fitting.kernels import design_rows
from ostiform.fitting.observations import Observations
from ostiform.fitting.prior import FitPrior
from ostiform.fitting.settings import FitSettings
from ostiform.fitting.types import Pose, placed

NEAR_SD = np.radians(30.0)
"""Standard deviation of the rotation where the pose is nearly known."""

FREE_SD = 10.0
"""Of a free pose: rotation in radians, translation in sizes of the shape: no constraint."""

SCALE_SD = 0.2
"""Of the logarithm of the scale."""

LONGEST_TURN = 0.3
"""Radians in one step, which keeps the linearisation honest."""


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Where a fit is: the pose, and the coefficients of modes and field."""

    pose: Pose
    coefficients: FloatArray


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
    centre: FloatArray | None = None,
) -> LinearSystem:
    """Return the linear problem of some observations of placed points (Q, 3).

    The pose turns and grows about a centre (3,), that of the points unless given.
    """
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
        middle = points.mean(axis=0) if centre is None else centre
        rows = np.concatenate([shape_rows, pose_rows(at, seen.directions, middle, n_pose)], axis=1)
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


def _orthonormal(rotation: FloatArray) -> FloatArray:
    u, _, vt = np.linalg.svd(rotation)
    nearest: FloatArray = u @ vt
    return nearest
