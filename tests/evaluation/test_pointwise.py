"""Residues of left-out shapes at every point: against models built shape by shape."""

import numpy as np
import pytest

from ostiform.errors import InputError
from ostiform.evaluation import Division, cross_validation_folds, left_out_point_residues
from ostiform.model import fit_model, mesh_of_template, project, reconstruct
from tests.populations import population


def residues_by_fitting(shapes, modes):
    """The second route: fit every fold's model, project, reconstruct."""
    mesh = mesh_of_template(shapes.template)
    found = np.empty(shapes.aligned.shape[:2])
    for fold in cross_validation_folds(shapes.ids).folds:
        model = fit_model(shapes.aligned[list(fold.train)], shapes.weights, mesh)
        for index in fold.test:
            scores = project(model, shapes.aligned[index])
            scores = np.where(np.arange(len(scores)) < modes, scores, 0.0)
            left = shapes.aligned[index] - reconstruct(model, scores)
            found[index] = np.linalg.norm(left, axis=1)
    return found


@pytest.mark.parametrize(("subjects", "phases"), [(4, 3), (1, 6), (6, 1)])
@pytest.mark.parametrize("modes", [1, 3, 50])
def test_residues_are_those_of_models_fitted_without_the_shape(subjects, phases, modes):
    shapes = population(subjects, phases, np.random.default_rng(2))
    found = left_out_point_residues(shapes.aligned, shapes.weights, shapes.ids, modes)
    expected = residues_by_fitting(shapes, modes)
    np.testing.assert_allclose(found.residues, expected, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(found.rms, np.sqrt((expected**2).mean(axis=0)), rtol=1e-7)


def test_a_shape_that_the_others_span_leaves_nothing():
    shapes = population(4, 1, np.random.default_rng(2))
    first, second = shapes.aligned[0], shapes.aligned[1]
    spanned = np.stack([first, second, 0.5 * (first + second), 2.0 * first - second])
    found = left_out_point_residues(spanned, shapes.weights, shapes.ids, 3)
    np.testing.assert_allclose(found.residues, 0.0, atol=1e-6)


def test_residues_scale_with_the_shapes():
    shapes = population(4, 2, np.random.default_rng(2))
    once = left_out_point_residues(shapes.aligned, shapes.weights, shapes.ids, 2)
    twice = left_out_point_residues(2.0 * shapes.aligned, shapes.weights, shapes.ids, 2)
    np.testing.assert_allclose(twice.residues, 2.0 * once.residues, rtol=1e-9)
    assert once.division is Division.SUBJECTS


def test_too_few_shapes_have_no_residues():
    shapes = population(3, 1, np.random.default_rng(2))
    assert left_out_point_residues(shapes.aligned, shapes.weights, shapes.ids, 2) is None


def test_arrays_that_do_not_fit_are_refused():
    shapes = population(4, 1, np.random.default_rng(2))
    for aligned, weights, ids, modes in (
        (shapes.aligned[1:], shapes.weights, shapes.ids, 2),
        (shapes.aligned, shapes.weights[1:], shapes.ids, 2),
        (shapes.aligned, shapes.weights, shapes.ids, 0),
    ):
        with pytest.raises(InputError, match="expected one identity per shape"):
            left_out_point_residues(aligned, weights, ids, modes)
