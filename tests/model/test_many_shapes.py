"""The model of very many shapes: leading modes as the exact decomposition has them."""

import numpy as np

from ostiform.model import fit_model, mesh_of_template, pca
from tests.populations import population


def test_the_leading_modes_of_many_shapes_are_those_of_the_exact_model(rng, monkeypatch):
    correspondence = population(100, 3, rng)
    mesh = mesh_of_template(correspondence.template)
    exact = fit_model(correspondence.aligned, correspondence.weights, mesh)
    monkeypatch.setattr(pca, "LARGEST_EXACT", 200)
    monkeypatch.setattr(pca, "LEAST_SHARE", 1e-2)
    found = fit_model(correspondence.aligned, correspondence.weights, mesh)
    count = len(found.variances)
    assert 2 <= count < 20
    np.testing.assert_allclose(found.variances, exact.variances[:count], rtol=1e-6)
    np.testing.assert_allclose(
        found.variances.sum() + found.residual_variance, exact.variances.sum(), rtol=1e-9
    )
    np.testing.assert_allclose(found.modes, exact.modes[:count], atol=1e-4)
    np.testing.assert_allclose(found.mean, exact.mean)
