"""The coherence term charges rough deviations, hardly smooth ones, and is what it says in sum."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from ostiform.correspondence.terms.coherence import (
    NOISE_RATIO,
    SCALES,
    coherence_about,
    coherence_form,
    coherence_value,
)
from ostiform.correspondence.terms.quadratic_form import form_value


@pytest.fixture
def mean(rng):
    directions = rng.normal(size=(200, 3))
    return 30.0 * directions / np.linalg.norm(directions, axis=1, keepdims=True)


@pytest.fixture
def weights(rng):
    weights = rng.uniform(0.5, 1.5, size=200)
    return weights / weights.sum()


def test_a_form_is_the_smoother_residual_of_the_kernel(mean, weights, rng):
    term = coherence_about(mean, weights, 7.0)
    shape = mean + rng.normal(size=mean.shape)
    scaled = (shape - mean) * np.sqrt(weights)[:, None]
    centred = mean - weights @ mean
    radius = np.sqrt(weights @ (centred**2).sum(axis=1))
    distances = np.linalg.norm(mean[:, None] - mean, axis=2) / radius
    kernel = sum(share * np.exp(-0.5 * (distances / scale) ** 2) for scale, share in SCALES)
    kernel = kernel * np.sqrt(np.outer(weights, weights))
    noise = NOISE_RATIO / len(mean) * np.eye(len(mean))
    explained = np.linalg.solve(kernel + noise, kernel @ scaled)
    expected = 7.0 / radius**2 * float((scaled * (scaled - explained)).sum())
    # motions that explain less than 2 % of their variance are left out
    assert_allclose(form_value(coherence_form(term, mean), shape), expected, rtol=0.01)


def test_smooth_motions_cost_little_and_rough_ones_their_size(mean, weights, rng):
    term = coherence_about(mean, weights, 1.0)
    form = coherence_form(term, mean)
    shift = np.broadcast_to([1.0, -2.0, 0.5], mean.shape)
    stretch = 0.05 * mean * [1.0, -1.0, 0.0]
    noise = rng.normal(size=mean.shape)
    for smooth in (shift, stretch):
        size = weights @ (smooth**2).sum(axis=1)
        assert form_value(form, mean + smooth) < 0.01 * size * term.strength
    size = weights @ (noise**2).sum(axis=1)
    assert form_value(form, mean + noise) > 0.5 * size * term.strength


def test_the_value_of_a_population_is_the_sum_of_its_forms(mean, weights, rng):
    shapes = mean + rng.normal(size=(6, *mean.shape))
    term = coherence_about(shapes.mean(axis=0), weights, 3.0)
    form = coherence_form(term, shapes.mean(axis=0))
    expected = sum(form_value(form, shape) for shape in shapes) / 5.0
    assert_allclose(coherence_value(term, shapes), expected, rtol=1e-10)


def test_the_term_does_not_depend_on_the_frame_or_the_unit(mean, weights, rng):
    shape = mean + rng.normal(size=mean.shape)
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    value = form_value(coherence_form(coherence_about(mean, weights, 1.0), mean), shape)
    moved, carried = mean @ rotation.T + 9.0, shape @ rotation.T + 9.0
    turned = coherence_form(coherence_about(moved, weights, 1.0), moved)
    assert_allclose(form_value(turned, carried), value, rtol=1e-9)
    larger = coherence_form(coherence_about(10.0 * mean, weights, 1.0), 10.0 * mean)
    assert_allclose(form_value(larger, 10.0 * shape), value, rtol=1e-9)


def test_without_strength_nothing_is_charged(mean, weights, rng):
    term = coherence_about(mean, weights, 0.0)
    shapes = mean + rng.normal(size=(3, *mean.shape))
    assert coherence_value(term, shapes) == 0.0
    assert form_value(coherence_form(term, mean), shapes[0]) == 0.0
