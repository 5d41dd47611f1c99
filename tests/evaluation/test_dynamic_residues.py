"""Residues of left-out subjects at the two levels of a dynamic model, and real motion."""

from dataclasses import replace

import numpy as np
import pytest

from ostiform.errors import InputError
from ostiform.evaluation import level_residues, model_specificity
from ostiform.model import (
    ModelMesh,
    StoredModel,
    dynamic_model_of,
    fit_dynamic_model,
    fit_model,
    mesh_of_template,
    project,
    resampled_cycle,
    subject_means,
    truncated,
    within_shapes,
)
from ostiform.study import ShapeId
from ostiform.surface.files import read_mesh
from tests.populations import area_weights, population


@pytest.fixture(scope="module")
def shapes():
    return population(5, 4, np.random.default_rng(13))


def fitted(shapes, kept):
    return fit_dynamic_model(
        shapes.aligned[kept],
        [shapes.ids[i] for i in kept],
        shapes.weights,
        mesh_of_template(shapes.template),
    )


def test_the_levels_leave_nothing_of_the_subjects_they_were_built_from(shapes):
    model = fitted(shapes, range(20))
    found = level_residues(model, shapes.aligned, shapes.ids, (0, 50))
    assert found.between[:, 0].min() > 0.1
    assert max(found.between[:, 1].max(), found.within[:, 1].max()) < 1e-5


def test_the_residues_of_a_left_out_subject_are_those_of_its_mean_and_its_motion(shapes):
    model = fitted(shapes, range(4, 20))
    found = level_residues(model, shapes.aligned[:4], shapes.ids[:4])
    mean = shapes.aligned[:4].mean(axis=0)
    squared = ((mean - model.total.mean) ** 2).sum(axis=1) @ shapes.weights
    np.testing.assert_allclose(found.between[0, 0], np.sqrt(squared))
    motion = ((shapes.aligned[2] - mean) ** 2).sum(axis=1) @ shapes.weights
    np.testing.assert_allclose(found.within[2, 0], np.sqrt(motion))
    assert (np.diff(found.between, axis=1) <= 1e-12).all()
    assert (np.diff(found.within, axis=1) <= 1e-12).all()
    assert found.within[:, 1].mean() < 0.5 * found.within[:, 0].mean()  # one mode of contraction


def test_both_levels_have_a_specificity(shapes):
    model = fitted(shapes, range(20))
    for level, training in (
        (model.between, subject_means(model)),
        (model.within, within_shapes(model)),
    ):
        found = model_specificity(level, training, np.random.default_rng(1), 100)
        assert 0.0 < found.mean[-1] < 3.0 * np.sqrt(level.total_variance)


def test_left_out_shapes_that_do_not_fit_are_refused(shapes):
    model = fitted(shapes, range(20))
    with pytest.raises(InputError, match="left-out shapes"):
        level_residues(model, shapes.aligned[:2], shapes.ids[:3])
    with pytest.raises(InputError, match="found none"):
        level_residues(model, shapes.aligned[:0], ())


def test_a_model_file_holds_all_that_a_dynamic_model_needs(shapes):
    model = fit_model(shapes.aligned, shapes.weights, mesh_of_template(shapes.template))
    stored = StoredModel(model, project(model, shapes.aligned), shapes.ids, shapes.template)
    again, direct = dynamic_model_of(stored), fitted(shapes, range(20))
    np.testing.assert_allclose(again.between.variances, direct.between.variances, rtol=1e-9)
    np.testing.assert_allclose(
        resampled_cycle(again, "subject 2", np.array([0.3])),
        resampled_cycle(direct, "subject 2", np.array([0.3])),
        atol=1e-6,
    )
    for poor in (
        StoredModel(model, np.empty((0, len(model.modes))), (), None),
        replace(stored, model=truncated(model, 3), scores=stored.scores[:, :3]),
    ):
        with pytest.raises(InputError, match="all its modes"):
            dynamic_model_of(poor)


@pytest.mark.parametrize("first", [0, 1])
def test_withheld_phases_of_a_real_heart_are_predicted_better_than_by_straight_lines(
    shared_data, first
):
    meshes = [read_mesh(path) for path in sorted((shared_data / "lv-cine").glob("*.vtk"))]
    count = len(meshes)
    phases = np.stack([mesh.vertices for mesh in meshes])
    faces = meshes[0].faces
    used = np.unique(faces)
    faces = np.searchsorted(used, faces)
    phases = phases[:, used]
    weights = area_weights(phases.mean(axis=0), faces)
    mesh = ModelMesh(
        faces, np.zeros(len(faces), np.int64), np.zeros(len(used), np.int64), ("LV",), {}
    )
    ids = [ShapeId("patient", str(f), f / count) for f in range(count)]
    kept = np.arange(first, count, 2)
    withheld = np.setdiff1d(np.arange(count), kept)
    model = fit_dynamic_model(phases[kept], [ids[f] for f in kept], weights, mesh)
    times = np.array([ids[f].time for f in withheld])
    curves = resampled_cycle(model, "patient", times)
    before, after = (kept[(np.searchsorted(kept, withheld) + step) % len(kept)] for step in (-1, 0))
    since, gap = (withheld - before) % count, (after - before) % count
    share = (since / gap)[:, None, None]
    lines = (1.0 - share) * phases[before] + share * phases[after]
    error_of_curves, error_of_lines = (
        np.sqrt(((found - phases[withheld]) ** 2).sum(axis=2) @ weights).mean()
        for found in (curves, lines)
    )
    assert error_of_curves < error_of_lines
