"""The comparison of methods in `benchmarks/` judges by what it says."""

from dataclasses import fields

import numpy as np
import pytest

from benchmarks.compare import COLUMNS, header, moved_points, row
from benchmarks.judging import Verdict, polyline_distances, summary
from ostiform.evaluation import OriginalMesh
from tests.populations import area_weights, two_part_template


def verdict(**known) -> Verdict:
    return Verdict(**({field.name: 1.0 for field in fields(Verdict)} | known))


def test_the_worst_of_several_verdicts_is_the_largest_or_the_ratio_furthest_from_one():
    verdicts = [
        verdict(error=error, normal=normal)
        for error, normal in ((0.7, 0.5), (0.9, 1.6), (0.8, 1.0))
    ]
    worst, median = summary(verdicts, "worst"), summary(verdicts, "median")
    assert (worst.error, worst.normal) == (0.9, 0.5)
    assert (median.error, median.normal) == (0.8, 1.0)


def test_what_was_measured_on_one_seed_only_is_summarised_from_that():
    found = summary([verdict(residue=0.4), verdict(residue=np.nan)], "median")
    assert found.residue == 0.4


def test_a_row_has_a_cell_for_every_title_and_leaves_out_what_was_not_measured():
    title = header("population").splitlines()[0]
    cells = row(["atria"], verdict(residue=np.nan))
    assert title.count("|") == cells.count("|") == len(COLUMNS) + 2
    assert "nan" not in cells


def test_runs_with_the_same_correspondence_have_not_moved(rng):
    template = two_part_template()
    shapes = template.points * rng.uniform(30.0, 50.0, size=(4, 1, 3))
    weights = area_weights(template.points, template.faces)
    originals = [OriginalMesh(shape, template.faces) for shape in shapes]
    moved = moved_points(shapes, shapes, weights, template.faces, originals)
    np.testing.assert_allclose(moved, 0.0, atol=1e-9)


def test_a_shape_whose_points_moved_is_seen_by_all_its_pairs():
    template = two_part_template(33, 48)
    shapes = np.repeat(40.0 * template.points[None], 3, axis=0)
    turn = 2.0 * np.pi / 48.0
    rotation = np.array(
        [[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]]
    )
    other = shapes.copy()
    other[0] = shapes[0] @ rotation.T  # onto the next column: the same surface
    weights = area_weights(template.points, template.faces)
    distance = np.linalg.norm(other[0] - shapes[0], axis=1) @ weights
    # From shape 0 both others are missed by one column, from each other shape only shape 0.
    expected = distance * (2.0 + 1.0 + 1.0) / 6.0
    originals = [OriginalMesh(shape, template.faces) for shape in shapes]
    moved = moved_points(shapes, other, weights, template.faces, originals)
    np.testing.assert_allclose(moved, expected, rtol=1e-6)


def test_distances_from_a_polyline_are_to_its_edges_not_its_vertices():
    square = np.array([[0.0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0], [0, 0, 0]])
    points = np.array([[1.0, 0.0, 0.0], [1.0, -0.5, 0.0], [-3.0, -4.0, 0.0], [1.0, 1.0, 1.0]])
    found = polyline_distances(points, square)
    np.testing.assert_allclose(found, [0.0, 0.5, 5.0, np.sqrt(2.0)], atol=1e-12)


@pytest.mark.parametrize("kind", ["median", "worst"])
def test_a_summary_of_one_verdict_is_that_verdict(kind):
    one = verdict(error=0.3, tangential=1.4)
    assert summary([one], kind) == one
