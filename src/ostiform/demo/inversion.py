"""Inverses of maps of space by Newton's method."""

from collections.abc import Callable

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.compiled import kernel
from ostiform.errors import ConvergenceError

INVERSE_TOLERANCE_MM = 1e-11
"""Round-off of double precision at coordinates of 100 mm is 1e-14; Newton's last step squares."""
MAX_NEWTON_STEPS = 60


def solve3(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return the solutions (n, 3) of systems (n, 3, 3) by Cramer's rule."""
    solutions: FloatArray = _cramer(np.ascontiguousarray(matrices), np.ascontiguousarray(vectors))
    return solutions


@kernel
def _cramer(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    solutions = np.empty((len(matrices), 3))
    minors = np.empty((3, 3))
    for i in range(len(matrices)):
        m = matrices[i]
        for j in range(3):
            p, q = (j + 1) % 3, (j + 2) % 3
            for k in range(3):
                r, s = (k + 1) % 3, (k + 2) % 3
                minors[j, k] = m[p, r] * m[q, s] - m[p, s] * m[q, r]
        determinant = m[0, 0] * minors[0, 0] + m[0, 1] * minors[0, 1] + m[0, 2] * minors[0, 2]
        for k in range(3):
            total = 0.0
            for j in range(3):
                total += minors[j, k] * vectors[i, j]
            solutions[i, k] = total / determinant
    return solutions


def newton_inverse(
    displacement: Callable[[FloatArray], tuple[FloatArray, FloatArray]],
    targets: FloatArray,
    name: str,
) -> FloatArray:
    """Return the points x (n, 3) with x + d(x) = y, by damped Newton, each point on its own.

    Parameters
    ----------
    displacement : callable
        From points (n, 3) to d (n, 3) and its derivatives (n, 3, 3).
    targets : (n, 3) float64, mm
        y.
    name : str
        What is inverted, for the error message.

    Raises
    ------
    ConvergenceError
        If some point does not converge.
    """
    points = targets - displacement(targets)[0]
    active = np.arange(len(targets))
    for _ in range(MAX_NEWTON_STEPS):
        if not active.size:
            return points
        value, slope = displacement(points[active])
        residual = points[active] + value - targets[active]
        error = np.sqrt(np.einsum("ij,ij->i", residual, residual))
        step = solve3(slope + np.eye(3), residual)
        damping = np.minimum(1.0, 4.0 / np.maximum(np.sqrt((step**2).sum(axis=1)), 1e-12))
        points[active] -= damping[:, None] * step
        active = active[error > INVERSE_TOLERANCE_MM]
    raise ConvergenceError(
        f"{name}: expected the inverse of every point within {MAX_NEWTON_STEPS} Newton steps, "
        f"found {len(active)} of {len(targets)} unsolved; reduce the displacements"
    )
