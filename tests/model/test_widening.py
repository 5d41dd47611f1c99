"""Widening a model: covariances add, the rank stays low, and unseen shapes are reached better."""

import numpy as np
import pytest

from ostiform.errors import InputError
from ostiform.model import (
    Kernel,
    StoredModel,
    fit_model,
    kernel_values,
    mesh_of_template,
    posterior,
    project,
    reconstruct,
    widened,
    widened_stored,
)
from ostiform.model.widening import kernel_factor
from tests.populations import population

ROUNDING = 1e-9


def covariance(model):
    root = (model.modes * np.sqrt(model.variances)[:, None, None]).reshape(len(model.modes), -1)
    return root.T @ root


@pytest.fixture
def shapes():
    return population(3, 4, np.random.default_rng(8))


@pytest.fixture
def model(shapes):
    return fit_model(shapes.aligned, shapes.weights, mesh_of_template(shapes.template))


@pytest.mark.parametrize("shape", ["gaussian", "compact"])
def test_at_full_rank_the_covariance_is_the_samples_plus_the_kernels(model, shape):
    kernels = [Kernel(2.0, 15.0, shape), Kernel(0.7, 4.0, shape)]
    result = widened(model, kernels, left_out=0.0)
    scalar = kernel_values(kernels, model.mean, model.mean)
    expected = covariance(model) + np.kron(scalar, np.eye(3))
    found = covariance(result.model)
    np.testing.assert_allclose(found, expected, atol=ROUNDING * expected.max())
    np.testing.assert_allclose(result.added_variance, 3.0 * (2.0**2 + 0.7**2), rtol=1e-9)
    np.testing.assert_allclose(
        result.model.total_variance, model.total_variance + result.added_variance, rtol=1e-9
    )


@pytest.mark.parametrize("shape", ["gaussian", "compact"])
def test_a_kernel_is_its_formula(shape, rng):
    first, second = rng.normal(scale=20.0, size=(2, 7, 3))
    kernel = Kernel(1.5, 12.0, shape)
    radius = np.linalg.norm(first[:, None] - second, axis=2)
    if shape == "gaussian":
        expected = 2.25 * np.exp(-(radius**2) / (2.0 * 144.0))
    else:
        ratio = np.minimum(radius / (3.75 * 12.0), 1.0)
        expected = 2.25 * (1.0 - ratio) ** 4 * (4.0 * ratio + 1.0)
    np.testing.assert_allclose(kernel_values([kernel], first, second), expected, atol=1e-12)


def test_the_two_kernels_are_as_wide_at_half_height():
    half = 12.0 * np.sqrt(2.0 * np.log(2.0))
    for shape in ("gaussian", "compact"):
        value = kernel_values(
            [Kernel(1.0, 12.0, shape)], np.zeros((1, 3)), np.array([[half, 0, 0]])
        )
        np.testing.assert_allclose(value, 0.5, atol=0.01)


def test_a_low_rank_factor_leaves_out_the_share_that_was_allowed(model):
    kernels = [Kernel(2.0, 30.0)]
    factor = kernel_factor(kernels, model.mean, model.weights, left_out=0.02)
    left = 4.0 - (factor**2).sum(axis=1)
    assert (left > -ROUNDING).all()
    assert 0.0 < model.weights @ left <= 0.02 * 4.0
    assert factor.shape[1] < 40
    more = kernel_factor(kernels, model.mean, model.weights, left_out=1e-4)
    assert more.shape[1] > factor.shape[1]
    np.testing.assert_array_equal(more[:, : factor.shape[1]], factor)


def test_moving_and_turning_a_model_does_not_change_what_is_added(model):
    turned = model.mean @ np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]).T + 30.0
    kernels = [Kernel(2.0, 20.0)]
    one = kernel_factor(kernels, model.mean, model.weights)
    two = kernel_factor(kernels, turned, model.weights)
    np.testing.assert_allclose(one @ one.T, two @ two.T, atol=1e-8)


def test_a_widened_model_keeps_its_shapes_and_their_names(shapes, model):
    stored = StoredModel(model, project(model, shapes.aligned), shapes.ids, shapes.template)
    new, result = widened_stored(stored, [Kernel(1.0, 20.0)])
    assert new.ids == stored.ids
    assert new.template is stored.template
    np.testing.assert_allclose(reconstruct(new.model, new.scores), shapes.aligned, atol=1e-8)
    assert 0.98 * 3.0 < result.added_variance < result.kernel_variance == 3.0


def test_unseen_points_of_a_left_out_subject_are_predicted_better_from_a_widened_model():
    shapes = population(6, 2, np.random.default_rng(3))
    subjects = np.array([id.subject for id in shapes.ids])
    mesh = mesh_of_template(shapes.template)
    seen = np.arange(0, len(mesh.part), 4)
    unseen = np.setdiff1d(np.arange(len(mesh.part)), seen)
    errors = {"plain": [], "widened": []}
    for subject in np.unique(subjects):
        others = [name for name in np.unique(subjects) if name != subject][:2]
        plain = fit_model(shapes.aligned[np.isin(subjects, others)], shapes.weights, mesh)
        for name, model in (
            ("plain", plain),
            ("widened", widened(plain, [Kernel(3.0, 25.0)]).model),
        ):
            for shape in shapes.aligned[subjects == subject]:
                found = posterior(model, seen, shape[seen], 0.5).mean
                errors[name].append(np.linalg.norm(found[unseen] - shape[unseen], axis=1).mean())
    assert np.mean(errors["widened"]) < 0.7 * np.mean(errors["plain"])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda model: Kernel(0.0, 3.0), "sd mm"),
        (lambda model: Kernel(1.0, np.inf), "length mm"),
        (lambda model: Kernel(1.0, 1.0, "box"), "gaussian, compact"),  # type: ignore[arg-type]
        (lambda model: widened(model, []), "at least one kernel"),
        (lambda model: widened(model, [Kernel(1, 1)], left_out=1.0), "to leave out"),
        (lambda model: widened(model, [Kernel(1, 1)], most_fields=0), "at least 1 field"),
    ],
)
def test_what_cannot_widen_is_refused(model, call, message):
    with pytest.raises(InputError, match=message):
        call(model)
