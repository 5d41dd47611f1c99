"""Prediction of whole cycles from single phases: exactness, invariance, honesty of the interval."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from ostiform.demo import demonstration_truth
from ostiform.errors import InputError
from ostiform.evaluation import prediction_errors, true_population
from ostiform.model import (
    ObservedPhase,
    fit_cycle_predictor,
    fit_dynamic_model,
    fitted_phase,
    fourier_design,
    mean_cycle,
    predict_cycle,
)
from ostiform.model.conditioning import CyclePrior, cycle_posterior

TRAINING, UNSEEN, PHASES = 20, 8, 10
EDGE_MM = 7.0  # five hundred points: the question is about cycles


@pytest.fixture(scope="module")
def hearts():
    subjects = TRAINING + UNSEEN
    return true_population(demonstration_truth(subjects, subjects * PHASES, 5), EDGE_MM)


@pytest.fixture(scope="module")
def model(hearts):
    n = TRAINING * PHASES
    return fit_dynamic_model(hearts.aligned[:n], hearts.ids[:n], hearts.weights, hearts.mesh)


def unseen(hearts):
    for subject in range(TRAINING, TRAINING + UNSEEN):
        own = slice(subject * PHASES, (subject + 1) * PHASES)
        yield hearts.points[own], [id.time for id in hearts.ids[own]]


def seen(points, time):
    return ObservedPhase(time, points, np.zeros((0, *points.shape)))


@pytest.mark.parametrize("pattern", [(0.0,), (0.0, 0.35)])
def test_predictions_beat_both_baselines_and_their_intervals_hold(hearts, model, pattern):
    predictor = fit_cycle_predictor(model, pattern)
    assert not predictor.is_weak
    assert predictor.left_out_errors.mean() < predictor.mean_motion_errors.mean()
    assert predictor.left_out_errors.mean() < predictor.nearest_subject_errors.mean()
    found = []
    for points, times in unseen(hearts):
        given = [int(np.abs((np.array(times) - t + 0.5) % 1.0 - 0.5).argmin()) for t in pattern]
        found.append(prediction_errors(predictor, points, times, given))
    mean = {
        name: np.mean([getattr(item, name).mean() for item in found])
        for name in ("predicted", "mean_motion", "nearest_subject", "coverage")
    }
    assert mean["predicted"] < mean["mean_motion"]
    assert mean["predicted"] < mean["nearest_subject"]
    # Eight hearts: their mean coverage has a standard error of about 0.02.
    assert 0.88 < mean["coverage"] < 0.99


def test_left_out_baselines_are_those_of_a_model_without_the_subject(hearts, model):
    """The subject that is left out of the baselines, against a model that never had it.

    The trajectories of a model without it differ a little: the common motion is fitted anew.
    """
    predictor = fit_cycle_predictor(model, [0.0])
    n = (TRAINING - 1) * PHASES
    without = fit_dynamic_model(hearts.aligned[:n], hearts.ids[:n], hearts.weights, hearts.mesh)
    own = slice(n, TRAINING * PHASES)
    errors = prediction_errors(
        fit_cycle_predictor(without, [0.0]),
        hearts.aligned[own],
        [id.time for id in hearts.ids[own]],
        [0],
    )
    for found, rule in (
        (predictor.mean_motion_errors[-1], errors.mean_motion),
        (predictor.nearest_subject_errors[-1], errors.nearest_subject),
        (predictor.left_out_errors[-1], errors.predicted),
    ):
        np.testing.assert_allclose(found, np.sqrt((rule**2).mean()), rtol=0.05)


def test_a_given_phase_is_its_own_prediction_in_any_frame(hearts, model):
    points, times = next(unseen(hearts))
    predictor = fit_cycle_predictor(model, [0.0])
    turn, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))
    turn[:, 0] *= np.linalg.det(turn)
    moved = points[0] @ turn.T + [100.0, -30.0, 5.0]
    instants = np.array([times[0], 0.3])
    here = predict_cycle(predictor, [seen(points[0], times[0])], instants)
    there = predict_cycle(predictor, [seen(moved, times[0])], instants)
    np.testing.assert_allclose(here.shapes[0], points[0], atol=1e-5)
    assert here.deviations[0].max() < 1e-2 * here.deviations[1].mean()
    np.testing.assert_allclose(here.shapes @ turn.T + [100.0, -30.0, 5.0], there.shapes, atol=1e-6)
    np.testing.assert_allclose(here.deviations, there.deviations, rtol=1e-6, atol=1e-6)


def test_an_uncertain_phase_predicts_less_surely_and_less_far_from_the_mean(hearts, model):
    predictor = fit_cycle_predictor(model, [0.0])
    scores = 2.0 * np.sqrt(model.total.variances)
    instants = np.array([0.2, 0.4])
    spread = []
    for variance in (1e-6, 4.0):
        covariance = variance * np.diag(model.total.variances)
        phase = fitted_phase(model.total, scores, covariance, 0.0)
        spread.append(predict_cycle(predictor, [phase], instants).deviations.mean())
    assert spread[1] > 1.5 * spread[0]


def test_the_posterior_is_that_of_the_joint_normal_distribution():
    """Against the conditional distribution of one long vector, for a rest with a wide prior."""
    rng = np.random.default_rng(3)
    cycles = rng.normal(size=(4, 3, 2))  # four subjects, one harmonic, two numbers
    wide, given, times = 1e4, np.array([0.1, 0.4]), np.array([0.25, 0.8])
    energies = np.array([wide, 0.3])
    prior = CyclePrior(cycles, energies, 1.0)
    every = np.concatenate([given, times])
    mean, departures = prior.at(every)
    rest = wide + prior.motion(every, every) + 1e-9 * np.eye(4)
    joint = np.einsum("sik,sjl->ikjl", departures, departures)
    joint += np.einsum("ij,kl->ikjl", rest, np.eye(2))
    joint = joint.reshape(8, 8)
    phases = rng.normal(size=(2, 2))
    gain = joint[4:, :4] @ np.linalg.inv(joint[:4, :4])
    expected = mean[2:].ravel() + gain @ (phases - mean[:2]).ravel()
    found = cycle_posterior(prior, given, phases, np.zeros((0, 2, 2)), times)
    np.testing.assert_allclose(found.mean.ravel(), expected, atol=1e-3)
    covariance = joint[4:, 4:] - gain @ joint[:4, 4:]
    variance = (found.shares**2).sum(axis=1) + found.rest_variance[:, None]
    np.testing.assert_allclose(variance.ravel(), np.diag(covariance), rtol=1e-2)
    assert np.isfinite(multivariate_normal(cov=covariance, allow_singular=True).logpdf(np.zeros(4)))


def test_with_few_subjects_the_prior_is_weak_and_with_two_there_is_none(hearts):
    few = slice(0, 4 * PHASES)
    model = fit_dynamic_model(hearts.aligned[few], hearts.ids[few], hearts.weights, hearts.mesh)
    predictor = fit_cycle_predictor(model, [0.0])
    assert predictor.is_weak
    two = slice(0, 2 * PHASES)
    pair = fit_dynamic_model(hearts.aligned[two], hearts.ids[two], hearts.weights, hearts.mesh)
    with pytest.raises(InputError, match="at least 3 training subjects"):
        fit_cycle_predictor(pair, [0.0])
    with pytest.raises(InputError, match="more phases than that"):
        fit_cycle_predictor(model, (np.arange(10) / 10).tolist())
    with pytest.raises(InputError, match="different ones"):
        fit_cycle_predictor(model, [0.1, 1.1])
    with pytest.raises(InputError, match="points of a given phase"):
        predict_cycle(predictor, [seen(np.zeros((3, 3)), 0.0)], np.zeros(1))


def test_the_true_population_has_one_mesh_and_its_cycles_close(hearts):
    assert len(np.unique(hearts.mesh.faces)) == len(hearts.mesh.part)
    assert set(hearts.mesh.loops["LV.mitral"]) == set(hearts.mesh.loops["LA.mitral"])
    np.testing.assert_allclose(hearts.weights.sum(), 1.0)
    n = 4 * PHASES
    model = fit_dynamic_model(hearts.aligned[:n], hearts.ids[:n], hearts.weights, hearts.mesh)
    start, end = mean_cycle(model, np.array([0.0, 1.0]))
    np.testing.assert_allclose(start, end, atol=1e-9)
    assert fourier_design(np.zeros(1), 2).shape == (1, 5)
