"""Weighted principal components: closed forms, two routes, theorems, and every refusal."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ostiform.errors import InputError
from ostiform.model import (
    ModelMesh,
    ShapeModel,
    StoredModel,
    fit_model,
    marginal,
    mesh_of_template,
    part_marginal,
    posterior,
    project,
    reconstruct,
    sample_scores,
    truncated,
)
from tests.compare import assert_same_model, assert_same_modes
from tests.populations import area_weights, ellipsoids, population, two_part_template

ROUNDING = 1e-10  # relative: sums over a few hundred points in double precision


@pytest.fixture
def shapes():
    return population(4, 5, np.random.default_rng(7))


@pytest.fixture
def model(shapes):
    return fit_model(shapes.aligned, shapes.weights, mesh_of_template(shapes.template))


def ellipsoid_model(scale=1.0):
    """Return the model of uncorrelated semi-axes, its exact modes and variances.

    The four rows of a Hadamard design make the sample covariance of the semi-axes diagonal,
    ``4 / 3 s_k^2``; the mode of axis k moves points along k by u_k, whose weighted square sum is
    the second moment m_k of the sphere.
    """
    template = two_part_template()
    weights = area_weights(template.points, template.faces)
    design = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    spread = scale * np.array([3.0, 2.0, 1.0])
    axes = scale * np.array([40.0, 36.0, 50.0]) + design * spread
    moments = weights @ template.points**2
    modes = np.zeros((3, len(weights), 3))
    for axis in range(3):
        modes[axis, :, axis] = template.points[:, axis] / np.sqrt(moments[axis])
    fitted = fit_model(ellipsoids(template.points, axes), weights, mesh_of_template(template))
    return fitted, modes, 4.0 / 3.0 * spread**2 * moments


def test_ellipsoids_have_the_modes_and_variances_of_their_semi_axes():
    fitted, modes, variances = ellipsoid_model()
    np.testing.assert_allclose(fitted.variances, variances, rtol=ROUNDING)
    assert_same_modes(fitted.modes, modes, variances, fitted.weights)


@pytest.mark.parametrize("fault", ["rotate", "swap", "drop"])
def test_the_comparer_of_modes_bites(fault):
    fitted, modes, variances = ellipsoid_model()
    angle = 1e-3  # the cosine differs by 5e-7, fifty times the tolerance
    wrong = {
        "rotate": np.stack(
            [
                np.cos(angle) * modes[0] + np.sin(angle) * modes[1],
                np.cos(angle) * modes[1] - np.sin(angle) * modes[0],
                modes[2],
            ]
        ),
        "swap": modes[[1, 0, 2]],
        "drop": modes[:2],
    }[fault]
    with pytest.raises(AssertionError):
        assert_same_modes(wrong, fitted.modes, variances, fitted.weights)


def test_the_comparer_of_modes_leaves_signs_and_equal_variances_free(rng):
    fitted, modes, _ = ellipsoid_model()
    turned = np.tensordot(np.linalg.qr(rng.normal(size=(3, 3)))[0], modes, axes=1)
    assert_same_modes(turned, fitted.modes, np.array([2.0, 2.0, 2.0]), fitted.weights)
    assert_same_modes(-modes, fitted.modes, fitted.variances, fitted.weights)


def test_the_comparer_of_models_bites(model):
    for wrong in (
        replace(model, mean=model.mean + 1e-6),
        replace(model, variances=model.variances * (1.0 + 1e-7)),
        replace(model, residual_variance=1e-6 * model.total_variance),
        replace(model, mesh=replace(model.mesh, loops={})),
    ):
        with pytest.raises(AssertionError):
            assert_same_model(wrong, model)


def test_variances_by_singular_values_equal_those_of_the_covariance(shapes, model):
    deviations = shapes.aligned - shapes.aligned.mean(axis=0)
    scaled = (deviations * np.sqrt(shapes.weights)[:, None]).reshape(len(deviations), -1)
    covariance = scaled.T @ scaled / (len(scaled) - 1)
    values, vectors = np.linalg.eigh(covariance)
    kept = np.argsort(values)[::-1][: len(model.variances)]
    np.testing.assert_allclose(model.variances, values[kept], rtol=1e-9, atol=1e-12)
    modes = vectors.T[kept].reshape(model.modes.shape) / np.sqrt(shapes.weights)[:, None]
    assert_same_modes(model.modes, modes, model.variances, model.weights)


def test_the_variances_sum_to_the_weighted_variance_of_the_points(shapes, model):
    total = (shapes.aligned.var(axis=0, ddof=1).sum(axis=1) * shapes.weights).sum()
    np.testing.assert_allclose(model.total_variance, total, rtol=ROUNDING)


def test_all_modes_together_reproduce_every_training_shape(shapes, model):
    again = reconstruct(model, project(model, shapes.aligned))
    np.testing.assert_allclose(again, shapes.aligned, atol=ROUNDING * 50.0)


def test_there_are_at_most_as_many_modes_as_shapes_less_one(shapes, model):
    assert len(model.modes) == len(shapes.ids) - 1


def test_equal_shapes_have_no_modes(shapes):
    same = np.repeat(shapes.aligned[:1], 3, axis=0)
    model = fit_model(same, shapes.weights, mesh_of_template(shapes.template))
    assert len(model.modes) == 0
    np.testing.assert_allclose(reconstruct(model, np.empty(0)), same[0])


def test_the_scores_of_the_training_shapes_are_uncorrelated(shapes, model):
    scores = project(model, shapes.aligned)
    np.testing.assert_allclose(
        np.cov(scores.T), np.diag(model.variances), atol=ROUNDING * model.variances[0]
    )


@settings(max_examples=10)
@given(seed=st.integers(0, 1000), scale=st.sampled_from([0.01, 1.0, 100.0]))
def test_moving_and_scaling_the_population_moves_and_scales_the_model(seed, scale):
    rng = np.random.default_rng(seed)
    shapes = population(3, 2, rng)
    mesh = mesh_of_template(shapes.template)
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    model = fit_model(shapes.aligned, shapes.weights, mesh)
    moved = fit_model(scale * (shapes.aligned @ rotation.T + 5.0), shapes.weights, mesh)
    np.testing.assert_allclose(moved.variances, scale**2 * model.variances, rtol=1e-8)
    assert_same_modes(
        moved.modes, model.modes @ rotation.T, model.variances, shapes.weights, atol=1e-6
    )


def test_renaming_the_points_renames_the_model(shapes, model, rng):
    order = rng.permutation(len(shapes.weights))
    place = np.argsort(order)
    mesh = mesh_of_template(shapes.template)
    renamed = fit_model(
        shapes.aligned[:, order],
        shapes.weights[order],
        ModelMesh(place[mesh.faces], mesh.face_part, mesh.part[order], mesh.parts, {}),
    )
    np.testing.assert_allclose(renamed.variances, model.variances, rtol=1e-9)
    assert_same_modes(renamed.modes, model.modes[:, order], model.variances, renamed.weights)


def test_fitting_leaves_its_input_alone(shapes):
    aligned = np.array(shapes.aligned)
    fit_model(aligned, shapes.weights, mesh_of_template(shapes.template))
    np.testing.assert_array_equal(aligned, shapes.aligned)


def test_random_scores_have_the_variances_of_the_modes(model):
    scores = sample_scores(model, 20000, np.random.default_rng(3))
    relative = scores.var(axis=0) / model.variances - 1.0
    assert np.abs(relative).max() < 5.0 * np.sqrt(2.0 / 20000)  # five standard errors


def test_truncated_scores_stay_within_the_limit_and_lose_the_known_variance(model):
    scores = sample_scores(model, 20000, np.random.default_rng(3), limit=1.0)
    standard = scores / np.sqrt(model.variances)
    assert np.abs(standard).max() <= 1.0
    density = np.exp(-0.5) / np.sqrt(2.0 * np.pi)
    expected = 1.0 - 2.0 * density / 0.6826894921370859  # variance of a normal cut at one sd
    np.testing.assert_allclose(standard.var(), expected, rtol=0.01)  # 20 000 x 19 draws


def test_equal_seeds_give_equal_shapes(model):
    first = model.sample(3, np.random.default_rng(5), 3.0)
    np.testing.assert_array_equal(first, model.sample(3, np.random.default_rng(5), 3.0))


def test_truncating_moves_variance_to_the_residual(model):
    short = truncated(model, 3)
    np.testing.assert_allclose(short.total_variance, model.total_variance, rtol=ROUNDING)
    np.testing.assert_allclose(short.residual_variance, model.variances[3:].sum(), rtol=ROUNDING)
    np.testing.assert_array_equal(short.modes, model.modes[:3])


def test_the_marginal_of_points_is_the_model_of_those_points(shapes, model):
    points = np.arange(0, len(shapes.weights), 2)[::-1]
    few = marginal(model, points)
    weights = shapes.weights[points] / shapes.weights[points].sum()
    direct = fit_model(shapes.aligned[:, points], weights, replace(few.mesh))
    assert_same_model(few, direct)


def test_the_marginal_of_all_points_is_the_model(model):
    assert_same_model(marginal(model, np.arange(len(model.mean))), model)


def test_the_marginal_of_a_part_has_its_seam_and_its_openings_only(model):
    atrium = part_marginal(model, "LA")
    assert atrium.mesh.parts == ("LA",)
    assert set(atrium.mesh.loops) == {"LA.mitral", "LA.vein"}
    seam = model.mean[model.mesh.loops["LA.mitral"]]
    np.testing.assert_array_equal(atrium.mean[atrium.mesh.loops["LA.mitral"]], seam)
    assert len(atrium.mesh.faces) == (model.mesh.face_part == 1).sum()


def test_conditioning_equals_the_formula_on_the_full_covariance(model):
    prior = truncated(model, 6)
    points, noise = np.array([3, 40, 77]), np.array([0.3, 0.5, 1.0])
    seen = prior.mean[points] + 2.0
    after = posterior(prior, points, seen, noise)
    factor = (prior.modes * np.sqrt(prior.variances)[:, None, None]).reshape(6, -1).T
    covariance = factor @ factor.T
    rows = (3 * points[:, None] + np.arange(3)).ravel()
    variance = np.repeat(noise**2 + prior.residual_variance / 3.0, 3)
    gain = covariance[:, rows] @ np.linalg.inv(covariance[np.ix_(rows, rows)] + np.diag(variance))
    mean = prior.mean.ravel() + gain @ (seen - prior.mean[points]).ravel()
    np.testing.assert_allclose(after.mean.ravel(), mean, atol=1e-9)
    root = (after.modes * np.sqrt(after.variances)[:, None, None]).reshape(6, -1).T
    np.testing.assert_allclose(
        root @ root.T, covariance - gain @ covariance[rows], atol=1e-9 * covariance.max()
    )


def test_conditioning_on_everything_with_little_noise_gives_the_shape(shapes, model):
    target = shapes.aligned[4]
    after = posterior(model, np.arange(len(target)), target, 1e-6)
    np.testing.assert_allclose(after.mean, target, atol=1e-6)
    assert after.total_variance < 1e-9 * model.total_variance


def test_conditioning_never_adds_variance(model, rng):
    points = rng.choice(len(model.mean), 10, replace=False)
    after = posterior(model, points, model.mean[points], 0.5)
    assert after.total_variance < model.total_variance


def model_arguments(model):
    return {name: getattr(model, name) for name in ShapeModel.__dataclass_fields__}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"variances": [1.0, 2.0]}, "largest first"),
        ({"variances": [1.0, -2.0]}, "non-negative"),
        ({"residual_variance": -1.0}, "residual variance"),
        ({"residual_variance": np.inf}, "residual variance"),
        ({"scale_modes": 1.0 + 1e-6}, "orthonormal"),
        ({"scale_weights": 1.1}, "sum of 1"),
        ({"zero_weight": True}, "positive area shares"),
        ({"mean": np.zeros((3, 3))}, "mean"),
    ],
)
def test_a_model_refuses(model, changes, message):
    arguments = model_arguments(truncated(model, 2))
    scale = changes.pop("scale_modes", 1.0)
    arguments["modes"] = arguments["modes"] * scale
    arguments["weights"] = arguments["weights"] * changes.pop("scale_weights", 1.0)
    if changes.pop("zero_weight", False):
        arguments["weights"] = np.where(np.arange(len(model.mean)) == 5, 0.0, arguments["weights"])
    with pytest.raises(InputError, match=message):
        ShapeModel(**{**arguments, **changes})


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda m: fit_model(m.mean[None], m.weights, m.mesh), "at least 2 shapes"),
        (lambda m: fit_model(np.zeros((2, 4, 3)), m.weights, m.mesh), "aligned shapes"),
        (lambda m: reconstruct(m, np.zeros(len(m.modes) + 1)), "at most"),
        (lambda m: truncated(m, -1), "truncated model"),
        (lambda m: truncated(m, len(m.modes) + 1), "truncated model"),
        (lambda m: marginal(m, np.array([0, 10**6])), "indices from 0"),
        (lambda m: marginal(m, np.array([], dtype=np.int64)), "found none"),
        (lambda m: marginal(m, np.array([4, 4])), "4 twice"),
        (lambda m: part_marginal(m, "RV"), "found RV"),
        (lambda m: posterior(m, np.array([0]), m.mean[:1], 0.0), "noise"),
        (lambda m: posterior(m, np.array([0]), m.mean[:1], -1.0), "noise"),
        (lambda m: posterior(m, np.array([0]), m.mean[:1], np.nan), "noise"),
        (lambda m: posterior(m, np.array([0]), m.mean[:2], 1.0), "observed positions"),
    ],
)
def test_operations_refuse(model, call, message):
    with pytest.raises(InputError, match=message):
        call(model)


@pytest.mark.parametrize("name", ["faces", "face_part", "part", "loops"])
def test_a_model_mesh_refuses_indices_out_of_range(model, name):
    wrong = {"bad": np.array([10**6])} if name == "loops" else getattr(model.mesh, name) + 10**6
    with pytest.raises(InputError, match="expected indices"):
        replace(model.mesh, **{name: wrong})


def test_a_stored_model_refuses_the_template_of_another(model):
    other = two_part_template(rows=7)
    with pytest.raises(InputError, match="template of a model"):
        StoredModel(model, np.empty((0, len(model.modes))), (), other)
