"""The true correspondence: round trips, projection, rims, file."""

import json

import numpy as np
import pytest

from ostiform.demo.contouring import canonical_points, extract
from ostiform.demo.demonstration import demonstration_truth
from ostiform.demo.truth import (
    material_coordinates,
    read_truth,
    true_positions,
    write_truth,
)
from ostiform.errors import ArtifactError, InputError
from ostiform.study.shape import ShapeId

EDGE_MM = 3.0
ROUND_TRIP_MM = 1e-9


@pytest.fixture(scope="module")
def truth():
    return demonstration_truth(2, 4, seed=5)


@pytest.fixture(scope="module")
def shape(truth):
    shape_id, deformation = list(truth.deformations.items())[1]
    canonical = canonical_points(truth.anatomy, EDGE_MM)
    rng = np.random.default_rng(3)
    return shape_id, extract(truth.anatomy, deformation, EDGE_MM, rng, canonical)


def test_points_of_a_surface_go_to_material_space_and_back(truth, shape):
    shape_id, parts = shape
    for part, surface in parts.items():
        material = material_coordinates(truth, shape_id, part, surface.vertices)
        assert np.abs(truth.anatomy.level(material)[0]).max() < ROUND_TRIP_MM
        back = true_positions(truth, shape_id, part, material)
        np.testing.assert_allclose(back, surface.vertices, atol=ROUND_TRIP_MM)


def test_corresponding_points_of_two_shapes_have_the_same_material_point(truth, shape):
    shape_id, parts = shape
    other = next(i for i in truth.deformations if i.subject != shape_id.subject)
    for part, surface in parts.items():
        material = material_coordinates(truth, shape_id, part, surface.vertices)
        there = true_positions(truth, other, part, material)
        again = material_coordinates(truth, other, part, there)
        np.testing.assert_allclose(again, material, atol=ROUND_TRIP_MM)


def test_points_off_the_surface_go_to_its_closest_point(truth, shape, rng):
    shape_id, parts = shape
    for part, surface in parts.items():
        points = surface.vertices + 0.4 * rng.normal(size=surface.vertices.shape)
        material = material_coordinates(truth, shape_id, part, points)
        nearest = true_positions(truth, shape_id, part, material)
        distance = np.linalg.norm(nearest - points, axis=1)
        # No vertex of the part is closer than the point found.
        assert (distance <= np.linalg.norm(surface.vertices - points, axis=1) + 1e-6).all()
        for _, sign, cut in truth.anatomy.part_cuts(part):
            reached = cut.reaches(material)
            assert (sign * cut.height(material[reached])[0]).max() < ROUND_TRIP_MM


def test_chords_across_triangles_move_by_less_than_their_sagitta(truth, shape):
    shape_id, parts = shape
    surface = parts["LA"]
    centers = surface.vertices[surface.faces].mean(axis=1)
    moved = true_positions(
        truth, shape_id, "LA", material_coordinates(truth, shape_id, "LA", centers)
    )
    assert np.linalg.norm(moved - centers, axis=1).max() < 0.3 * EDGE_MM


def test_a_point_of_the_other_part_goes_to_the_seam(truth, shape):
    shape_id, parts = shape
    seam = truth.anatomy.cuts[0]
    atrium = material_coordinates(truth, shape_id, "LA", parts["LA"].vertices)
    close = seam.reaches(atrium) & (seam.height(atrium)[0] < 3.0)
    material = material_coordinates(truth, shape_id, "LV", parts["LA"].vertices[close])
    assert np.abs(seam.height(material)[0]).max() < ROUND_TRIP_MM


def test_the_file_gives_back_the_same_maps(truth, tmp_path, rng):
    again = read_truth(write_truth(truth, tmp_path / "truth" / "truth.json"))
    assert again.seed == truth.seed
    assert list(again.deformations) == list(truth.deformations)
    points = 30.0 * rng.normal(size=(100, 3))
    for shape_id, deformation in truth.deformations.items():
        there = again.deformation(shape_id).forward(points)
        np.testing.assert_allclose(there, deformation.forward(points), atol=ROUND_TRIP_MM)
    level, _ = again.anatomy.level(points)
    np.testing.assert_allclose(level, truth.anatomy.level(points)[0], atol=ROUND_TRIP_MM)


def test_unknown_shapes_and_parts_are_refused(truth):
    with pytest.raises(InputError, match="S9/00"):
        true_positions(truth, ShapeId("S9", "00", 0.0), "LV", np.zeros((1, 3)))
    with pytest.raises(InputError, match="found RV"):
        material_coordinates(truth, next(iter(truth.deformations)), "RV", np.zeros((1, 3)))


def test_damaged_and_foreign_files_are_refused(truth, tmp_path):
    path = write_truth(truth, tmp_path / "truth.json")
    document = json.loads(path.read_text(encoding="utf-8"))
    with pytest.raises(ArtifactError, match="generate the population again"):
        read_truth(tmp_path / "missing.json")
    for changed in ({"layout": 9}, {"value": {**document["value"], "anatomy": {}}}):
        path.write_text(json.dumps({**document, **changed}), encoding="utf-8")
        with pytest.raises(ArtifactError, match="expected the truth .* generate the population"):
            read_truth(path)
    path.write_text("{", encoding="utf-8")
    with pytest.raises(ArtifactError):
        read_truth(path)
