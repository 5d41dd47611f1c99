"""Sparse symmetric positive definite systems: one factorisation, many right-hand sides."""

from typing import Any

import numpy as np
import qdldl  # type: ignore[import-not-found]
from scipy import sparse

from ostiform.arrays import FloatArray


class Factorization:
    """An L D L^T factorisation whose ordering is reused when only the values change."""

    def __init__(self, upper: sparse.csc_array) -> None:
        self._upper = upper
        self._solver: Any = qdldl.Solver(upper, upper=True)

    def update(self, values: FloatArray) -> None:
        """Factorise the matrix with the same pattern and other values.

        Parameters
        ----------
        values : (n_entries,) float64
            In the order of the `data` of the matrix given first.
        """
        self._upper = sparse.csc_array(
            (values, self._upper.indices, self._upper.indptr), shape=self._upper.shape
        )
        self._solver.update(self._upper, upper=True)

    def solve(self, right: FloatArray) -> FloatArray:
        """Return the solution (n,) or (n, k) for a right-hand side (n,) or (n, k)."""
        if right.ndim == 1:
            solution: FloatArray = np.asarray(self._solver.solve(np.ascontiguousarray(right)))
            return solution
        return np.stack([self.solve(column) for column in right.T], axis=1)


def factorize(upper: sparse.csc_array) -> Factorization:
    """Factorise a symmetric positive definite matrix.

    Parameters
    ----------
    upper : (n, n) sparse
        Its upper triangle, diagonal included, in compressed columns with sorted indices.

    Notes
    -----
    Does not check that the matrix is positive definite.
    """
    return Factorization(upper)
