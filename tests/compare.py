"""The only comparers of models: they know that signs and bases of equal variances are free."""

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.model import ShapeModel

EQUAL_VARIANCES = 1e-5
"""Relative to the largest variance: modes nearer than this are compared as one subspace."""


def assert_same_modes(
    actual: FloatArray,
    expected: FloatArray,
    variances: FloatArray,
    weights: FloatArray,
    atol: float = 1e-8,
) -> None:
    """Check that modes (K, P, 3) span, variance by variance, the same weighted subspaces.

    Within a group of equal variances the cosines of the principal angles must all be one; for a
    single mode that leaves its sign free.
    """
    np.testing.assert_equal(actual.shape, expected.shape)
    cosines = np.einsum("kpi,lpi,p->kl", actual, expected, weights)
    gaps = np.flatnonzero(-np.diff(variances) > EQUAL_VARIANCES * variances[0]) + 1
    for group in np.split(np.arange(len(variances)), gaps):
        angles = np.linalg.svd(cosines[np.ix_(group, group)], compute_uv=False)
        np.testing.assert_allclose(angles, 1.0, atol=atol, err_msg=f"subspace of modes {group}")


def assert_same_model(actual: ShapeModel, expected: ShapeModel, rtol: float = 1e-8) -> None:
    """Check that two models are the same distribution on the same mesh."""
    size = np.linalg.norm(expected.mean - expected.mean.mean(axis=0), axis=1).max()
    np.testing.assert_allclose(actual.mean, expected.mean, atol=rtol * size)
    np.testing.assert_allclose(actual.weights, expected.weights, rtol=rtol)
    np.testing.assert_allclose(
        actual.variances, expected.variances, rtol=rtol, atol=rtol * expected.variances.max()
    )
    np.testing.assert_allclose(
        actual.residual_variance,
        expected.residual_variance,
        rtol=rtol,
        atol=rtol * max(expected.total_variance, 1e-300),
    )
    assert_same_modes(
        actual.modes, expected.modes, expected.variances, expected.weights, atol=10 * rtol
    )
    np.testing.assert_array_equal(actual.mesh.faces, expected.mesh.faces)
    np.testing.assert_array_equal(actual.mesh.face_part, expected.mesh.face_part)
    np.testing.assert_array_equal(actual.mesh.part, expected.mesh.part)
    np.testing.assert_equal(actual.mesh.parts, expected.mesh.parts)
    np.testing.assert_equal(list(actual.mesh.loops), list(expected.mesh.loops))
    for name, loop in expected.mesh.loops.items():
        np.testing.assert_array_equal(actual.mesh.loops[name], loop)
