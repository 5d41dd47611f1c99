"""Residues of left-out shapes, their comparison, and the files they are kept in."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy import stats

from ostiform.errors import ArtifactError, InputError
from ostiform.evaluation import (
    MODE_COUNTS,
    Division,
    Evaluation,
    OriginalMesh,
    PlacedFold,
    TruthDistance,
    compare,
    compared_surface,
    cross_validated,
    cross_validation_folds,
    evaluate_model,
    fold_residues,
    paired_difference,
    read_evaluation,
    shape_residues,
    write_comparisons,
    write_evaluation,
)
from ostiform.model import fit_model, mesh_of_template, project, reconstruct
from tests.populations import population


@pytest.fixture(scope="module")
def shapes():
    return population(4, 3, np.random.default_rng(21))


def originals_of(shapes):
    return [OriginalMesh(points, shapes.template.faces) for points in shapes.points]


def surface_of(shapes, index):
    return compared_surface(shapes.points[index], shapes.template.faces)


def place(shapes, fold, noise=0.0):
    """Build from the training shapes; the left-out ones lie where the population put them."""
    train, test = list(fold.train), list(fold.test)
    rng = np.random.default_rng(1)
    wrong = shapes.aligned[train] + noise * rng.normal(size=shapes.aligned[train].shape)
    mesh = mesh_of_template(shapes.template)
    for kind, aligned in (("conformal", wrong), ("optimal", shapes.aligned[train])):
        yield (
            kind,
            PlacedFold(aligned, shapes.weights, mesh, shapes.points[test], shapes.transforms[test]),
        )


@pytest.fixture(scope="module")
def generalisations(shapes):
    folds = cross_validation_folds(shapes.ids)
    originals = originals_of(shapes)
    return cross_validated(
        folds,
        (
            fold_residues(
                fold, partial(place, shapes, noise=2.0), [originals[i] for i in fold.test]
            )
            for fold in folds.folds
        ),
    )


@pytest.fixture(scope="module")
def evaluations(shapes, generalisations):
    mesh = mesh_of_template(shapes.template)
    rng = np.random.default_rng(3)
    noisy = replace(shapes, aligned=shapes.aligned + rng.normal(size=shapes.aligned.shape))
    return {
        kind: evaluate_model(
            kind,
            fit_model(found.aligned, shapes.weights, mesh),
            (found, shapes),
            originals_of(shapes),
            l_cut=0.01,
            seed=4,
            generalisation=generalisations[kind],
            truth=TruthDistance(mean, 2.0, {"LV": (mean, 1.0), "LA": (2.0, 3.0)}),
        )
        for kind, found, mean in (("conformal", noisy, 2.0), ("optimal", shapes, 1.0))
    }


def test_the_point_residue_is_the_weighted_distance_from_the_projection(shapes):
    train = shapes.aligned[3:]
    model = fit_model(train, shapes.weights, mesh_of_template(shapes.template))
    found = shape_residues(model, shapes.points[0], shapes.transforms[0], surface_of(shapes, 0))
    for count in MODE_COUNTS:
        scores = project(model, shapes.aligned[0])[:count]
        squared = ((reconstruct(model, scores) - shapes.aligned[0]) ** 2).sum(axis=1)
        np.testing.assert_allclose(found.point[count], np.sqrt(shapes.weights @ squared), rtol=1e-9)


def test_the_point_residue_never_rises_with_the_number_of_modes(generalisations):
    for found in generalisations.values():
        assert (np.diff(found.point, axis=1) <= 1e-12).all()


def test_a_shape_inside_the_span_of_the_model_leaves_nothing(shapes):
    model = fit_model(shapes.aligned, shapes.weights, mesh_of_template(shapes.template))
    found = shape_residues(
        model, shapes.points[5], shapes.transforms[5], surface_of(shapes, 5), (0, 11)
    )
    assert found.point[0] > 1.0
    for values in (found.point, found.surface_mean, found.surface_p95, found.surface_max):
        assert values[1] < 1e-9


def test_more_modes_than_the_model_has_change_nothing(shapes):
    model = fit_model(shapes.aligned[:4], shapes.weights, mesh_of_template(shapes.template))
    found = shape_residues(
        model, shapes.points[5], shapes.transforms[5], surface_of(shapes, 5), (3, 4, 10)
    )
    np.testing.assert_array_equal(found.surface_mean, found.surface_mean[0])


def test_residues_are_millimetres_of_the_input_whatever_the_alignment_scales(shapes):
    mesh = mesh_of_template(shapes.template)
    scale = np.diag([0.5, 0.5, 0.5, 1.0])
    plain, scaled = (
        shape_residues(
            fit_model(factor * shapes.aligned[3:], shapes.weights, mesh),
            shapes.points[0],
            transform @ shapes.transforms[0],
            surface_of(shapes, 0),
        )
        for factor, transform in ((1.0, np.eye(4)), (0.5, scale))
    )
    for name in ("point", "surface_mean", "surface_p95", "surface_max"):
        np.testing.assert_allclose(getattr(scaled, name), getattr(plain, name), rtol=1e-8)


def test_every_shape_gets_the_residues_of_its_own_fold(shapes, generalisations):
    fold = cross_validation_folds(shapes.ids).folds[2]
    train, test = list(fold.train), fold.test[1]
    model = fit_model(shapes.aligned[train], shapes.weights, mesh_of_template(shapes.template))
    direct = shape_residues(
        model, shapes.points[test], shapes.transforms[test], surface_of(shapes, test)
    )
    found = generalisations["optimal"]
    np.testing.assert_array_equal(found.surface_p95[test], direct.surface_p95)
    assert found.division is Division.SUBJECTS


def test_folds_that_do_not_fit_are_refused(shapes):
    folds = cross_validation_folds(shapes.ids)
    with pytest.raises(InputError, match="results of 4 folds"):
        cross_validated(folds, [])
    with pytest.raises(InputError, match="original meshes"):
        fold_residues(folds.folds[0], partial(place, shapes), [])


def test_a_kind_missing_in_one_fold_is_refused(shapes, generalisations):
    folds = cross_validation_folds(shapes.ids)
    residue = shape_residues(
        fit_model(shapes.aligned, shapes.weights, mesh_of_template(shapes.template)),
        shapes.points[0],
        shapes.transforms[0],
        surface_of(shapes, 0),
    )
    results = [{"optimal": [residue] * 3} for _ in range(3)] + [{"conformal": [residue] * 3}]
    with pytest.raises(InputError, match="optimal model: expected residues of 12"):
        cross_validated(folds, results)


def test_the_interval_is_student_s_over_the_means_of_the_subjects(rng):
    subjects = ["a", "a", "b", "c", "c", "c", "d"]
    differences = rng.normal(size=7)
    means = [differences[:2].mean(), differences[2], differences[3:6].mean(), differences[6]]
    found = paired_difference(differences, subjects)
    low, high = stats.t.interval(0.95, 3, loc=np.mean(means), scale=stats.sem(means))
    np.testing.assert_allclose([found.mean, found.low, found.high], [np.mean(means), low, high])
    assert found.subjects == 4


def test_the_interval_holds_the_truth_as_often_as_it_says():
    rng = np.random.default_rng(0)
    held = [
        found.low <= 1.0 <= found.high
        for found in (
            paired_difference(1.0 + rng.normal(size=5), ["a", "b", "c", "d", "e"])
            for _ in range(2000)
        )
    ]
    assert abs(np.mean(held) - 0.95) < 4.0 * np.sqrt(0.95 * 0.05 / 2000)  # four standard errors


def test_no_interval_is_given_where_none_can_be():
    for found in (
        paired_difference(np.ones(4), ["a", "a", "b", "b"]),
        paired_difference(np.ones(4), ["a", "b", "c", "d"], with_interval=False),
    ):
        assert (found.mean, found.low, found.high) == (1.0, None, None)


def test_differences_without_subjects_are_refused():
    with pytest.raises(InputError, match="one subject for each"):
        paired_difference(np.ones(3), ["a"])


def test_the_comparison_says_which_model_is_better(shapes, evaluations, generalisations):
    found = compare(evaluations["optimal"], evaluations["conformal"])
    totals = [evaluations[kind].compactness.total for kind in ("optimal", "conformal")]
    np.testing.assert_allclose(found.variance_gain, 1.0 - totals[0] / totals[1])
    assert found.variance_gain > 0.0
    assert found.paper_gain == 0.67
    assert found.description_length_difference > 0.0
    assert found.specificity_difference > 0.0
    assert found.truth_ratio == {"all": 0.5, "LV": 0.5, "LA": 1.0}
    mine, theirs = (generalisations[kind].surface_mean for kind in ("optimal", "conformal"))
    np.testing.assert_allclose(
        found.residues.surface_over_modes.mean, (theirs - mine)[:, 1:].mean(), rtol=1e-9
    )
    np.testing.assert_allclose(
        found.residues.worst_ratio,
        max(mine[:, m].mean() / theirs[:, m].mean() for m in range(1, 11)),
    )
    assert found.residues.surface[3].low is not None


def test_comparing_the_other_way_turns_every_sign(evaluations):
    one = compare(evaluations["optimal"], evaluations["conformal"])
    two = compare(evaluations["conformal"], evaluations["optimal"])
    np.testing.assert_allclose(
        two.description_length_difference, -one.description_length_difference
    )
    np.testing.assert_allclose(two.residues.point[2].mean, -one.residues.point[2].mean)
    assert two.paper_gain is None


def test_a_model_compared_with_itself_gains_nothing(evaluations):
    found = compare(evaluations["optimal"], evaluations["optimal"])
    assert found.variance_gain == found.description_length_difference == 0.0
    assert found.coverage_ratio == found.residues.worst_ratio == 1.0


def test_models_of_other_shared_metrics_are_not_compared(evaluations):
    model = evaluations["optimal"]
    with pytest.raises(InputError, match="same l_cut"):
        compare(model, replace(evaluations["conformal"], l_cut=1.0))
    other = replace(model.generalisation, division=Division.PHASE_BLOCKS)
    with pytest.raises(InputError, match="same folds"):
        compare(model, replace(evaluations["conformal"], generalisation=other))


def test_phase_blocks_get_no_interval(evaluations):
    blocks = {
        kind: replace(
            found,
            generalisation=replace(found.generalisation, division=Division.PHASE_BLOCKS),
        )
        for kind, found in evaluations.items()
    }
    found = compare(blocks["optimal"], blocks["conformal"])
    assert found.residues.surface[1].low is None


def test_evaluations_without_left_out_shapes_are_compared_without_residues(evaluations):
    bare = replace(evaluations["optimal"], generalisation=None, truth=None)
    found = compare(bare, evaluations["conformal"])
    assert found.residues is None
    assert not found.truth_ratio


def test_an_evaluation_of_other_shapes_is_refused(shapes, evaluations):
    with pytest.raises(InputError, match="coverage of 12"):
        replace(evaluations["optimal"], coverage=())
    with pytest.raises(InputError, match="same shapes"):
        evaluate_model(
            "optimal",
            fit_model(shapes.aligned, shapes.weights, mesh_of_template(shapes.template)),
            (shapes, shapes),
            [],
            0.01,
            0,
        )


def assert_same_evaluation(actual: Evaluation, expected: Evaluation):
    assert (actual.kind, actual.ids, actual.l_cut) == (expected.kind, expected.ids, expected.l_cut)
    assert actual.description_length == expected.description_length
    assert actual.coverage == expected.coverage
    np.testing.assert_array_equal(actual.compactness.variances, expected.compactness.variances)
    np.testing.assert_array_equal(actual.specificity.mean, expected.specificity.mean)
    if expected.generalisation is None or expected.truth is None:
        assert actual.generalisation is None
        assert actual.truth is None
        return
    for name in ("mode_counts", "point", "surface_mean", "surface_p95", "surface_max"):
        np.testing.assert_array_equal(
            getattr(actual.generalisation, name), getattr(expected.generalisation, name)
        )
    assert actual.generalisation.division is expected.generalisation.division
    assert (actual.truth.mean, actual.truth.p95) == (expected.truth.mean, expected.truth.p95)
    assert dict(actual.truth.parts) == dict(expected.truth.parts)


def test_an_evaluation_file_keeps_every_number(tmp_path, evaluations):
    bare = replace(evaluations["optimal"], generalisation=None, truth=None)
    for expected in (evaluations["conformal"], bare):
        write_evaluation(tmp_path / "evaluation.json", expected)
        assert_same_evaluation(read_evaluation(tmp_path / "evaluation.json"), expected)


def test_a_comparison_is_written_with_its_units(tmp_path, evaluations):
    path = tmp_path / "comparison.json"
    write_comparisons(path, [compare(evaluations["optimal"], evaluations["conformal"])])
    text = path.read_text()
    for word in ('"units": "mm"', '"schema": 1', '"paper_gain": 0.67', '"worst_ratio"'):
        assert word in text


@pytest.mark.parametrize("content", [None, "{", "{}", '{"schema": 99}', "[]"])
def test_what_is_no_evaluation_is_refused(tmp_path, content):
    path = tmp_path / "evaluation.json"
    if content is not None:
        path.write_text(content)
    with pytest.raises(ArtifactError, match="expected an evaluation"):
        read_evaluation(path)
