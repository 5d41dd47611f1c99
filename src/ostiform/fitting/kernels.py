"""Compiled loops of the fit: rows of the linear problem, shapes from coefficients."""

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.compiled import kernel


@kernel
def design_rows(
    modes: FloatArray,
    field: FloatArray,
    corners: IntArray,
    barycentric: FloatArray,
    directions: FloatArray,
) -> FloatArray:
    """Return how far points move along given directions per unit of every coefficient.

    Parameters
    ----------
    modes : (Q, 3, K) float64, mm
        Displacement of every point per unit of every mode's coefficient.
    field : (Q, M) float64, mm
        Displacement of every point, in each coordinate, per unit of the field's coefficients.
    corners : (n, 3) int64
        The points that a row's point is interpolated from.
    barycentric : (n, 3) float64
    directions : (n, 3) float64

    Returns
    -------
    rows : (n, K + 3 M) float64
        Coefficients K + 3 j + d belong to coordinate d of the field's function j.
    """
    n, n_modes, n_field = len(corners), modes.shape[2], field.shape[1]
    rows = np.zeros((n, n_modes + 3 * n_field))
    for i in range(n):
        for c in range(3):
            share = barycentric[i, c]
            if share == 0.0:
                continue
            p = corners[i, c]
            for d in range(3):
                factor = share * directions[i, d]
                for k in range(n_modes):
                    rows[i, k] += factor * modes[p, d, k]
                for j in range(n_field):
                    rows[i, n_modes + 3 * j + d] += factor * field[p, j]
    return rows


@kernel
def point_covariances(rows: FloatArray, spread: FloatArray) -> FloatArray:
    """Return the covariance (n, 3, 3) of points from three rows each.

    Parameters
    ----------
    rows : (3 n, C) float64
        The three coordinates of each point per unit of every unknown.
    spread : (3 n, C) float64
        The rows times the covariance of the unknowns.
    """
    n = len(rows) // 3
    covariances = np.zeros((n, 3, 3))
    for p in range(n):
        for a in range(3):
            for b in range(a, 3):
                total = 0.0
                for c in range(rows.shape[1]):
                    total += rows[3 * p + a, c] * spread[3 * p + b, c]
                covariances[p, a, b] = total
                covariances[p, b, a] = total
    return covariances
