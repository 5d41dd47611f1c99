"""Many tests at once: which of them to believe."""

import numpy as np

from ostiform.arrays import FloatArray


def adjusted_p_values(p_values: FloatArray) -> FloatArray:
    """Return the q-values (n,) of Benjamini and Hochberg (1995).

    Calling found all tests with ``q <= a`` keeps the expected share of false ones among them at
    or below a, for tests that are independent or positively dependent (as those of neighbouring
    points are). With the p-values in order, ``q_(i) = min over j >= i of n p_(j) / j``.

    Parameters
    ----------
    p_values : (n,) float64
    """
    count = len(p_values)
    order = np.argsort(p_values)[::-1]  # largest first
    ranks = np.arange(count, 0, -1)
    smallest = np.minimum.accumulate(p_values[order] * count / ranks)
    q_values = np.empty(count)
    q_values[order] = np.minimum(smallest, 1.0)
    return q_values
