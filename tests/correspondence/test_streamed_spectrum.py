"""The strong part of a spectrum from a stream agrees with the exact decomposition."""

from importlib import import_module

import numpy as np
import pytest

from ostiform.correspondence.streaming import streamed_length, streamed_spectrum
from ostiform.correspondence.terms.description_length import (
    cut_off_eigenvalue,
    description_length,
    spectrum,
)
from ostiform.errors import ConvergenceError, InputError

COUNT, POINTS, MODES, NOISE_MM = 300, 220, 40, 0.3


@pytest.fixture(scope="module")
def shapes():
    """300 shapes of 40 modes whose strengths fall geometrically into noise, and their weights."""
    rng = np.random.default_rng(8)
    weights = rng.uniform(0.5, 1.5, size=POINTS)
    weights /= weights.sum()
    modes = np.linalg.qr(rng.normal(size=(3 * POINTS, MODES)))[0].T
    scaled = (rng.normal(size=(COUNT, MODES)) * 5.0 * 0.85 ** np.arange(MODES)) @ modes
    aligned = scaled.reshape(COUNT, POINTS, 3) / np.sqrt(weights)[:, None]
    aligned += NOISE_MM * rng.normal(size=aligned.shape) + rng.normal(size=(POINTS, 3))
    return aligned, weights


def in_chunks(aligned, size):
    return lambda: (aligned[first : first + size] for first in range(0, len(aligned), size))


@pytest.mark.parametrize("noises", [10.0, 3.0])
def test_300_shapes_in_chunks_have_the_eigenvalues_and_modes_of_the_exact_spectrum(shapes, noises):
    aligned, weights = shapes
    l_cut = noises * cut_off_eigenvalue(NOISE_MM, COUNT, POINTS)
    exact = spectrum(aligned, weights)
    found = streamed_spectrum(in_chunks(aligned, 32), weights, l_cut, np.random.default_rng(0))
    strong = exact.eigenvalues > l_cut
    assert 5 < strong.sum() == len(found.eigenvalues) < 60
    np.testing.assert_allclose(found.eigenvalues, exact.eigenvalues[strong], rtol=1e-6)
    cosines = np.linalg.svd(found.modes @ exact.modes[strong].T, compute_uv=False)
    np.testing.assert_allclose(cosines, 1.0, rtol=0.0, atol=1e-6)  # of the principal angles
    np.testing.assert_allclose(found.mean, exact.mean, rtol=1e-12)
    np.testing.assert_allclose(found.rest, exact.eigenvalues[~strong].sum(), rtol=1e-6)


def test_the_description_length_is_exact_though_weak_modes_are_never_found(shapes):
    aligned, weights = shapes
    l_cut = 5.0 * cut_off_eigenvalue(NOISE_MM, COUNT, POINTS)
    found = streamed_spectrum(in_chunks(aligned, 50), weights, l_cut, np.random.default_rng(1))
    np.testing.assert_allclose(
        streamed_length(found, l_cut), description_length(aligned, weights, l_cut), rtol=1e-6
    )


def test_neither_the_chunks_nor_the_seed_matter(shapes):
    aligned, weights = shapes
    l_cut = 8.0 * cut_off_eigenvalue(NOISE_MM, COUNT, POINTS)
    first, second = (
        streamed_spectrum(in_chunks(aligned, size), weights, l_cut, np.random.default_rng(size))
        for size in (7, 300)
    )
    np.testing.assert_allclose(first.eigenvalues, second.eigenvalues, rtol=1e-6)


def test_few_shapes_need_no_more_directions_than_there_are(rng):
    aligned = rng.normal(size=(6, 30, 3))
    weights = np.full(30, 1.0 / 30.0)
    exact = spectrum(aligned, weights)
    found = streamed_spectrum(in_chunks(aligned, 2), weights, 1e-9, rng)
    np.testing.assert_allclose(found.eigenvalues, exact.eigenvalues, rtol=1e-6)
    np.testing.assert_allclose(found.rest, 0.0, atol=1e-9)


def test_one_shape_is_refused(rng):
    weights = np.full(30, 1.0 / 30.0)
    with pytest.raises(InputError, match="at least 2 shapes, found 1"):
        streamed_spectrum(in_chunks(rng.normal(size=(1, 30, 3)), 1), weights, 0.1, rng)


def test_eigenvalues_that_do_not_settle_are_an_error(monkeypatch, shapes):
    aligned, weights = shapes
    module = import_module("ostiform.correspondence.streaming")
    monkeypatch.setattr(module, "MOST_PASSES", 2)
    with pytest.raises(ConvergenceError, match="within 2 passes"):
        streamed_spectrum(in_chunks(aligned, 50), weights, 1e-3, np.random.default_rng(0))
