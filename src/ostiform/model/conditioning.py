"""Conditioning of a distribution of cycles on some of their phases.

Shapes are flat vectors here, scaled by the roots of the point weights, so that their plain inner
product is the weighted one (D = 3 P numbers).
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from ostiform.arrays import FloatArray
from ostiform.model.trajectories import fourier_design

ROUNDING = 1e-9
"""Relative to the variance of the motion: keeps its covariance at close times regular."""


@dataclass(frozen=True, slots=True, eq=False)
class CyclePrior:
    """Cycles that vary as training subjects do, and a rest (see `ostiform.model.prediction`).

    Attributes
    ----------
    cycles : (S, 2 H + 1, D) float64, mm
        Fourier coefficients of the training subjects.
    energies : (R,) float64, mm^2 per point
        Of the harmonics 0, 1, ... of the rest.
    directions : float
        Number of directions that the rest spreads over.
    """

    cycles: FloatArray
    energies: FloatArray
    directions: float

    def at(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the mean (n, D) at times (n,) and the scaled departures (S, n, D) from it."""
        design = fourier_design(times, (self.cycles.shape[1] - 1) // 2)
        curves = design @ self.cycles
        mean = curves.mean(axis=0)
        return mean, (curves - mean) / np.sqrt(len(curves) - 1.0)

    def motion(self, first: FloatArray, second: FloatArray) -> FloatArray:
        """Return the covariance (n, m) of the rest's motion between times (n,) and (m,)."""
        lags = 2.0 * np.pi * np.subtract.outer(first, second)
        orders = np.arange(1, len(self.energies))
        found: FloatArray = np.cos(lags[..., None] * orders) @ self.energies[1:]
        return found


@dataclass(frozen=True, slots=True, eq=False)
class CyclePosterior:
    """The distribution of a cycle at some times.

    Attributes
    ----------
    mean : (T, D) float64, mm
    shares : (T, S, D) float64, mm
        Rows whose outer products sum to the covariance that the uncertain b cause.
    seen : (T, Q, D) float64, mm
        Rows like `shares` for the uncertainty of the given phases; Q is 0 where they are certain.
    rest_variance : (T,) float64, mm^2 per point
    """

    mean: FloatArray
    shares: FloatArray
    seen: FloatArray
    rest_variance: FloatArray


def cycle_energies(cycles: FloatArray) -> FloatArray:
    """Return the mean squared amplitude (H + 1,) of every harmonic of cycles (S, 2 H + 1, D)."""
    squared = (cycles**2).sum(axis=2).mean(axis=0)  # (2H + 1,)
    return np.concatenate([squared[:1], 0.5 * (squared[1::2] + squared[2::2])])


def cycle_posterior(
    prior: CyclePrior, given: FloatArray, phases: FloatArray, rows: FloatArray, times: FloatArray
) -> CyclePosterior:
    """Return the distribution of a cycle at some times, given its shapes at others.

    With G the departures at the given phases and N the inverse covariance of what else they hold
    (the rest, and their own uncertainty), the b have the precision ``I + G N G^T``. The rest is
    carried by ordinary kriging: its mean over the cycle has a flat prior.

    Parameters
    ----------
    prior : CyclePrior
    given : (J,) float64
    phases : (J, D) float64, mm
    rows : (Q, J, D) float64, mm
        Their outer products sum to the covariance of the given phases.
    times : (T,) float64
    """
    mean, departures = prior.at(given)  # (J, D), (S, J, D)
    target_mean, targets = prior.at(times)  # (T, D), (S, T, D)
    gain = _Gain(_precision(prior, given), rows)
    weighted = gain.applied(departures)  # (S, J, D)
    count = len(departures)
    information = np.eye(count) + _products(weighted, departures)
    factor = cho_factor(information, lower=True)
    carried, rest_variance = _carried(prior, given, times)  # (T, J), (T,)
    residual = phases - mean  # (J, D)
    b = cho_solve(factor, _products(weighted, residual[None])[:, 0])  # (S,)
    rest = residual - np.tensordot(b, departures, axes=1)
    left = targets - carried @ departures  # (S, T, D)
    shares = solve_triangular(factor[0], left.reshape(count, -1), lower=True).reshape(left.shape)
    moved = np.tensordot(cho_solve(factor, _products(weighted, rows)).T, left, axes=1)  # (Q, T, D)
    return CyclePosterior(
        mean=target_mean + np.tensordot(b, targets, axes=1) + carried @ rest,
        shares=np.swapaxes(shares, 0, 1),
        seen=np.swapaxes(moved + carried @ rows, 0, 1),
        rest_variance=rest_variance,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Gain:
    """The inverse of ``inner^-1 x identity + sum of outer products of the rows``."""

    inner: FloatArray  # (J, J)
    rows: FloatArray  # (Q, J, D)

    def applied(self, values: FloatArray) -> FloatArray:
        """Return N applied to values (n, J, D), by the identity of Woodbury."""
        found: FloatArray = self.inner @ values
        if not len(self.rows):
            return found
        solved = self.inner @ self.rows  # (Q, J, D)
        middle = np.eye(len(self.rows)) + _products(solved, self.rows)
        shares = np.linalg.solve(middle, _products(solved, values))  # (Q, n)
        reduced: FloatArray = found - np.tensordot(shares.T, solved, axes=1)
        return reduced


def _products(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the inner products (n, m) of (n, J, D) with (m, J, D)."""
    products: FloatArray = np.tensordot(first, second, axes=([1, 2], [1, 2]))
    return products


def _precision(prior: CyclePrior, given: FloatArray) -> FloatArray:
    covariance = prior.energies[0] + prior.motion(given, given)
    total = float(prior.energies.sum()) + np.finfo(np.float64).tiny
    covariance = covariance + ROUNDING * total * np.eye(len(given))
    precision: FloatArray = prior.directions * np.linalg.inv(covariance)
    return precision


def _carried(
    prior: CyclePrior, given: FloatArray, times: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the weights (T, J) of ordinary kriging, which sum to 1, and its variance (T,)."""
    total = float(prior.energies[1:].sum()) + np.finfo(np.float64).tiny
    inner = prior.motion(given, given) + ROUNDING * total * np.eye(len(given))  # (J, J)
    cross = prior.motion(given, times)  # (J, T)
    solved = np.linalg.solve(inner, cross)  # (J, T)
    ones = np.linalg.solve(inner, np.ones(len(given)))  # (J,)
    missing = (1.0 - solved.sum(axis=0)) / ones.sum()  # (T,)
    weights = (solved + ones[:, None] * missing).T
    variance = total - (cross * solved).sum(axis=0) + missing**2 * ones.sum()
    return weights, np.maximum(variance, 0.0)
