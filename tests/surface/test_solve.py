"""Sparse factorisations against dense solutions."""

import numpy as np
from scipy import sparse

from ostiform.surface.solve import factorize


def _positive_definite(rng: np.random.Generator, size: int) -> sparse.csc_array:
    entries = sparse.random_array((size, size), density=0.1, rng=rng)
    matrix = (entries @ entries.T + sparse.eye_array(size)).tocsc()
    upper = sparse.csc_array(sparse.triu(matrix))
    upper.sort_indices()
    return upper


def _full(upper: sparse.csc_array) -> np.ndarray:
    dense = upper.toarray()
    return dense + np.triu(dense, 1).T


def test_solutions_equal_those_of_the_dense_matrix(rng):
    upper = _positive_definite(rng, 40)
    right = rng.normal(size=(40, 3))
    solution = factorize(upper).solve(right)
    np.testing.assert_allclose(solution, np.linalg.solve(_full(upper), right), rtol=1e-9)
    np.testing.assert_allclose(factorize(upper).solve(right[:, 0]), solution[:, 0], rtol=1e-12)


def test_an_update_replaces_the_values_and_keeps_the_pattern(rng):
    upper = _positive_definite(rng, 40)
    right = rng.normal(size=40)
    factorization = factorize(upper)
    factorization.update(3.0 * upper.data)
    expected = np.linalg.solve(3.0 * _full(upper), right)
    np.testing.assert_allclose(factorization.solve(right), expected, rtol=1e-9)
