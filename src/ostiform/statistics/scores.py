"""Is there any effect? One permutation test of a whole shape, in the space of its modes.

The statistic is the trace of Lawley and Hotelling, ``T^2 = d tr(H E^-1)``, H and E the matrices
of sums of squares and products of the effect and of the noise, d the degrees of freedom of the
noise. For two groups it is Hotelling's T^2 (1931). Its distribution under no effect is that of the
data with the noise permuted over the subjects, after Freedman and Lane (1983): what is adjusted
for is fitted first, its residuals are permuted, and the fit is added back. With nothing adjusted
for this is the ordinary permutation test, which is exact.
"""

from typing import Annotated

import numpy as np

from ostiform.arrays import FloatArray, IntArray, frozen_floats
from ostiform.errors import InputError
from ostiform.statistics.design import Design
from ostiform.values import Axes, value

VARIANCE_SHARE = 0.9
"""Modes are used until they hold this share of the variance between subjects ..."""

DEGREES_PER_MODE = 2
"""... or there would be fewer degrees of freedom than this for each of them."""

EQUAL = 1e-9
"""Statistics that differ by less, relatively, are equal: the same permutation, summed in another
order."""

CHUNK_ENTRIES = 4_000_000
"""Numbers held at a time."""


@value
class ScoreTest:
    """What one test of the whole shape found.

    Attributes
    ----------
    statistic : float
        T^2, of the shrunk covariance.
    p_value : float
        (1 + permutations at least as extreme) / (1 + permutations).
    n_modes : int
        Principal components of the subjects that the test uses.
    variance_share : float
        The share of the variance, after adjustment, that they hold.
    shrinkage : float
        0: the covariance of the noise as it is (Hotelling); 1: Euclidean distance only.
    explained : float
        Share of that variance which the covariate explains (partial R^2).
    null : (B,) float64
        The statistic of every permutation.
    """

    statistic: float
    p_value: float
    n_modes: int
    variance_share: float
    shrinkage: float
    explained: float
    null: Annotated[FloatArray, Axes(None)]


def score_test(
    scores: FloatArray,
    design: Design,
    orders: IntArray,
    n_modes: int | None = None,
    shrinkage: float | None = None,
) -> ScoreTest:
    """Test whether shapes depend on a covariate.

    The modes are the principal components of the residuals of the adjustment. The covariance S of
    the noise is replaced by ``(1 - s) S + s mu I``, mu the mean variance of the modes: with few
    subjects the small variances are estimated too small and would decide alone. Modes and
    shrinkage depend on the residuals but not on their order, so permuting stays fair.

    Parameters
    ----------
    scores : (S, K) float64, mm
        Positions in a space where Euclidean distance is the distance of shapes.
    design : Design
    orders : (B, S) int64
        Permutations of the subjects.
    n_modes : int, optional
        By default as many as hold 90 % of the variance, but at most half the degrees of freedom
        of the noise and at least one.
    shrinkage : float, optional
        From 0 to 1; by default chosen after Ledoit and Wolf (2004).

    Raises
    ------
    InputError
        If the shapes of the subjects do not differ, the number of modes or the shrinkage is out
        of range, or the arrays do not fit each other.
    """
    count = len(design.nuisance)
    values = frozen_floats(scores, (count, None), "scores of the subjects")
    nuisance, interest = design.bases()
    residuals = values - nuisance @ (nuisance.T @ values)
    left, singular, _ = np.linalg.svd(residuals, full_matrices=False)
    rank = min(count - nuisance.shape[1], int((singular > 1e-9 * max(singular[0], 1e-300)).sum()))
    if rank == 0 or singular[0] <= 0.0:
        raise InputError("shapes of the subjects: expected them to differ, found all equal")
    held = np.cumsum(singular[:rank] ** 2) / (singular[:rank] ** 2).sum()
    used = _mode_count(held, design.degrees) if n_modes is None else n_modes
    if not 1 <= used <= min(rank, design.degrees):
        raise InputError(
            f"modes of a test: expected from 1 to {min(rank, design.degrees)} with {count} "
            f"subjects, found {used}"
        )
    components = left[:, :used] * singular[:used]  # (S, m), mm
    intensity = shrinkage_intensity(components) if shrinkage is None else shrinkage
    if not 0.0 <= intensity <= 1.0:
        raise InputError(f"shrinkage: expected a number from 0 to 1, found {intensity}")
    observed = _statistics(components, nuisance, interest, intensity, np.arange(count)[None])[0]
    size = max(1, CHUNK_ENTRIES // (count * used + 4 * used**2))
    null = np.concatenate(
        [
            _statistics(components, nuisance, interest, intensity, orders[start : start + size])
            for start in range(0, len(orders), size)
        ]
    )
    effect = interest.T @ residuals
    return ScoreTest(
        statistic=float(observed),
        p_value=float(permutation_p_value(np.array([observed]), null[:, None])[0]),
        n_modes=used,
        variance_share=float(held[used - 1]),
        shrinkage=float(intensity),
        explained=float((effect**2).sum() / (residuals**2).sum()),
        null=null,
    )


def permutation_p_value(observed: FloatArray, null: FloatArray) -> FloatArray:
    """Return (1 + #{null >= observed}) / (1 + B) for statistics (n,) and their null (B, n).

    The data as observed count as one of the permutations, so no p-value is zero (Phipson and
    Smyth 2010).
    """
    at_least = (null >= observed * (1.0 - EQUAL)).sum(axis=0)
    values: FloatArray = (1.0 + at_least) / (1.0 + len(null))
    return values


def shrinkage_intensity(observations: FloatArray) -> float:
    """Return how far to shrink a covariance towards a multiple of the identity.

    The intensity of Ledoit and Wolf (2004): the estimated error of the covariance over its
    estimated distance from ``mu I``, mu its mean variance; at most 1.

    Parameters
    ----------
    observations : (n, m) float64
        n observations of m variables of mean zero.
    """
    count, width = observations.shape
    covariance = observations.T @ observations / count
    identity = np.eye(width)
    distance = float(((covariance - np.trace(covariance) / width * identity) ** 2).sum())
    fourth = float(((observations**2).sum(axis=1) ** 2).mean())
    error = (fourth - float((covariance**2).sum())) / count
    return min(1.0, error / distance) if distance > 0.0 else 0.0


def _mode_count(held: FloatArray, degrees: int) -> int:
    enough = int(np.searchsorted(held, VARIANCE_SHARE - 1e-12)) + 1
    return max(1, min(enough, len(held), degrees // DEGREES_PER_MODE))


def _statistics(
    components: FloatArray,
    nuisance: FloatArray,
    interest: FloatArray,
    shrinkage: float,
    orders: IntArray,
) -> FloatArray:
    """Return T^2 (B,) of the residuals of the adjustment, taken in other orders."""
    permuted = components[orders]  # (B, S, m)
    effect = np.matmul(interest.T, permuted)  # (B, q, m)
    fitted = np.matmul(nuisance.T, permuted)  # (B, r, m)
    total = components.T @ components  # of any order
    explained = np.matmul(effect.transpose(0, 2, 1), effect)
    noise = total - np.matmul(fitted.transpose(0, 2, 1), fitted) - explained  # (B, m, m)
    mean_variance = np.trace(noise, axis1=1, axis2=2) / components.shape[1]
    ridge = shrinkage * mean_variance[:, None, None] * np.eye(components.shape[1])
    degrees = len(components) - nuisance.shape[1] - interest.shape[1]
    solved = np.linalg.solve((1.0 - shrinkage) * noise + ridge, explained)
    statistics: FloatArray = degrees * np.trace(solved, axis1=1, axis2=2)
    return statistics
