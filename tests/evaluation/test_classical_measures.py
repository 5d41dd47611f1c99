"""Classical measures and specificity to the surface against routes that form every model."""

import csv

import numpy as np
import pytest

from ostiform.errors import ArtifactError, InputError
from ostiform.evaluation import (
    OriginalMesh,
    classical,
    classical_measures,
    evaluate_model,
    evaluation_facts,
    evaluation_from_facts,
    evaluation_rows,
    specificity_to_surface,
    surface_distances,
    surface_specificity,
    write_evaluation_table,
)
from ostiform.evaluation.table import COLUMNS
from ostiform.model import fit_model, mesh_of_template, reconstruct, sample_scores
from tests.populations import ellipsoids, population, two_part_template


def decomposed(shapes):
    """Return mean, modes (rows) and variances by the singular value decomposition."""
    flat = shapes.reshape(len(shapes), -1)
    mean = flat.mean(axis=0)
    _, singular, right = np.linalg.svd(flat - mean, full_matrices=False)
    keep = len(flat) - 1
    return mean, right[:keep], singular[:keep] ** 2 / (len(flat) - 1.0)


def mean_distance(one, two):
    return np.linalg.norm((one - two).reshape(-1, 3), axis=1).mean()


def test_generalisation_is_the_mean_distance_from_the_others_reconstruction():
    aligned = population(3, 3, np.random.default_rng(4)).aligned
    found = classical_measures(aligned, np.random.default_rng(0), 10, (1, 3))
    np.testing.assert_array_equal(found.mode_counts, [1, 3, 7])
    expected = np.empty((len(aligned), 3))
    for index, shape in enumerate(aligned.reshape(len(aligned), -1)):
        mean, modes, _ = decomposed(np.delete(aligned, index, axis=0))
        for column, count in enumerate((1, 3, 7)):
            scores = modes[:count] @ (shape - mean)
            expected[index, column] = mean_distance(shape, mean + scores @ modes[:count])
    np.testing.assert_allclose(found.generalisation, expected.mean(axis=0), rtol=1e-6)
    np.testing.assert_allclose(
        found.generalisation_error, expected.std(axis=0, ddof=1) / 3.0, rtol=1e-6
    )


def test_compactness_is_the_cumulative_variance_per_point():
    aligned = population(3, 3, np.random.default_rng(4)).aligned
    found = classical_measures(aligned, np.random.default_rng(0), 10, (1, 2))
    _, _, variances = decomposed(aligned)
    expected = np.cumsum(variances)[[0, 1, 6]] / aligned.shape[1]
    np.testing.assert_allclose(found.compactness, expected, rtol=1e-9)


def test_specificity_is_the_mean_distance_of_random_shapes_from_the_nearest():
    aligned = population(3, 3, np.random.default_rng(4)).aligned
    found = classical_measures(aligned, np.random.default_rng(5), 400, (2,))
    mean, modes, variances = decomposed(aligned)
    rng = np.random.default_rng(6)  # other draws: two estimates of the same number
    flat = aligned.reshape(len(aligned), -1)
    near = []
    for _ in range(400):
        scores = rng.standard_normal(2) * np.sqrt(variances[:2])
        near.append(min(mean_distance(mean + scores @ modes[:2], shape) for shape in flat))
    error = np.hypot(found.specificity_error[0], np.std(near, ddof=1) / 20.0)
    assert abs(found.specificity[0] - np.mean(near)) < 3.5 * error


def test_a_population_of_one_mode_is_reconstructed_exactly():
    template = two_part_template()
    axes = np.column_stack([np.full((6, 2), 40.0), np.linspace(40.0, 60.0, 6)])
    found = classical_measures(ellipsoids(template.points, axes), np.random.default_rng(0), 10)
    np.testing.assert_allclose(found.generalisation, 0.0, atol=1e-5)
    np.testing.assert_allclose(found.compactness[0], found.compactness[-1], rtol=1e-9)


def test_of_many_shapes_only_some_are_left_out(monkeypatch):
    from ostiform.evaluation import classical

    aligned = population(4, 5, np.random.default_rng(4)).aligned
    whole = classical_measures(aligned, np.random.default_rng(0), 10)
    monkeypatch.setattr(classical, "MOST_LEFT_OUT", 10)
    some = classical_measures(aligned, np.random.default_rng(0), 10)
    np.testing.assert_allclose(some.generalisation, whole.generalisation, rtol=0.5)
    assert (some.generalisation_error > whole.generalisation_error).any()


def test_of_very_many_shapes_some_stand_for_all(monkeypatch):
    aligned = population(6, 3, np.random.default_rng(4)).aligned
    monkeypatch.setattr(classical, "MOST_SHAPES", 7)
    found = classical_measures(aligned, np.random.default_rng(0), 10)
    chosen = aligned[[0, 3, 6, 8, 11, 14, 17]]
    expected = classical_measures(chosen, np.random.default_rng(0), 10)
    np.testing.assert_array_equal(found.generalisation, expected.generalisation)
    np.testing.assert_array_equal(found.mode_counts, [1, 2, 3, 5])


def test_classical_measures_of_two_shapes_are_refused():
    aligned = population(2, 1, np.random.default_rng(4)).aligned
    with pytest.raises(InputError, match="at least 3 shapes"):
        classical_measures(aligned, np.random.default_rng(0))


DIGITS = 1e-5  # relative: tables have six significant digits


@pytest.fixture(scope="module")
def trained():
    template = two_part_template(13, 24)
    shapes = population(3, 3, np.random.default_rng(5), template)
    model = fit_model(shapes.aligned, shapes.weights, mesh_of_template(shapes.template))
    originals = [OriginalMesh(points, shapes.template.faces) for points in shapes.points]
    return shapes, model, originals


def test_specificity_to_the_surface_finds_the_nearest_of_all_surfaces(trained):
    shapes, model, originals = trained
    found = surface_specificity(
        model, shapes.aligned, shapes.transforms, originals, np.random.default_rng(8), 20
    )
    scores = sample_scores(model, 20, np.random.default_rng(8), limit=3.0)
    every = np.stack(
        [
            [d.mean for d in surface_distances(
                reconstruct(model, scores), model.mesh.faces, surface, model.mesh.faces
            )]
            for surface in shapes.aligned
        ]
    )  # fmt: skip
    np.testing.assert_allclose(found.distances, every.min(axis=0), rtol=1e-6)
    np.testing.assert_allclose(found.mean, found.distances.mean())
    np.testing.assert_allclose(
        found.standard_error, found.distances.std(ddof=1) / np.sqrt(20), rtol=1e-12
    )


def test_preselected_shapes_hold_the_nearest_ones(trained, monkeypatch):
    shapes, model, originals = trained
    given = (model, shapes.aligned, shapes.transforms, originals)
    every = surface_specificity(*given, np.random.default_rng(8), 20)
    monkeypatch.setattr(specificity_to_surface, "PRESELECTED", 6)
    some = surface_specificity(*given, np.random.default_rng(8), 20)
    np.testing.assert_allclose(some.distances, every.distances, rtol=1e-12)


def test_specificity_to_the_surface_does_not_see_points_that_slide_along_it(trained):
    template = two_part_template(17, 32)
    turns = np.radians([-6.0, 0.0, 6.0])
    shapes = np.stack(
        [
            40.0 * np.column_stack(
                [
                    np.cos(t) * template.points[:, 0] - np.sin(t) * template.points[:, 1],
                    np.sin(t) * template.points[:, 0] + np.cos(t) * template.points[:, 1],
                    template.points[:, 2],
                ]
            )
            for t in turns
        ]
    )  # fmt: skip
    weights = np.full(len(template.points), 1.0 / len(template.points))
    model = fit_model(shapes, weights, mesh_of_template(template))
    originals = [OriginalMesh(shape, template.faces) for shape in shapes]
    still = np.broadcast_to(np.eye(4), (3, 4, 4))
    rng = np.random.default_rng(1)
    found = surface_specificity(model, shapes, still, originals, rng, 20)
    assert found.mean < 0.15 * np.sqrt(model.total_variance)


def test_specificity_to_the_surface_needs_all_surfaces_and_some_samples(trained):
    shapes, model, originals = trained
    for given, count in ((originals[:-1], 20), (originals, 1)):
        with pytest.raises(InputError, match="as many transforms and originals"):
            surface_specificity(
                model, shapes.aligned, shapes.transforms, given, np.random.default_rng(8), count
            )


@pytest.fixture(scope="module")
def evaluation(trained):
    shapes, model, originals = trained
    return evaluate_model("optimal", model, (shapes, shapes), originals, 0.01, 0)


def test_an_evaluation_survives_json_with_all_that_was_measured(evaluation):
    facts = evaluation_facts(evaluation)
    assert evaluation_facts(evaluation_from_facts(facts)) == facts
    for key in ("spread", "surface_specificity", "classical"):
        assert facts[key] is not None


def test_an_evaluation_of_an_earlier_version_is_read_without_the_newer_measures(evaluation):
    facts = evaluation_facts(evaluation)
    for key in ("spread", "surface_specificity", "classical"):
        del facts[key]
    found = evaluation_from_facts(facts)
    assert found.spread is None
    assert found.surface_specificity is None
    assert found.classical is None


def test_the_table_has_every_number_of_modes_once(evaluation, tmp_path):
    path = tmp_path / "evaluation.csv"
    write_evaluation_table(path, [evaluation])
    with path.open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert tuple(rows[0]) == COLUMNS
    modes = [int(row["modes"]) for row in rows]
    assert modes == sorted(set(modes))
    by_modes = dict(zip(modes, rows, strict=True))
    last = by_modes[len(evaluation.compactness.variances)]
    np.testing.assert_allclose(
        float(last["specificity_surface_mm"]), evaluation.surface_specificity.mean, DIGITS
    )
    np.testing.assert_allclose(
        float(by_modes[2]["classical_generalisation_mm"]),
        evaluation.classical.generalisation[1],
        DIGITS,
    )
    assert by_modes[0]["cumulative_variance_mm2"] == ""
    assert len(evaluation_rows(evaluation)) == len(rows)


def test_a_table_that_cannot_be_written_says_so(evaluation, tmp_path):
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(ArtifactError):
        write_evaluation_table(tmp_path / "file" / "evaluation.csv", [evaluation])
