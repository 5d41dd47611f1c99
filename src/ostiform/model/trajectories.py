"""Every subject's cycle as a closed curve through shape space: periodic Fourier series.

All subjects are fitted together: ``x_s(t) = u_s + c(t) + d_s(t)`` with a free constant u_s per
subject, a motion c that all share and a departure d_s from it, both Fourier series without
constant. Penalised least squares,

``sum_sf |x_sf - x_s(t_sf)|^2 + n lambda sum_h h^3 (|c_h|^2 + kappa sum_s |d_sh|^2)``

with n the mean number of phases (h^2 would penalise the first derivative, h^4 the second), lets
subjects with few or uneven phases lean on the motion that is common. The number of harmonics,
lambda and kappa are chosen by leaving one phase out, along every principal axis of the motion:
the first axes hold movement, the last mostly noise. For penalised least squares the left-out
residual has the closed form ``e_i / (1 - H_ii)``, H the matrix from data to fit.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh

from ostiform.arrays import FloatArray, IntArray, frozen_floats
from ostiform.errors import InputError

__all__ = [
    "TrajectorySettings",
    "Trajectories",
    "fit_trajectories",
    "fourier_design",
    "interpolation_errors",
]

FITTED_EXACTLY = 1e-9
"""Phases with ``1 - H_ii`` below this cannot be predicted from the others."""

AS_GOOD = 1.01
"""Ratio to the least criterion within which candidates count as equally good."""

NEGLIGIBLE = 1e-4
"""Part of the squared motion added to squared errors: with `AS_GOOD`, errors below about a
thousandth of the motion tie."""


@dataclass(frozen=True, slots=True)
class TrajectorySettings:
    """What cross-validation chooses from.

    Attributes
    ----------
    harmonics : tuple of int
        Candidates of the number of harmonics; it may exceed half of the number of phases, as the
        penalty keeps the fit determined.
    smoothness : tuple of float
        Candidates of lambda, positive.
    stiffness : tuple of float
        Candidates of kappa: how much harder a departure is penalised than the common motion.
    """

    harmonics: tuple[int, ...] = (0, 1, 2, 3, 4, 6, 10)
    smoothness: tuple[float, ...] = (0.1, 3e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 1e-5, 1e-6)
    stiffness: tuple[float, ...] = (100.0, 10.0, 1.0)

    def __post_init__(self) -> None:
        """Check the values."""
        if not all(value > 0 for value in (*self.smoothness, *self.stiffness)) or not all(
            count >= 0 for count in self.harmonics
        ):
            raise InputError(
                "settings of the trajectories: expected positive smoothness and stiffness and no "
                f"negative number of harmonics, found {self}"
            )
        if not (self.harmonics and self.smoothness and self.stiffness):
            raise InputError(
                "settings of the trajectories: expected at least one candidate of each, "
                f"found {self}"
            )


@dataclass(frozen=True, slots=True, eq=False)
class Trajectories:
    """Closed curves through a vector space of R dimensions, one per subject.

    Coefficients are ordered 1, cos(2 pi t), sin(2 pi t), cos(4 pi t), ... (see `fourier_design`).

    Attributes
    ----------
    subjects : tuple of str
    coefficients : (S, 2 H + 1, R) float64
        Of the whole curve of each subject: constant, common motion and departure together.
    common : (2 H + 1, R) float64
        Of the motion that all subjects share; its constant is zero.
    choices : (R, 3) float64
        Number of harmonics, lambda and kappa chosen along each principal axis of the motion.
    left_out_errors : (N,) float64
        Distance of each phase from the curves fitted without it; NaN where a subject's only
        phase cannot be left out.
    """

    subjects: tuple[str, ...]
    coefficients: FloatArray
    common: FloatArray
    choices: FloatArray
    left_out_errors: FloatArray

    def __post_init__(self) -> None:
        """Check the arrays and make them read-only."""
        coefficients = frozen_floats(
            self.coefficients, (len(self.subjects), None, None), "coefficients"
        )
        object.__setattr__(self, "coefficients", coefficients)
        object.__setattr__(
            self, "common", frozen_floats(self.common, coefficients.shape[1:], "common motion")
        )
        object.__setattr__(
            self, "choices", frozen_floats(self.choices, (coefficients.shape[2], 3), "choices")
        )
        errors = np.array(self.left_out_errors, dtype=np.float64)
        errors.flags.writeable = False
        object.__setattr__(self, "left_out_errors", errors)

    @property
    def harmonics(self) -> int:
        """Largest number of harmonics H along any axis."""
        return int(self.coefficients.shape[1] - 1) // 2


def fourier_design(times: FloatArray, harmonics: int) -> FloatArray:
    """Return the functions 1, cos(2 pi t), sin(2 pi t), ... at times (n,), as (n, 2 H + 1)."""
    angles = 2.0 * np.pi * np.outer(times, np.arange(1, harmonics + 1))  # (n, H)
    waves = np.stack([np.cos(angles), np.sin(angles)], axis=2).reshape(len(angles), -1)
    design: FloatArray = np.concatenate([np.ones((len(angles), 1)), waves], axis=1)
    return design


def fit_trajectories(
    values: FloatArray,
    subjects: Sequence[str],
    times: FloatArray,
    settings: TrajectorySettings | None = None,
) -> Trajectories:
    """Fit the closed curves of all subjects together, their order chosen by cross-validation.

    Parameters
    ----------
    values : (N, R) float64
        Positions in a space where Euclidean distance is the distance of shapes (scores).
    subjects : (N,) sequence of str
    times : (N,) float64
        Fractions of the cycle.
    settings : TrajectorySettings, optional

    Raises
    ------
    InputError
        If the arrays do not fit each other.
    """
    settings = TrajectorySettings() if settings is None else settings
    data = frozen_floats(values, (len(subjects), None), "positions of the phases")
    moments = frozen_floats(times, (len(subjects),), "times of the phases")
    names = tuple(dict.fromkeys(subjects))
    rows = [np.flatnonzero(np.asarray(subjects) == name) for name in names]
    axes = _motion_axes(data, rows)  # (R, R)
    turned = data @ axes
    candidates = [
        (harmonics, smoothness, stiffness)
        for stiffness in sorted(settings.stiffness, reverse=True)
        for harmonics in sorted(settings.harmonics)
        for smoothness in sorted(settings.smoothness, reverse=True)
    ]
    fits = [_penalised_fit(turned, moments, rows, candidate) for candidate in candidates]
    errors = np.stack([np.nansum(fit.left_out**2, axis=0) for fit in fits])  # (C, R)
    picked = _picked(errors, float((_motion(data, rows) ** 2).sum()))
    choices = np.array(candidates)[picked]  # (R, 3)
    highest = int(choices[:, 0].max(initial=0.0))
    own = np.zeros((len(names), 2 * highest + 1, data.shape[1]))
    common = np.zeros(own.shape[1:])
    left_out = np.full(data.shape, np.nan)
    for number in np.unique(picked):
        columns, fit = picked == number, fits[number]
        own[:, : len(fit.common), columns] = fit.coefficients[..., columns]
        common[: len(fit.common), columns] = fit.common[:, columns]
        left_out[:, columns] = fit.left_out[:, columns]
    return Trajectories(
        subjects=names,
        coefficients=own @ axes.T,
        common=common @ axes.T,
        choices=choices,
        left_out_errors=np.linalg.norm(left_out, axis=1),
    )


def interpolation_errors(
    values: FloatArray, subjects: Sequence[str], times: FloatArray
) -> FloatArray:
    """Return the distance (N,) of each phase from the straight line between its neighbours.

    The neighbours are those in time on the closed cycle; NaN for subjects with one phase. This is
    the baseline that a trajectory has to beat.
    """
    errors = np.full(len(times), np.nan)
    labels = np.asarray(subjects)
    for name in np.unique(labels):
        chosen = np.flatnonzero(labels == name)
        order = chosen[np.argsort(times[chosen], kind="stable")]
        if len(order) < 2:
            continue
        before, after = np.roll(order, 1), np.roll(order, -1)
        since = (times[order] - times[before]) % 1.0
        until = (times[after] - times[order]) % 1.0
        gap = since + until
        share = np.where(gap > 0.0, since / np.where(gap > 0.0, gap, 1.0), 0.5)
        line = values[before] + share[:, None] * (values[after] - values[before])
        errors[order] = np.linalg.norm(values[order] - line, axis=1)
    return errors


def _picked(errors: FloatArray, motion: float) -> IntArray:
    """Return the candidate (R,) for every axis from the squared left-out errors (C, R).

    Along a single axis, cross-validation over a dozen phases is a noisy judge: the criterion is
    the sum of the error along the axis and the error along all axes, each relative to the least
    one. Candidates come stiffest, then simplest, then smoothest first; the first one that is as
    good as the best one is taken.
    """
    if not errors.size:
        return np.zeros(errors.shape[1], dtype=np.int64)
    floor = NEGLIGIBLE * motion + np.finfo(np.float64).tiny
    overall = errors.sum(axis=1, keepdims=True)  # (C, 1)
    criterion = (errors + floor) / (errors.min(axis=0) + floor)
    criterion = criterion + (overall + floor) / (overall.min() + floor)  # (C, R)
    picked: IntArray = (criterion <= AS_GOOD * criterion.min(axis=0)).argmax(axis=0)
    return picked


def _motion_axes(data: FloatArray, rows: Sequence[IntArray]) -> FloatArray:
    """Return the principal axes (R, R), as columns, of the phases about their subject's mean."""
    motion = _motion(data, rows)
    _, axes = eigh(motion.T @ motion)
    turned: FloatArray = np.ascontiguousarray(axes[:, ::-1])
    return turned


def _motion(data: FloatArray, rows: Sequence[IntArray]) -> FloatArray:
    return np.concatenate([data[chosen] - data[chosen].mean(axis=0) for chosen in rows])


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    common: FloatArray  # (2H + 1, R)
    coefficients: FloatArray  # (S, 2H + 1, R)
    left_out: FloatArray  # (N, R), NaN where a phase cannot be left out


def _penalised_fit(
    data: FloatArray,
    times: FloatArray,
    rows: Sequence[IntArray],
    choice: tuple[int, float, float],
) -> _Fit:
    """Solve the penalised least squares: subjects are eliminated, the common motion is left.

    With A the design of one subject, its penalty D and ``M = I - A (A^T A + D)^-1 A^T`` what it
    cannot fit by itself, the common motion solves ``(sum F^T M F + C) c = sum F^T M x``.
    """
    harmonics, smoothness, stiffness = choice
    powers = np.repeat(np.arange(1, harmonics + 1), 2).astype(np.float64) ** 3  # (2H,)
    common_penalty = len(data) / len(rows) * smoothness * powers
    own_penalty = np.concatenate([[0.0], stiffness * common_penalty])
    designs = [fourier_design(times[chosen], harmonics) for chosen in rows]
    solutions = [np.linalg.solve(a.T @ a + np.diag(own_penalty), a.T) for a in designs]
    makers = [np.eye(len(a)) - a @ solved for a, solved in zip(designs, solutions, strict=True)]
    normal = np.diag(common_penalty)
    right = np.zeros((len(powers), data.shape[1]))
    for a, maker, chosen in zip(designs, makers, rows, strict=True):
        left = a[:, 1:].T @ maker  # (2H, n)
        normal = normal + left @ a[:, 1:]
        right = right + left @ data[chosen]
    inverse = np.linalg.inv(normal)
    common = np.concatenate([np.zeros((1, data.shape[1])), inverse @ right])
    coefficients, left_out = [], np.full(data.shape, np.nan)
    for a, solved, maker, chosen in zip(designs, solutions, makers, rows, strict=True):
        curve = common + solved @ (data[chosen] - a @ common)  # (2H + 1, R)
        coefficients.append(curve)
        through_common = maker @ a[:, 1:]  # (n, 2H)
        free = np.diag(maker) - ((through_common @ inverse) * through_common).sum(axis=1)
        known = free > FITTED_EXACTLY  # 1 - H_ii
        left_out[chosen[known]] = (data[chosen] - a @ curve)[known] / free[known, None]
    return _Fit(common, np.stack(coefficients), left_out)
