"""Shape by shape: who stands out, in what order, and the kink across seams after the warps."""

import re
from dataclasses import replace

import numpy as np
import pytest

from ostiform.domain import BaseDomain, Circle, Sphere
from ostiform.embedding import Certificate, Distortion
from ostiform.evaluation import Coverage, evaluate_model, left_out_point_residues
from ostiform.evaluation.generalisation import OriginalMesh
from ostiform.evaluation.map_records import (
    ANGLE_EDGES,
    AREA_EDGES,
    ComponentRecord,
    MapRecord,
    sampled_kinks,
)
from ostiform.model import StoredModel, fit_model, mesh_of_template, project
from ostiform.report import FailedShape, ReadShape, quality_section
from ostiform.report.quality import MOST_PICTURES, flagged_measures, modified_scores
from ostiform.surface import Seam, Surface
from tests.populations import population, two_part_template

SEAM = Seam("LV.mitral", "LA.mitral")


def test_modified_scores_are_those_of_a_normal_sample_and_ignore_an_outlier():
    sample = 10.0 + np.random.default_rng(1).normal(size=20_000)
    np.testing.assert_allclose(modified_scores(sample), sample - 10.0, atol=0.1)
    spoiled = np.append(sample, 1e6)
    assert modified_scores(spoiled)[-1] > 1e5
    np.testing.assert_allclose(modified_scores(spoiled)[:-1], modified_scores(sample), atol=0.01)


def flagged(values, subjects):
    return flagged_measures(modified_scores(np.asarray(values))[:, None], list(subjects))[
        :, 0
    ].tolist()


def test_a_population_all_alike_has_no_outlier():
    assert not any(flagged([1.0, 1.0, 1.0, 1.0, 1.01], "abcde"))
    assert not any(flagged(np.zeros(5), "abcde"))


def test_the_fourth_of_four_is_no_outlier_the_fifth_of_five_may_be():
    values = [1.0, 1.1, 1.2, 1.1, 9.0]
    assert not any(flagged(values[1:], "bcde"))
    assert flagged(values, "abcde") == [False] * 4 + [True]


def test_of_a_subject_that_differs_its_worst_phase_alone_is_flagged():
    rng = np.random.default_rng(2)
    levels = np.array([1.0, 1.1, 0.9, 1.0, 1.05, 5.0])
    values = (levels[:, None] + 0.02 * rng.normal(size=(6, 9))).ravel()
    subjects = [name for name in "abcdef" for _ in range(9)]
    assert np.flatnonzero(flagged(values, subjects)).tolist() == [int(values.argmax())]
    assert not any(flagged(values[18:], subjects[18:]))


def test_single_phases_are_flagged_among_few_subjects_too():
    values = np.linspace(0.9, 1.1, 18)
    values[4] += 1.0
    assert np.flatnonzero(flagged(values, ["a"] * 9 + ["b"] * 9)).tolist() == [4]


@pytest.fixture(scope="module")
def shapes():
    return population(4, 3, np.random.default_rng(4), two_part_template(9, 16))


@pytest.fixture(scope="module")
def stored(shapes):
    model = fit_model(shapes.aligned, shapes.weights, mesh_of_template(shapes.template))
    return StoredModel(model, project(model, shapes.aligned), shapes.ids, None)


@pytest.fixture(scope="module")
def evaluation(shapes, stored):
    faces = shapes.template.faces
    originals = [OriginalMesh(points, faces) for points in shapes.points]
    return evaluate_model("optimal", stored.model, (shapes, shapes), originals, 0.01, 0, None, None)


def map_of(label, angle=1.5):
    certificate = Certificate(0, 0, 0.0, 0.0, (), {"LV.aortic": 0.1}, ())
    distortion = Distortion(angle, angle, angle, 0.5, 2.0, {}, {})
    angles, areas = (np.full(len(e) - 1, 1.0 / (len(e) - 1)) for e in (ANGLE_EDGES, AREA_EDGES))
    return MapRecord(
        label,
        (ComponentRecord("LV+LA", 10, certificate, distortion, 0.1, angles, areas, {}),),
    )


def section(stored, evaluation, odd=None, read=None, failed=()):
    maps = [map_of(str(id), 9.0 if i == odd else 1.5) for i, id in enumerate(stored.ids)]
    points = stored.model.mean + np.tensordot(stored.scores, stored.model.modes, axes=1)
    residues = left_out_point_residues(points, stored.model.weights, stored.ids, 3)
    return quality_section(stored, evaluation, maps, residues, read or {}, failed)


def test_the_worst_shape_comes_first_with_its_reason_and_its_picture(stored, evaluation):
    found = section(stored, evaluation, odd=7)
    first = found.tables[0].rows[0]
    assert first[0] == str(stored.ids[7])
    assert "distorted map" in first[1]
    titles = [axes.get_title() for axes in found.pictures[0].figure.axes]
    assert titles[0].startswith(f"{stored.ids[7]}\ndistorted map")
    assert sorted(row[0] for row in found.tables[0].rows) == sorted(map(str, stored.ids))


def test_points_that_left_a_region_flag_a_shape(stored, evaluation):
    coverage = list(evaluation.coverage)
    coverage[2] = Coverage(0.1, 0.2, 100.0, 0.1, 0.05)
    found = section(stored, replace(evaluation, coverage=tuple(coverage)))
    reasons = {row[0]: row[1] for row in found.tables[0].rows}
    assert "points have left a region" in reasons[str(stored.ids[2])]


def test_turns_and_repairs_are_told(stored, evaluation):
    found = section(stored, evaluation, read={str(stored.ids[3]): ReadShape(2, 41.6)})
    cells = {row[0]: row[-2:] for row in found.tables[0].rows}
    assert cells[str(stored.ids[3])] == ("42", "2")
    assert cells[str(stored.ids[4])] == ("", "")


def test_without_a_flag_the_leaders_are_shown(stored, evaluation, monkeypatch):
    monkeypatch.setattr("ostiform.report.quality.FLAGGED_ABOVE", np.inf)
    found = section(stored, evaluation)
    assert found.pictures[0].caption.startswith("No shape is flagged")
    titles = " ".join(axes.get_title() for axes in found.pictures[0].figure.axes)
    assert "farthest from the mean" in titles
    assert "badly covered" not in titles
    assert found.paragraphs[0].startswith("0 of 12 shapes stand out")


def test_more_flagged_shapes_than_fit_are_named_in_the_caption(stored, evaluation, monkeypatch):
    monkeypatch.setattr("ostiform.report.quality.FLAGGED_ABOVE", -np.inf)
    monkeypatch.setattr("ostiform.report.quality.FEWEST_SUBJECTS", 4)
    monkeypatch.setattr("ostiform.report.quality.MOST_PICTURES", 3)
    found = section(stored, evaluation)
    assert re.search(r"the first 3; \d more are in the table", found.pictures[0].caption)
    assert MOST_PICTURES > 5


def test_shapes_left_out_are_shown_as_they_were_read(stored, evaluation):
    mesh = stored.model.mesh
    parts = {"LV": Surface(stored.model.mean, mesh.faces, {})}
    failed = [FailedShape("x/1", "embed", parts), FailedShape("y/1", "read", {})]
    found = section(stored, evaluation, failed=failed)
    (picture,) = [p for p in found.pictures if p.name == "left-out"]
    assert [axes.get_title() for axes in picture.figure.axes] == ["x/1\nleft out: embed"]


def domain():
    equator = Circle(np.array([0.0, 0.0, 1.0]), 0.5 * np.pi, 0.0)
    return BaseDomain((Sphere("LV+LA", ("LV", "LA"), {}, {SEAM: equator}, "LV.mitral"),))


def test_a_sphere_has_no_kink_and_stretching_one_side_gives_the_ratio(shapes):
    template = shapes.template
    whole = 40.0 * template.points
    stretched = whole * np.where(template.points[:, 2:] > 0.0, [1.0, 1.0, 2.0], 1.0)
    both = replace(
        shapes,
        ids=shapes.ids[:2],
        directions=shapes.directions[:2],
        points=np.stack([whole, stretched]),
        aligned=np.stack([whole, stretched]),
        transforms=shapes.transforms[:2],
    )
    found = sampled_kinks(both, domain())[SEAM]
    np.testing.assert_allclose(found.kink[0], 1.0, rtol=1e-9)
    np.testing.assert_allclose(found.kink[1], 0.5, rtol=0.02)  # the template's triangles are flat
