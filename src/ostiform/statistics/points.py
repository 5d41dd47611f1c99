"""Where is the effect? A permutation test at every point of a shape.

At every point the statistic is that of `scores`, of the point's three coordinates (any movement)
or of its movement along the normal only (inwards or outwards). The p-values are those of each
point by itself; because a surface has thousands, they come with two corrections: the q-values of
Benjamini and Hochberg (false discoveries among the points found) and the max-T p-values of
Westfall and Young (any false discovery at all), from the same permutations.
"""

from typing import Annotated

import numpy as np
from scipy.stats import false_discovery_control

from ostiform.arrays import FloatArray, IntArray, frozen_floats
from ostiform.errors import InputError
from ostiform.statistics.design import Design
from ostiform.statistics.scores import EQUAL
from ostiform.values import Axes, value

CHUNK_ENTRIES = 4_000_000
"""Numbers held at a time."""

SMALLEST_SHARE = 1e-12
"""Least determinant of the noise at a point against that of noise equal in all directions: a
point that moves in a plane only has no 3-D covariance to divide by, so this much is added."""


@value
class PointTest:
    """What the tests of the points found; a (P,) array each.

    Attributes
    ----------
    statistic : float64
        T^2 at the point.
    p_value : float64
        Of the point by itself.
    q_value : float64
        Benjamini and Hochberg (1995).
    family_p_value : float64
        Westfall and Young (1993), single-step max-T: the chance that any of the points reaches
        this statistic where there is no effect anywhere.
    """

    statistic: Annotated[FloatArray, Axes("P")]
    p_value: Annotated[FloatArray, Axes("P")]
    q_value: Annotated[FloatArray, Axes("P")]
    family_p_value: Annotated[FloatArray, Axes("P")]


def point_test(values: FloatArray, design: Design, orders: IntArray) -> PointTest:
    """Test every point for an effect.

    Parameters
    ----------
    values : (S, P, d) float64, mm
        What is tested at the points: positions (d = 3), or movements along the normal (d = 1).
    design : Design
    orders : (B, S) int64
        Permutations of the subjects.

    Raises
    ------
    InputError
        If d is neither 1 nor 3, the subjects are too few for it, or the arrays do not fit.
    """
    count = len(design.nuisance)
    data = frozen_floats(values, (count, None, None), "values at the points")
    width = data.shape[2]
    if width not in (1, 3):
        raise InputError(f"values at the points: expected 1 or 3 numbers each, found {width}")
    if design.degrees < width:
        raise InputError(
            f"tests of points: expected at least {count + width - design.degrees} subjects with "
            f"this design, found {count}: add subjects, or test the movement along the normal"
        )
    nuisance, interest = design.bases()
    flat = data.reshape(count, -1)
    residuals = flat - nuisance @ (nuisance.T @ flat)
    rounding = count * np.finfo(np.float64).eps * np.abs(flat).max(initial=0.0)
    residuals[:, np.abs(residuals).max(axis=0) <= rounding] = 0.0  # what does not move
    shaped = residuals.reshape(data.shape)
    total = np.einsum("spi,spj->pij", shaped, shaped)  # (P, d, d), of any order
    mean_square = np.trace(total, axis1=1, axis2=2) / width
    total = total + (SMALLEST_SHARE * mean_square)[:, None, None] * np.eye(width)
    bases = np.concatenate([nuisance, interest], axis=1).T  # (r + q, S)
    observed = _statistics(residuals, bases, interest.shape[1], total)
    reached = np.zeros(len(observed))
    largest = np.empty(len(orders))
    size = max(1, CHUNK_ENTRIES // (flat.shape[1] * (len(bases) + 3 * width)))
    for start in range(0, len(orders), size):
        null = _permuted_statistics(
            residuals, bases, interest.shape[1], total, orders[start : start + size]
        )
        reached += (null >= observed * (1.0 - EQUAL)).sum(axis=0)
        largest[start : start + size] = null.max(axis=1)
    p_value = (1.0 + reached) / (1.0 + len(orders))
    above = (np.sort(largest)[None] >= (observed * (1.0 - EQUAL))[:, None]).sum(axis=1)
    return PointTest(
        statistic=observed,
        p_value=p_value,
        q_value=false_discovery_control(p_value),
        family_p_value=(1.0 + above) / (1.0 + len(orders)),
    )


def _permuted_statistics(
    residuals: FloatArray, bases: FloatArray, n_interest: int, total: FloatArray, orders: IntArray
) -> FloatArray:
    """Return the statistics (B, P) of the residuals taken in other orders.

    ``basis^T residuals[order]`` equals ``basis[inverse order]^T residuals``: one product of
    matrices for all of them.
    """
    inverse = np.argsort(orders, axis=1)  # (B, S)
    turned = bases[:, inverse].transpose(1, 0, 2).reshape(-1, bases.shape[1])  # (B (r + q), S)
    width = total.shape[1]
    sums = (turned @ residuals).reshape(len(orders), len(bases), -1, width)  # (B, r + q, P, d)
    return _traces(sums, n_interest, total, len(residuals))


def _statistics(
    residuals: FloatArray, bases: FloatArray, n_interest: int, total: FloatArray
) -> FloatArray:
    own = np.arange(len(residuals))[None]
    first: FloatArray = _permuted_statistics(residuals, bases, n_interest, total, own)[0]
    return first


def _traces(sums: FloatArray, n_interest: int, total: FloatArray, count: int) -> FloatArray:
    """Return ``d tr(H E^-1)`` (B, P) from the products (B, r + q, P, d) with both bases."""
    effect = sums[:, -n_interest:]
    degrees = count - sums.shape[1]
    if total.shape[1] == 1:
        explained = (effect[..., 0] ** 2).sum(axis=1)  # (B, P)
        noise = total[:, 0, 0] - (sums[..., 0] ** 2).sum(axis=1)
        ratio: FloatArray = degrees * explained / _positive(noise)
        return ratio

    def entry(i: int, j: int) -> FloatArray:
        found: FloatArray = total[:, i, j] - (sums[..., i] * sums[..., j]).sum(axis=1)
        return found

    xx, yy, zz, xy, xz, yz = (
        entry(*k) for k in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    )  # (B, P) each
    # The inverse of a symmetric 3 x 3 matrix: its cofactors over its determinant.
    c_xx, c_xy, c_xz = yy * zz - yz**2, xz * yz - xy * zz, xy * yz - xz * yy
    c_yy, c_yz, c_zz = xx * zz - xz**2, xy * xz - xx * yz, xx * yy - xy**2
    determinant = _positive(xx * c_xx + xy * c_xy + xz * c_xz)
    trace = np.zeros_like(determinant)
    for row in range(n_interest):
        x, y, z = (effect[:, row, :, axis] for axis in range(3))
        trace += c_xx * x**2 + c_yy * y**2 + c_zz * z**2
        trace += 2.0 * (c_xy * x * y + c_xz * x * z + c_yz * y * z)
    statistics: FloatArray = degrees * trace / determinant
    return statistics


def _positive(values: FloatArray) -> FloatArray:
    return np.maximum(values, np.finfo(np.float64).tiny)
