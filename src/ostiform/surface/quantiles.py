"""Quantiles of weighted values, such as distances weighted by area."""

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.errors import InputError


def weighted_quantile(values: FloatArray, weights: FloatArray, share: float) -> float:
    """Return the smallest value that at least a share of the weight does not exceed.

    Parameters
    ----------
    values : (n,) float64
    weights : (n,) float64
        Not negative.
    share : float
        Between 0 and 1.

    Raises
    ------
    InputError
        If there are no values, or the weights are not positive in sum.
    """
    if not len(values) or not weights.sum() > 0.0:
        raise InputError(
            f"a weighted quantile: expected values of positive weight, found {len(values)} of "
            f"total weight {weights.sum():g}"
        )
    return float(np.quantile(values, share, weights=weights, method="inverted_cdf"))
