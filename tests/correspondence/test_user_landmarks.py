"""Landmarks of the user: an exact gradient, and points that come to lie where the user says."""

from dataclasses import replace

import numpy as np
import pytest

from ostiform.correspondence import CorrespondenceSettings, SurfaceMarks, correspond, place
from ostiform.correspondence.build import shared_metric_of_template
from ostiform.correspondence.fields import flow
from ostiform.correspondence.objective import shape_terms, value
from ostiform.correspondence.shape_step import gradient, start
from ostiform.correspondence.state import WarpState
from ostiform.correspondence.terms.landmarks import (
    LandmarkTerm,
    landmark_term,
    template_marks,
)
from ostiform.errors import InputError
from tests.correspondence.test_shape_step import LEAST_SLOPE, bench
from tests.oracles.warped_shapes import one_part_domain, triangulated, warped_family

NAMES = ("a", "b", "c", "d")
MATERIAL = np.array([[0.5, 0.5, 0.7], [-0.3, -0.9, 0.3], [0.1, 0.95, 0.2], [-0.8, -0.5, 0.2]])
MATERIAL /= np.linalg.norm(MATERIAL, axis=1, keepdims=True)


def marked(family, sd_mm):
    """The shapes of a family with landmarks at their true places."""
    return tuple(
        replace(sampler, marks=SurfaceMarks(NAMES, surface(MATERIAL), np.full(4, sd_mm)))
        for sampler, surface in zip(family.samplers, family.surfaces, strict=True)
    )


def test_the_gradient_of_the_term_has_a_taylor_remainder_of_second_order(rng):
    fine = bench(one_part_domain(), n_vertices=6000, count=4)
    samplers = marked(fine.family, 0.5)
    marks = template_marks(samplers, fine.level.coarse)
    state, sampler = fine.population.states[0], samplers[0]
    level = replace(fine.level, marks=marks)
    terms = shape_terms(fine.forms, level, level.metric, sampler.marks)
    without = shape_terms(fine.forms, level, level.metric, None)
    direction = rng.normal(size=len(fine.level.basis))
    slope = gradient(sampler, state, level, terms, np.eye(4)) @ direction
    bare = gradient(sampler, state, level, without, np.eye(4)) @ direction
    assert abs(slope - bare) > 0.1 * abs(bare)
    steps, remainders = np.array([0.02, 0.01, 0.005]), []
    before = value(terms, state, np.eye(4))
    for step in steps:
        moved = flow(fine.level.basis, fine.level.template, state.directions, step * direction)
        after = value(terms, start(sampler, fine.level, moved), np.eye(4))
        remainders.append(abs(after - before - step * slope))
    assert np.polyfit(np.log(steps), np.log(remainders), 1)[0] > LEAST_SLOPE


def test_the_term_is_its_formula(rng):
    term = LandmarkTerm(
        np.array([[0, 1, 2], [2, 3, 1]]),
        np.array([[0.2, 0.3, 0.5], [0.6, 0.1, 0.3]]),
        rng.normal(size=(2, 3)),
        np.array([4.0, 0.25]),
    )
    points = rng.normal(size=(5, 3))
    expected = 0.0
    for corners, shares, position, precision in zip(
        term.corners, term.barycentric, term.positions, term.precisions, strict=True
    ):
        expected += precision * np.sum((shares @ points[corners] - position) ** 2)
    state = WarpState(points, points)
    np.testing.assert_allclose(term.value(state, np.eye(4)), expected)


@pytest.fixture(scope="module")
def family():
    return warped_family(one_part_domain(), 5, np.random.default_rng(4), n_vertices=1500, warp=0.2)


def correspondence_of(family, samplers):
    settings = CorrespondenceSettings(
        levels=3, n_points=250, n_optimised=250, noise_mm=0.3, sweeps=8, per="shape"
    )
    template = triangulated(family.domain, 250)
    shared = shared_metric_of_template(samplers, family.ids, family.domain, template, settings)
    return correspond(samplers, family.ids, shared, settings)


def misses(samplers, trained, marks):
    """Distance in mm of every shape's landmarks from where its points say that they are."""
    found = []
    for sampler, points in zip(samplers, trained.correspondence.points, strict=True):
        term = landmark_term(marks, sampler.marks)
        placed = np.einsum("lk,lkd->ld", term.barycentric, points[term.corners])
        found.append(np.linalg.norm(placed - term.positions, axis=1))
    return np.array(found)


@pytest.fixture(scope="module")
def outcomes(family):
    plain = correspondence_of(family, family.samplers)
    sharp = correspondence_of(family, marked(family, 0.5))
    blunt = correspondence_of(family, marked(family, 50.0))
    return plain, sharp, blunt


def test_landmarks_draw_the_points_as_strongly_as_they_are_certain(family, outcomes):
    samplers = marked(family, 0.5)
    marks = outcomes[1]["optimal"].frozen.marks
    plain, sharp, blunt = (misses(samplers, one["optimal"], marks).mean() for one in outcomes)
    assert sharp < 0.6 * plain
    np.testing.assert_allclose(blunt, plain, rtol=0.05)


def test_around_true_landmarks_the_correspondence_is_nearer_to_the_truth(family, outcomes):
    errors = []
    for one in outcomes[:2]:
        correspondence = one["optimal"].correspondence
        template = correspondence.template
        near = (template.points @ MATERIAL.T).max(axis=1) > np.cos(0.3)
        weights = correspondence.weights * near
        errors.append(family.error(template, correspondence.directions, weights / weights.sum()))
    assert errors[1] < 0.9 * errors[0], errors


def test_the_conformal_model_is_not_touched(outcomes):
    plain, sharp, _ = outcomes
    np.testing.assert_array_equal(
        plain["conformal"].correspondence.points, sharp["conformal"].correspondence.points
    )


def test_a_shape_placed_later_follows_its_own_landmarks(family, outcomes):
    trained = outcomes[1]["optimal"]
    term = landmark_term(trained.frozen.marks, marked(family, 0.3)[2].marks)

    def miss(sampler):
        points = place([sampler], family.ids[:1], trained.frozen).points[0]
        placed = np.einsum("lk,lkd->ld", term.barycentric, points[term.corners])
        return np.linalg.norm(placed - term.positions, axis=1).mean()

    assert miss(marked(family, 0.3)[2]) < 0.7 * miss(family.samplers[2])


def test_shapes_without_landmarks_take_no_part(family):
    samplers = (*marked(family, 1.0)[:2], *family.samplers[2:])
    marks = template_marks(samplers, triangulated(family.domain, 250))
    assert marks is not None
    assert marks.names == NAMES
    assert landmark_term(marks, samplers[3].marks) is None
    assert landmark_term(None, samplers[0].marks) is None
    unknown = SurfaceMarks(("other",), np.zeros((1, 3)), np.ones(1))
    assert landmark_term(marks, unknown) is None
    assert template_marks(family.samplers, triangulated(family.domain, 250)) is None


def test_a_landmark_without_uncertainty_is_refused():
    with pytest.raises(InputError, match="landmark a: expected a standard deviation above 0"):
        SurfaceMarks(("a",), np.zeros((1, 3)), np.zeros(1))
