"""A planted effect is found, at the points where it was planted, with few false ones."""

import numpy as np
import pytest

from ostiform.errors import InputError
from ostiform.model import StoredModel, fit_model, mesh_of_template, project
from ostiform.statistics import (
    Covariate,
    EffectSettings,
    covariate_of,
    design_of,
    permutations,
    point_test,
    shape_effect,
    subject_shapes,
)
from tests.populations import population

SUBJECTS = 24


@pytest.fixture(scope="module")
def planted():
    """Subjects in three phases; in every second one the northern cap is moved north by 6 mm."""
    rng = np.random.default_rng(11)
    shapes = population(SUBJECTS, 3, rng)
    group = [["control", "patient"][s % 2] for s in range(SUBJECTS)]
    age = rng.uniform(30.0, 70.0, size=SUBJECTS)
    north = shapes.template.points[:, 2] > 0.6
    aligned = np.array(shapes.aligned)
    for index in range(len(aligned)):
        subject = index // 3
        unaffected = np.linalg.norm(aligned[index], axis=1, keepdims=True)
        aligned[index] *= 1.0 + 0.3 / unaffected * (age[subject] - 50.0) / 10.0
        if group[subject] == "patient":
            aligned[index, north, 2] += 6.0
    model = fit_model(aligned, shapes.weights, mesh_of_template(shapes.template))
    stored = StoredModel(model, project(model, aligned), shapes.ids, shapes.template)
    return stored, covariate_of("group", group), Covariate("age", age), north


@pytest.fixture(scope="module")
def effect(planted):
    stored, group, age, _ = planted
    settings = EffectSettings(permutations=1999, seed=5)
    return shape_effect(stored.model, subject_shapes(stored), group, [age], settings)


def test_the_planted_difference_is_found_where_it_is(planted, effect):
    north = planted[3]
    found = effect.points.q_value <= 0.05
    assert effect.whole.p_value <= 0.05
    assert found[north].mean() > 0.9
    assert found[~north].sum() <= 0.05 * found.sum() + 3.0
    assert (effect.points.family_p_value[north] <= 0.05).mean() > 0.7
    assert (effect.points.family_p_value >= effect.points.p_value).all()
    assert (effect.points.q_value >= effect.points.p_value).all()


def test_the_size_and_direction_of_the_effect_are_those_planted(planted, effect):
    north = planted[3]
    assert effect.design.names == ("group: patient - control",)
    # Two groups of 12 with a standard deviation of some 5 mm between subjects, north to south.
    np.testing.assert_allclose(effect.coefficients[0][north, 2].mean(), 6.0, atol=3.0)
    jump = effect.coefficients[0][north, 2].mean() - effect.coefficients[0][~north, 2].mean()
    assert jump > 4.0
    assert (effect.normal_coefficients[0][north] > 0.0).mean() > 0.9


def test_fitted_shapes_differ_by_the_effect_and_average_to_the_mean(effect):
    control, patient = effect.shape_at("control"), effect.shape_at("patient")
    np.testing.assert_allclose(patient - control, effect.coefficients[0], atol=1e-9)
    np.testing.assert_allclose(0.5 * (control + patient), effect.shape_mean, atol=1e-9)
    with pytest.raises(InputError, match="expected one of control, patient, found else"):
        effect.shape_at("else")


def test_a_covariate_is_found_and_its_slope_is_per_unit(planted):
    stored, group, age, _ = planted
    settings = EffectSettings(permutations=499, movement="normal")
    found = shape_effect(stored.model, subject_shapes(stored), age, [group], settings)
    np.testing.assert_allclose(found.normal_coefficients[0].mean(), 0.03, atol=0.1)
    step = found.shape_at(60.0) - found.shape_at(50.0)
    np.testing.assert_allclose(step, 10.0 * found.coefficients[0], atol=1e-9)
    mean = found.shape_at(float(age.values.mean()))
    np.testing.assert_allclose(mean, found.shape_mean, atol=1e-9)


def test_equal_seeds_give_equal_answers_and_others_nearly_so(planted):
    stored, group, _, _ = planted
    shapes = subject_shapes(stored)
    first, again, other = (
        shape_effect(stored.model, shapes, group, (), EffectSettings(permutations=499, seed=seed))
        for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first.points.p_value, again.points.p_value)
    np.testing.assert_array_equal(first.points.statistic, other.points.statistic)
    # Five standard errors of a share of 499.
    assert np.abs(first.points.p_value - other.points.p_value).max() < 5 * np.sqrt(0.5 / 499)


def test_a_wrong_question_is_refused(planted):
    stored, group, age, _ = planted
    shapes = subject_shapes(stored)
    with pytest.raises(InputError, match="one value for each of 10"):
        shape_effect(stored.model, shapes.chosen(shapes.subjects[:10]), group, [age])
    sideways = EffectSettings(movement="sideways")  # type: ignore[arg-type]
    with pytest.raises(InputError, match='found "sideways"'):
        shape_effect(stored.model, shapes, group, (), sideways)


def test_false_discoveries_among_the_points_found_stay_within_the_level():
    shares, hits = [], []
    for seed in range(100):
        rng = np.random.default_rng([1995, seed])
        values = rng.normal(size=(24, 100, 3)) + 0.5 * rng.normal(size=(24, 1, 3))
        values[::2, :20, 0] += 2.5
        design = design_of(covariate_of("group", ["a", "b"] * 12))
        test = point_test(values, design, permutations(24, 399, rng))
        found = test.q_value <= 0.1
        shares.append(found[20:].sum() / max(1, found.sum()))
        hits.append(found[:20].mean())
    error = np.std(shares) / np.sqrt(len(shares))
    assert np.mean(shares) < 0.1 + 3.0 * error
    assert np.mean(hits) > 0.8
