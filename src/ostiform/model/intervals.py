"""95 % intervals over subjects: Student's t of a mean, and of the jackknife."""

import numpy as np
from scipy.special import stdtrit

from ostiform.arrays import FloatArray

CONFIDENCE = 0.95

FEWEST_SUBJECTS = 3
"""With fewer no interval is stated."""


def t_half_width(error: FloatArray, count: int) -> FloatArray:
    """Return the half-width of the interval of a value with a standard error, of `count` units."""
    half: FloatArray = float(stdtrit(count - 1, 0.5 * (1.0 + CONFIDENCE))) * error
    return half


def mean_half_width(values: FloatArray) -> FloatArray | None:
    """Return the half-width of the interval of the mean of values (S, ...); None below three."""
    if len(values) < FEWEST_SUBJECTS:
        return None
    return t_half_width(values.std(axis=0, ddof=1) / np.sqrt(len(values)), len(values))


def jackknife_half_width(values: FloatArray) -> FloatArray:
    """Return the half-width of a statistic's interval, from its values (S, ...) without each."""
    count = len(values)
    squared = ((values - values.mean(axis=0)) ** 2).sum(axis=0)
    return t_half_width(np.sqrt((count - 1.0) / count * squared), count)
