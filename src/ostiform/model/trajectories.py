"""Every subject's cycle as a closed curve through shape space: periodic Fourier series.

All subjects are fitted together: ``x_s(t) = u_s + c(t) + d_s(t)`` with a free constant u_s per
subject, a motion c that all share and a departure d_s from it, both Fourier series without
constant. Penalised least squares,

``sum_sf |x_sf - x_s(t_sf)|^2 + n lambda sum_h h^p (|c_h|^2 + kappa sum_s |d_sh|^2)``

with n the mean number of phases, lets subjects with few or uneven phases lean on the motion that
is common. With many harmonics p = 4, which penalises the second derivative, is the periodic cubic
smoothing spline, and p = 2, the first, the polygon through the phases, smoothed (Wahba 1990,
chapter 2).

The number of harmonics, lambda, kappa and p come from leaving one phase out, along every
principal axis of the motion: the first axes hold movement, the last mostly noise. For penalised
least squares the left-out residual has the closed form ``e_i / (1 - H_ii)``, H the matrix from
data to fit. Over a dozen phases the least error is a noisy judge, so candidates are not picked but
mixed, each with the weight ``(mean squared left-out error)^(-N/2)`` of its pseudo-likelihood
(Geisser & Eddy 1979; Yao et al. 2018): one that is clearly worse has none. Before any phase is
seen their odds are as kappa: what the phases cannot tell is held to be common. The errors that are
reported are nested: the weights used for a left-out phase are those that the other phases give.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, TypeAlias

import numpy as np
from scipy.linalg import eigh

from ostiform.arrays import FloatArray, IntArray, frozen_floats
from ostiform.errors import InputError
from ostiform.values import Axes, value

FITTED_EXACTLY = 1e-9
"""Phases with ``1 - H_ii`` below this cannot be predicted from the others."""

NEGLIGIBLE = 1e-6
"""Part of the squared motion added to squared errors: errors below about a thousandth of the
motion tell candidates apart no more."""

_Choice: TypeAlias = tuple[int, float, float, int]
"""Number of harmonics, lambda, kappa and p."""

LEAST_WEIGHT = 1e-4
"""Candidates with less than this weight along every axis are left out of the mixture."""


@dataclass(frozen=True, slots=True)
class TrajectorySettings:
    """What cross-validation weighs against each other.

    Attributes
    ----------
    harmonics : tuple of int
        Candidates of the number of harmonics; it may exceed half of the number of phases, as the
        penalty keeps the fit determined.
    smoothness : tuple of float
        Candidates of lambda, positive.
    stiffness : tuple of float
        Candidates of kappa: how much harder a departure is penalised than the common motion.
    powers : tuple of int
        Candidates of p, positive.
    """

    harmonics: tuple[int, ...] = (0, 1, 2, 3, 4, 6, 10, 16)
    smoothness: tuple[float, ...] = (1.0, 0.2, 6e-2, 2.5e-2, 1e-2, 4e-3, 1e-3, 2e-4, 3e-5, 1e-6)
    stiffness: tuple[float, ...] = (100.0, 10.0, 1.0)
    powers: tuple[int, ...] = (4, 2)

    def __post_init__(self) -> None:
        """Check the values."""
        positive = (*self.smoothness, *self.stiffness, *self.powers)
        if not all(value > 0 for value in positive) or not all(
            count >= 0 for count in self.harmonics
        ):
            raise InputError(
                "settings of the trajectories: expected positive smoothness, stiffness and powers "
                f"and no negative number of harmonics, found {self}"
            )
        if not (self.harmonics and self.smoothness and self.stiffness and self.powers):
            raise InputError(
                "settings of the trajectories: expected at least one candidate of each, "
                f"found {self}"
            )


@value
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
    choices : (R, 4) float64
        Number of harmonics, lambda, kappa and p of the candidate with the largest weight along
        each principal axis of the motion.
    left_out_errors : (N,) float64
        Distance of each phase from the curves fitted, and candidates weighed, without it; NaN
        where a subject's only phase cannot be left out.
    """

    subjects: Annotated[tuple[str, ...], Axes("S")]
    coefficients: Annotated[FloatArray, Axes("S", "C", "R")]
    common: Annotated[FloatArray, Axes("C", "R")]
    choices: Annotated[FloatArray, Axes("R", 4)]
    left_out_errors: Annotated[FloatArray, Axes(..., gaps=True)]

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
    """Fit the closed curves of all subjects together, their order decided by cross-validation.

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
    floor = NEGLIGIBLE * float((_motion(data, rows) ** 2).sum()) + np.finfo(np.float64).tiny
    candidates = _candidates(settings)
    mixture = _LeftOutMixture.empty(data.shape)
    criteria = []
    for candidate in candidates:
        fit = _penalised_fit(turned, moments, rows, candidate)
        squared = np.nansum(fit.left_out**2, axis=0)[None]  # (1, R)
        belief = np.log(candidate[2])
        criteria.append(belief + _log_likelihood(squared, floor, len(data)))
        mixture.add(fit.left_out, belief + _log_likelihood(_nested(fit, rows), floor, len(data)))
    logarithms = np.concatenate(criteria)  # (C, R)
    weights = np.exp(logarithms - logarithms.max(axis=0, initial=-np.inf))
    weights = np.where(weights >= LEAST_WEIGHT, weights, 0.0)
    if all(len(chosen) < 2 for chosen in rows):
        weights[1:] = 0.0  # nothing can be left out: the simplest
    weights = weights / weights.sum(axis=0)
    highest = max(settings.harmonics)
    own = np.zeros((len(names), 2 * highest + 1, data.shape[1]))
    common = np.zeros(own.shape[1:])
    for candidate, weight in zip(candidates, weights, strict=True):
        if weight.any():
            fit = _penalised_fit(turned, moments, rows, candidate)
            own[:, : len(fit.common)] += weight * fit.coefficients
            common[: len(fit.common)] += weight * fit.common
    used = 2 * max((c[0] for c, w in zip(candidates, weights, strict=True) if w.any()), default=0)
    return Trajectories(
        subjects=names,
        coefficients=own[:, : used + 1] @ axes.T,
        common=common[: used + 1] @ axes.T,
        choices=np.array(candidates)[weights.argmax(axis=0)],
        left_out_errors=np.linalg.norm(mixture.mean, axis=1),
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


def _candidates(settings: TrajectorySettings) -> list[_Choice]:
    """Return the candidates, stiffest, then simplest, then smoothest first.

    Without harmonics there is nothing to penalise, so that candidate comes once.
    """
    found = [
        (harmonics, smoothness, stiffness, power)
        for stiffness in sorted(settings.stiffness, reverse=True)
        for harmonics in sorted(set(settings.harmonics))
        for smoothness in sorted(settings.smoothness, reverse=True)
        for power in sorted(settings.powers, reverse=True)
    ]
    still = [choice for choice in found if choice[0] == 0]
    return still[:1] + [choice for choice in found if choice[0] > 0]


def _log_likelihood(squared: FloatArray, floor: float, count: int) -> FloatArray:
    """Return the logarithms of pseudo-likelihoods (n, R) from squared left-out errors (n, R).

    Along a single axis a dozen phases say little, and the axes were found from the same phases:
    the error counts a third along the axis, a third over it and all axes of less motion, and a
    third over all axes together.
    """
    lesser = np.cumsum(squared[:, ::-1], axis=1)[:, ::-1]  # (n, R)
    overall = lesser[:, :1]
    logarithms = [np.log(error + floor) for error in (squared, lesser, overall)]
    found: FloatArray = -count / 6.0 * (logarithms[0] + logarithms[1] + logarithms[2])
    return found


def _nested(fit: "_Fit", rows: Sequence[IntArray]) -> FloatArray:
    """Return for every phase the squared left-out errors (N, R) of the others, found without it.

    With B the rows of ``I - H`` of two phases of a subject, their residuals when both are left
    out are ``B^-1 e``. Phases of other subjects hardly feel the one left out: theirs are those
    with it.
    """
    squared = np.nan_to_num(fit.left_out) ** 2  # (N, R)
    errors = np.tile(squared.sum(axis=0), (len(squared), 1))
    for free, chosen in zip(fit.free, rows, strict=True):
        residual = fit.residuals[chosen]  # (n, R)
        diagonal = np.diag(free)
        determinant = np.outer(diagonal, diagonal) - free**2  # (n, n)
        known = determinant > FITTED_EXACTLY
        np.fill_diagonal(known, False)
        scale = np.where(known, 1.0 / np.where(known, determinant, 1.0), 0.0)
        # [i, j]: residual of j without i and j
        pairs = diagonal[:, None, None] * residual - free[:, :, None] * residual[:, None]
        without = ((scale[:, :, None] * pairs) ** 2).sum(axis=1)  # (n, R)
        errors[chosen] += without - squared[chosen].sum(axis=0)
    nested: FloatArray = np.maximum(errors, 0.0)
    return nested


@dataclass(slots=True, eq=False)
class _LeftOutMixture:
    """Left-out residuals of candidates, averaged with weights that come one by one."""

    largest: FloatArray  # (N, R) logarithm of the largest weight so far
    total: FloatArray  # (N, R) sum of the weights over the largest
    summed: FloatArray  # (N, R)

    @staticmethod
    def empty(shape: tuple[int, ...]) -> "_LeftOutMixture":
        return _LeftOutMixture(np.full(shape, -np.inf), np.zeros(shape), np.zeros(shape))

    def add(self, residuals: FloatArray, logarithms: FloatArray) -> None:
        largest = np.maximum(self.largest, logarithms)
        shrunk, weight = np.exp(self.largest - largest), np.exp(logarithms - largest)
        self.total = self.total * shrunk + weight
        self.summed = self.summed * shrunk + weight * residuals
        self.largest = largest

    @property
    def mean(self) -> FloatArray:
        mean: FloatArray = self.summed / self.total
        return mean


def _motion_axes(data: FloatArray, rows: Sequence[IntArray]) -> FloatArray:
    """Return the principal axes (R, R), as columns, of the phases about their subject's mean."""
    motion = _motion(data, rows)
    _, axes = eigh(motion.T @ motion)
    turned: FloatArray = np.ascontiguousarray(axes[:, ::-1])
    return turned


def _motion(data: FloatArray, rows: Sequence[IntArray]) -> FloatArray:
    motion: FloatArray = np.concatenate(
        [data[chosen] - data[chosen].mean(axis=0) for chosen in rows]
    )
    return motion


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    common: FloatArray  # (2H + 1, R)
    coefficients: FloatArray  # (S, 2H + 1, R)
    left_out: FloatArray  # (N, R), NaN where a phase cannot be left out
    residuals: FloatArray  # (N, R)
    free: list[FloatArray]  # (n, n) rows of I - H of every subject


def _penalised_fit(
    data: FloatArray,
    times: FloatArray,
    rows: Sequence[IntArray],
    choice: _Choice,
) -> _Fit:
    """Solve the penalised least squares: subjects are eliminated, the common motion is left.

    With A the design of one subject, its penalty D and ``M = I - A (A^T A + D)^-1 A^T`` what it
    cannot fit by itself, the common motion solves ``(sum F^T M F + C) c = sum F^T M x``.
    """
    harmonics, smoothness, stiffness, power = choice
    orders = np.repeat(np.arange(1, harmonics + 1), 2).astype(np.float64)  # (2H,)
    common_penalty = len(data) / len(rows) * smoothness * orders**power
    own_penalty = np.concatenate([[0.0], stiffness * common_penalty])
    designs = [fourier_design(times[chosen], harmonics) for chosen in rows]
    solutions = [np.linalg.solve(a.T @ a + np.diag(own_penalty), a.T) for a in designs]
    makers = [np.eye(len(a)) - a @ solved for a, solved in zip(designs, solutions, strict=True)]
    normal = np.diag(common_penalty)
    right = np.zeros((len(orders), data.shape[1]))
    for a, maker, chosen in zip(designs, makers, rows, strict=True):
        left = a[:, 1:].T @ maker  # (2H, n)
        normal = normal + left @ a[:, 1:]
        right = right + left @ data[chosen]
    inverse = np.linalg.inv(normal)
    common = np.concatenate([np.zeros((1, data.shape[1])), inverse @ right])
    coefficients, blocks = [], []
    left_out, residuals = np.full(data.shape, np.nan), np.empty(data.shape)
    for a, solved, maker, chosen in zip(designs, solutions, makers, rows, strict=True):
        curve = common + solved @ (data[chosen] - a @ common)  # (2H + 1, R)
        coefficients.append(curve)
        through_common = maker @ a[:, 1:]  # (n, 2H)
        free = maker - through_common @ inverse @ through_common.T  # (n, n)
        blocks.append(free)
        residuals[chosen] = data[chosen] - a @ curve
        alone = np.diag(free)
        known = alone > FITTED_EXACTLY  # 1 - H_ii
        left_out[chosen[known]] = residuals[chosen[known]] / alone[known, None]
    return _Fit(common, np.stack(coefficients), left_out, residuals, blocks)
