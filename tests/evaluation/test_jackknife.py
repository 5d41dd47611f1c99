"""Intervals of variances and gains over subjects."""

import numpy as np
import pytest
from scipy.stats import t as student

from ostiform.errors import InputError
from ostiform.evaluation import cumulative_variance_error, gain_interval

SUBJECTS = np.repeat(["a", "b", "c", "d", "e"], 3).tolist()


def total(scores):
    return np.trace(np.cov(scores.T))


def test_an_interval_is_that_of_the_values_without_each_subject(rng):
    scores, other = rng.normal(size=(15, 4)), 1.3 * rng.normal(size=(15, 4))
    values = []
    for name in "abcde":
        kept = [s != name for s in SUBJECTS]
        values.append(1 - total(scores[kept]) / total(other[kept]))
    # Pseudo-values of Tukey: their standard error is the jackknife's.
    pseudo = 5 * np.mean(values) - 4 * np.array(values)
    half = student.ppf(0.975, 4) * pseudo.std(ddof=1) / np.sqrt(5)
    found = gain_interval(scores, other, SUBJECTS)
    value = 1 - total(scores) / total(other)
    np.testing.assert_allclose([found.low, found.high], [value - half, value + half], rtol=1e-9)
    assert found.subjects == 5


def test_a_gain_of_a_model_over_itself_is_surely_zero(rng):
    scores = rng.normal(size=(15, 4))
    found = gain_interval(scores, scores, SUBJECTS)
    np.testing.assert_allclose([found.low, found.high], 0.0, atol=1e-12)


def test_two_subjects_give_no_interval(rng):
    assert gain_interval(rng.normal(size=(4, 2)), rng.normal(size=(4, 2)), list("aabb")) is None
    np.testing.assert_array_equal(cumulative_variance_error(np.eye(4), list("aabb")), np.zeros(4))


def test_the_last_cumulative_variance_has_the_error_of_the_total(rng):
    scores = rng.normal(size=(15, 4))
    values = [total(scores[[s != name for s in SUBJECTS]]) for name in "abcde"]
    half = student.ppf(0.975, 4) * np.std(values) * np.sqrt(4)  # (S - 1) / S times S variances
    found = cumulative_variance_error(scores, SUBJECTS)
    assert found.shape == (4,)
    np.testing.assert_allclose(found[-1], half, rtol=1e-9)


def test_errors_scale_with_the_square_of_length(rng):
    scores = rng.normal(size=(15, 4))
    found = cumulative_variance_error(3.0 * scores, SUBJECTS)
    np.testing.assert_allclose(found, 9.0 * cumulative_variance_error(scores, SUBJECTS), rtol=1e-9)


def test_models_of_other_shapes_are_not_compared():
    with pytest.raises(InputError, match="same shapes"):
        gain_interval(np.eye(3), np.eye(2), ["a", "b", "c"])
