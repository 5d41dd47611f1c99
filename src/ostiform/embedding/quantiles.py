"""Quantiles of weighted values."""

import numpy as np

from ostiform.arrays import FloatArray

__all__ = ["weighted_quantile"]


def weighted_quantile(values: FloatArray, weights: FloatArray, share: float) -> float:
    """Return the least value that at least a share of the total weight does not exceed.

    Parameters
    ----------
    values : (n,) float64
    weights : (n,) float64
        Not negative, at least one positive.
    share : float
        Between 0 and 1.
    """
    order = np.argsort(values, kind="stable")
    cumulated = np.cumsum(weights[order])
    position = int(np.searchsorted(cumulated, share * cumulated[-1]))
    return float(values[order[min(position, len(values) - 1)]])
