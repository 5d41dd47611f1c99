"""The dynamic model as a file, the model of shapes in correspondence, and intervals."""

import h5py
import numpy as np
import pytest
from scipy.stats import ttest_1samp

from ostiform.errors import ArtifactError
from ostiform.model import (
    analysed,
    corresponded_shapes,
    dynamic_model_of,
    fit_model,
    jackknife_half_width,
    mean_cycle,
    mean_half_width,
    read_dynamic_model,
    read_model,
    write_dynamic_model,
    write_model,
)
from tests.compare import assert_same_model
from tests.populations import population


@pytest.fixture(scope="module")
def shapes():
    return population(3, 4, np.random.default_rng(11))


@pytest.fixture(scope="module")
def stored(shapes):
    return analysed(corresponded_shapes(shapes), shapes.template)


def test_shapes_are_analysed_with_the_scores_that_give_them_back(shapes, stored):
    mesh = corresponded_shapes(shapes).mesh
    assert_same_model(stored.model, fit_model(shapes.aligned, shapes.weights, mesh))
    np.testing.assert_allclose(
        stored.model.reconstruct(stored.scores), shapes.aligned, rtol=0, atol=1e-9
    )


def test_a_dynamic_model_comes_back_bit_for_bit_without_a_fit(tmp_path, stored):
    model = dynamic_model_of(stored)
    path = tmp_path / "dynamics.h5"
    write_dynamic_model(path, model, stored.template)
    found = read_dynamic_model(path)
    assert (found.ids, found.subjects) == (model.ids, model.subjects)
    for name in ("total", "between", "within", "common", "departure", "between_corrected"):
        assert_same_model(getattr(found, name), getattr(model, name))
    times = np.linspace(0.0, 1.0, 7)
    np.testing.assert_array_equal(mean_cycle(found, times), mean_cycle(model, times))
    np.testing.assert_array_equal(
        found.trajectories.left_out_errors, model.trajectories.left_out_errors
    )
    assert read_model(path).ids == stored.ids


def test_a_model_without_trajectories_is_no_dynamic_model(tmp_path, stored):
    write_model(tmp_path / "model.h5", stored)
    with pytest.raises(ArtifactError, match="expected a dynamic model of ostiform"):
        read_dynamic_model(tmp_path / "model.h5")
    with h5py.File(tmp_path / "other.h5", "w"), pytest.raises(ArtifactError):
        read_dynamic_model(tmp_path / "other.h5")


def test_the_interval_of_a_mean_is_that_of_student(rng):
    values = rng.normal(size=(7, 2))
    expected = ttest_1samp(values, 0.0).confidence_interval(0.95)
    half = mean_half_width(values)
    np.testing.assert_allclose(half, 0.5 * (expected.high - expected.low), rtol=1e-12)
    assert mean_half_width(values[:2]) is None


def test_the_jackknife_of_a_mean_is_its_interval(rng):
    values = rng.normal(size=9)
    without = (values.sum() - values) / 8.0
    np.testing.assert_allclose(jackknife_half_width(without), mean_half_width(values), rtol=1e-12)
