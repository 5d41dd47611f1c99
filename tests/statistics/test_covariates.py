"""Columns of a sheet as covariates: types, missing cells, one value per subject."""

import numpy as np
import pytest

from ostiform.errors import InputError
from ostiform.model import StoredModel, fit_model, mesh_of_template, project
from ostiform.statistics import (
    Covariate,
    complete_subjects,
    covariate_of,
    design_of,
    permutations,
    subject_shapes,
    subject_values,
)
from tests.populations import population

ROWS = [
    ("S1", {"age": "61", "sex": "f"}),
    ("S1", {"age": "61", "sex": ""}),
    ("S2", {"age": "NA", "sex": "m"}),
    ("S3", {"age": "48,5", "sex": "m"}),
]


def stored_population(subjects=5, phases=4):
    shapes = population(subjects, phases, np.random.default_rng(3))
    model = fit_model(shapes.aligned, shapes.weights, mesh_of_template(shapes.template))
    return StoredModel(model, project(model, shapes.aligned), shapes.ids, shapes.template)


def test_numbers_are_continuous_and_other_texts_are_categories():
    age, sex = covariate_of("age", ["61", "48,5", "1e1"]), covariate_of("sex", list("fmfm"))
    np.testing.assert_array_equal(age.values, [61.0, 48.5, 10.0])
    assert not age.is_categorical
    assert sex.levels == ("f", "m")
    np.testing.assert_array_equal(sex.values, [0, 1, 0, 1])


def test_numbers_can_be_categories_when_said_so():
    assert covariate_of("group", list("0101"), is_categorical=True).levels == ("0", "1")


def test_a_cell_of_any_phase_speaks_for_the_subject():
    assert subject_values(ROWS, "sex") == {"S1": "f", "S2": "m", "S3": "m"}


def test_subjects_without_a_value_are_left_out_with_the_reason():
    columns = {name: subject_values(ROWS, name) for name in ("age", "sex")}
    kept, left_out = complete_subjects(["S1", "S2", "S3", "S4"], columns)
    assert kept == ["S1", "S3"]
    assert left_out == {"S2": "no value of age", "S4": "no value of age, sex"}


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: subject_values(ROWS, "height"), "found age, sex"),
        (lambda: subject_values([("S1", {})], "age"), "no further columns"),
        (lambda: subject_values([*ROWS, ("S3", {"age": "50"})], "age"), "48,5 and 50 for subject"),
        (lambda: covariate_of("age", ["1", "x"], is_categorical=False), 'found "x"'),
        (lambda: covariate_of("age", ["1", "1"]), "found only 1"),
        (lambda: covariate_of("age", []), "found no subject"),
        (lambda: covariate_of("sex", ["f", "f", "m"]), 'found 1 in "m"'),
        (lambda: covariate_of("age", ["1", "inf", "inf"]), 'found 1 in "1"'),
        (lambda: Covariate("age", np.array([np.nan])), "finite"),
        (lambda: permutations(5, 0, np.random.default_rng(0)), "at least 1, found 0"),
    ],
)
def test_columns_are_refused(call, message):
    with pytest.raises(InputError, match=message):
        call()


def test_a_covariate_that_the_others_explain_is_refused():
    age = Covariate("age", np.arange(6.0))
    months = Covariate("months", 12.0 * np.arange(6.0) + 3.0)
    with pytest.raises(InputError, match="age adjusted for months"):
        design_of(age, [months])


def test_more_columns_than_subjects_are_refused():
    with pytest.raises(InputError, match="more subjects"):
        design_of(Covariate("age", np.array([1.0, 2.0])))


def test_coefficients_are_those_of_the_normal_equations(rng):
    age, dose = Covariate("age", rng.normal(size=12)), Covariate("dose", rng.normal(size=12))
    values = rng.normal(size=(12, 4, 3))
    both = np.column_stack([np.ones(12), dose.values, age.values])
    flat = np.linalg.solve(both.T @ both, both.T @ values.reshape(12, -1))
    found = design_of(age, [dose]).coefficients(values)
    np.testing.assert_allclose(found, flat[2:].reshape(1, 4, 3), atol=1e-12)


def test_the_bases_of_a_design_are_orthonormal_and_span_it(rng):
    group = covariate_of("group", list("aabbccab"))
    design = design_of(group, [Covariate("age", rng.normal(size=8))])
    nuisance, interest = design.bases()
    both = np.concatenate([nuisance, interest], axis=1)
    np.testing.assert_allclose(both.T @ both, np.eye(4), atol=1e-12)
    for columns, basis in ((design.nuisance, nuisance), (design.interest, both)):
        np.testing.assert_allclose(basis @ (basis.T @ columns), columns, atol=1e-12)
    assert design.degrees == 4


def test_a_subject_counts_once_by_its_mean_over_the_cycle():
    stored = stored_population()
    shapes = subject_shapes(stored)
    assert shapes.subjects == tuple(f"subject {s}" for s in range(5))
    # The phases are evenly spaced, so the mean over the cycle is the plain mean.
    expected = stored.scores.reshape(5, 4, -1).mean(axis=1)
    np.testing.assert_allclose(shapes.scores, expected, atol=1e-10)
    assert shapes.what == "mean over the cycle"


def test_one_phase_can_stand_for_a_subject():
    stored = stored_population()
    shapes = subject_shapes(stored, "ph02")
    np.testing.assert_array_equal(shapes.scores, stored.scores[2::4])
    chosen = shapes.chosen(["subject 3", "subject 1"])
    np.testing.assert_array_equal(chosen.scores, stored.scores[[14, 6]])


def test_subjects_without_scores_or_phase_are_refused():
    stored = stored_population(3, 2)
    with pytest.raises(InputError, match="found ph09"):
        subject_shapes(stored, "ph09")
    bare = StoredModel(stored.model, np.empty((0, len(stored.model.modes))), (), None)
    with pytest.raises(InputError, match="found none in it"):
        subject_shapes(bare)
