"""How sure the variances of a model are: the jackknife over subjects.

The shapes of a left-out subject are left out of the principal components; the correspondence is
kept as it is.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.errors import InputError
from ostiform.model import FEWEST_SUBJECTS, jackknife_half_width


@dataclass(frozen=True, slots=True)
class GainInterval:
    """The 95 % interval of how much more compact one model is than another.

    Attributes
    ----------
    low, high : float
        Of ``1 - V_model / V_other``, V the total variance.
    subjects : int
    """

    low: float
    high: float
    subjects: int


def gain_interval(
    scores: FloatArray, other: FloatArray, subjects: Sequence[str]
) -> GainInterval | None:
    """Return the jackknife interval of a variance gain; None below three subjects.

    Parameters
    ----------
    scores, other : (N, K) float64, mm
        Scores of the same shapes in the two models, all modes.
    subjects : (N,) sequence of str

    Raises
    ------
    InputError
        If the numbers of shapes differ.
    """
    if len(scores) != len(other):
        raise InputError(
            f"interval of a gain: expected the same shapes in both models, found {len(scores)} "
            f"and {len(other)}"
        )

    def gain(kept: IntArray) -> FloatArray:
        return np.array([1.0 - _total(scores[kept]) / _total(other[kept])])

    half = _half_width(gain, subjects)
    if half is None:
        return None
    value = 1.0 - _total(scores) / _total(other)
    count = len(set(subjects))
    return GainInterval(float(value - half[0]), float(value + half[0]), count)


def cumulative_variance_error(scores: FloatArray, subjects: Sequence[str]) -> FloatArray:
    """Return the half-width (K,) in mm^2 of the 95 % interval of the cumulative variances.

    Zero below three subjects, where no interval can be given.

    Parameters
    ----------
    scores : (N, K) float64, mm
        Of the training shapes, all modes.
    subjects : (N,) sequence of str
    """
    count = scores.shape[1]

    def cumulative(kept: IntArray) -> FloatArray:
        own = scores[kept] - scores[kept].mean(axis=0)
        # The eigenvalues of the products are the squares of the singular values, for a third.
        products = own @ own.T if len(own) < count else own.T @ own
        padded = np.zeros(count)
        padded[: len(products)] = np.linalg.eigvalsh(products)[::-1] / (len(own) - 1.0)
        return np.cumsum(padded)

    half = _half_width(cumulative, subjects)
    return np.zeros(count) if half is None else half


def _half_width(
    statistic: Callable[[IntArray], FloatArray], subjects: Sequence[str]
) -> FloatArray | None:
    names = np.asarray(subjects)
    kept = [np.flatnonzero(names != name) for name in dict.fromkeys(subjects)]
    count = len(kept)
    if count < FEWEST_SUBJECTS or min(map(len, kept)) < 2:
        return None
    return jackknife_half_width(np.array([statistic(rows) for rows in kept]))  # (S, ...)


def _total(scores: FloatArray) -> float:
    return float(((scores - scores.mean(axis=0)) ** 2).sum() / (len(scores) - 1.0))
