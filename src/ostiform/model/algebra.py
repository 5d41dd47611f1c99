"""The algebra of area-weighted Gaussian models of shapes, on arrays alone (HY 2.3)."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cho_factor, cho_solve, eigh, svd
from scipy.special import ndtr, ndtri

from ostiform.arrays import FloatArray, IntArray, frozen_floats, frozen_ints
from ostiform.errors import InputError

WEIGHT_SUM_TOLERANCE = 1e-9
"""Of a sum of shares that is 1: rounding, weights that were written in double precision."""


def check_weights(weights: FloatArray) -> None:
    """Raise `InputError` unless point weights are positive and sum to one."""
    total = float(weights.sum())
    if (weights <= 0.0).any():
        worst = int(np.argmin(weights))
        raise InputError(
            f"point weights: expected positive area shares, found {weights[worst]:.3g} "
            f"at point {worst}"
        )
    if abs(total - 1.0) > WEIGHT_SUM_TOLERANCE:
        raise InputError(f"point weights: expected a sum of 1, found {total:.12g}")


def principal_modes(
    deviations: FloatArray, weights: FloatArray, shape_length: float
) -> tuple[FloatArray, FloatArray]:
    """Return the modes and variances of the covariance ``sum_r d_r d_r^T``.

    Parameters
    ----------
    deviations : (R, P, 3) float64, mm
        Deviations from the mean, scaled so that the covariance is the plain sum over them.
    weights : (P,) float64
        Positive, sum 1.
    shape_length : float, mm
        Size of the shapes: directions whose standard deviation is below its rounding are dropped.

    Returns
    -------
    modes : (K, P, 3) float64
        Orthonormal under the weights; the sign is chosen so that the component of largest
        magnitude is positive.
    variances : (K,) float64, mm^2 per point
        Largest first.
    """
    given = frozen_floats(weights, (deviations.shape[1],), "weights")
    check_weights(given)
    roots = np.sqrt(given)[:, None]  # (P, 1)
    scaled = (deviations * roots).reshape(len(deviations), -1)  # (R, 3P)
    if not len(scaled):
        return np.empty((0, *deviations.shape[1:])), np.empty(0)
    _, singular, right = svd(scaled, full_matrices=False)
    rounding = max(scaled.shape) * np.finfo(np.float64).eps * max(singular[0], shape_length)
    kept = singular > rounding
    modes = right[kept].reshape(-1, *deviations.shape[1:]) / roots  # (K, P, 3)
    return signed(modes), singular[kept] ** 2


def signed(modes: FloatArray) -> FloatArray:
    """Return modes (K, P, 3) with the sign that makes their largest component positive."""
    flat = modes.reshape(len(modes), int(np.prod(modes.shape[1:])))
    largest = np.take_along_axis(flat, np.abs(flat).argmax(axis=1, keepdims=True), axis=1)
    signed: FloatArray = modes * np.sign(largest)[:, :, None]
    return signed


def weighted_size(shape: FloatArray, weights: FloatArray) -> float:
    """Return the weighted RMS distance of the points (P, 3) of a shape from their centroid, mm."""
    offsets = shape - weights @ shape  # (P, 3)
    return float(np.sqrt(weights @ (offsets**2).sum(axis=1)))


def normal_scores(
    variances: FloatArray, count: int, rng: np.random.Generator, limit: float = np.inf
) -> FloatArray:
    """Return random scores (count, K), ``b_k ~ N(0, l_k)`` truncated at `limit` sd.

    The truncated normal is drawn by inverting its distribution function.
    """
    below = ndtr(-limit)
    uniform = rng.uniform(size=(count, len(variances)))
    standard = ndtri(below + uniform * (1.0 - 2.0 * below))  # (count, K)
    scores: FloatArray = standard * np.sqrt(variances)
    return scores


def conditioned(
    design: FloatArray, offset: FloatArray, variances: FloatArray, noise: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the distribution of scores, given noisy coordinates that depend on them linearly.

    With ``A = design Lambda^(1/2)`` and R the noise, the scores have the covariance
    ``Lambda^(1/2) (I + A^T R^-1 A)^-1 Lambda^(1/2)``.

    Parameters
    ----------
    design : (K, M) float64
        What one unit of each score adds to the coordinates.
    offset : (M,) float64, mm
        Of the coordinates seen from those of the mean.
    variances : (K,) float64, mm^2
    noise : (M,) float64, mm^2
        Variance of every coordinate seen.

    Returns
    -------
    scores : (K,) float64, mm
        The mean.
    variances : (K,) float64, mm^2
        Along the directions, largest first.
    directions : (K, K) float64
        Orthonormal rows.
    """
    spread = np.sqrt(variances)
    scaled = design * spread[:, None]  # (K, M)
    information = np.eye(len(spread)) + (scaled / noise) @ scaled.T  # (K, K)
    factor = cho_factor(information, lower=True)
    scores = spread * cho_solve(factor, scaled @ (offset / noise))
    covariance = spread[:, None] * cho_solve(factor, np.diag(spread))
    found, vectors = eigh(0.5 * (covariance + covariance.T))
    order = np.argsort(found)[::-1]
    return scores, np.maximum(found[order], 0.0), vectors[:, order].T


def checked_scores(scores: ArrayLike, n_modes: int) -> FloatArray:
    """Return scores (..., M) of at most so many modes.

    Raises
    ------
    InputError
        If there are more.
    """
    given = np.asarray(scores, dtype=np.float64)
    if given.shape[-1] > n_modes:
        raise InputError(
            f"scores of a shape: expected at most {n_modes}, one per mode, found {given.shape[-1]}"
        )
    return given


def checked_points(points: IntArray, count: int) -> IntArray:
    """Return distinct indices (Q,) of some of a model's points.

    Raises
    ------
    InputError
        If none is given, or one is unknown or given twice.
    """
    chosen = frozen_ints(points, (None,), "points of a model")
    if not len(chosen) or chosen.min() < 0 or chosen.max() >= count:
        raise InputError(
            f"points of a model: expected indices from 0 to {count - 1}, found "
            + (f"{chosen.min()} to {chosen.max()}" if len(chosen) else "none")
        )
    if len(np.unique(chosen)) < len(chosen):
        values, counts = np.unique(chosen, return_counts=True)
        raise InputError(
            f"points of a model: expected distinct indices, found {values[counts > 1][0]} twice"
        )
    return chosen
