"""Values of a surface's vertices at points within its triangles; NaN where there is none."""

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.surface.queries import ClosestPoints

_NO_SHARE = 1e-9
"""A corner with less has no say: points on edges have rounding where the third corner has none."""


def interpolated_at(closest: ClosestPoints, faces: IntArray, values: FloatArray) -> FloatArray:
    """Return values (V,) interpolated linearly at points (n,); none where a corner has none."""
    corners = values[faces[closest.faces]]  # (n, 3)
    share = _shares(closest)
    known: FloatArray = np.einsum("nc,nc->n", share, np.nan_to_num(corners))
    return np.where((np.isnan(corners) & (share > 0.0)).any(axis=1), np.nan, known)


def prevailing_at(closest: ClosestPoints, faces: IntArray, labels: FloatArray) -> FloatArray:
    """Return which of the labels (V,) of a triangle's corners weighs most at points (n,)."""
    corners = labels[faces[closest.faces]]  # (n, 3)
    one, two = corners[:, :, None], corners[:, None, :]
    alike = (one == two) | (np.isnan(one) & np.isnan(two))  # (n, 3, 3)
    weight = np.einsum("nij,nj->ni", alike.astype(np.float64), _shares(closest))
    chosen: FloatArray = np.take_along_axis(corners, weight.argmax(axis=1)[:, None], axis=1)[:, 0]
    return chosen


def _shares(closest: ClosestPoints) -> FloatArray:
    share = np.where(closest.barycentric < _NO_SHARE, 0.0, closest.barycentric)
    scaled: FloatArray = share / share.sum(axis=1, keepdims=True)
    return scaled
