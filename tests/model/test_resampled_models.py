"""Models on other triangulations: linear images, openings kept, weights as area shares."""

from dataclasses import replace

import numpy as np
import pytest

from ostiform.errors import InputError, TopologyError
from ostiform.model import (
    StoredModel,
    at_level,
    fit_model,
    mesh_of_template,
    project,
    reconstruct,
    resampled,
    resampled_onto,
    truncated,
)
from ostiform.surface import boundary_loops, vertex_areas
from tests.compare import assert_same_model
from tests.populations import population, two_part_template

ROUNDING = 1e-9  # relative to the size of the shapes


@pytest.fixture(scope="module")
def shapes():
    return population(4, 3, np.random.default_rng(7), two_part_template(17, 32))


@pytest.fixture(scope="module")
def model(shapes):
    return fit_model(shapes.aligned, shapes.weights, mesh_of_template(shapes.template))


@pytest.fixture(scope="module")
def coarse(model):
    return resampled(model, 300)


def test_resampling_onto_the_own_mesh_gives_the_model(model):
    same = resampled_onto(model, model.mean, model.mesh.faces)
    np.testing.assert_allclose(same.mean, model.mean, atol=ROUNDING * 50.0)
    np.testing.assert_allclose(same.weights, model.weights, rtol=1e-6)
    np.testing.assert_allclose(same.variances, model.variances, rtol=1e-6)
    np.testing.assert_array_equal(same.mesh.part, model.mesh.part)
    np.testing.assert_array_equal(same.mesh.face_part, model.mesh.face_part)
    for name, loop in model.mesh.loops.items():
        assert set(same.mesh.loops[name]) == set(loop)


def test_resampling_twice_onto_one_mesh_changes_nothing_more(coarse):
    again = resampled_onto(coarse, coarse.mean, coarse.mesh.faces)
    assert_same_model(again, coarse, rtol=1e-6)


def test_a_resampled_model_has_about_the_points_asked_for(coarse):
    assert abs(len(coarse.mean) - 300) <= 0.02 * 300


def test_a_resampled_model_keeps_every_opening_on_its_rim(model, coarse):
    assert list(coarse.mesh.loops) == list(model.mesh.loops)
    for name, loop in coarse.mesh.loops.items():
        old = model.mean[model.mesh.loops[name]]
        assert _distance_from_curve(coarse.mean[loop], old).max() < ROUNDING * 50.0


def test_loops_of_a_resampled_model_run_with_their_part_on_the_left(coarse):
    for number, part in enumerate(coarse.mesh.parts):
        edges = {
            edge
            for loop in boundary_loops(coarse.mesh.faces[coarse.mesh.face_part == number])
            for edge in zip(loop, np.roll(loop, -1), strict=True)
        }
        for name, loop in coarse.mesh.loops.items():
            if name.startswith(f"{part}."):
                assert set(zip(loop, np.roll(loop, -1), strict=True)) <= edges


def test_both_sides_of_a_seam_keep_the_same_points_and_the_first_part(coarse):
    first, second = (coarse.mesh.loops[name] for name in ("LV.mitral", "LA.mitral"))
    assert set(first) == set(second)
    assert set(coarse.mesh.part[first]) == {0}


def test_weights_of_a_resampled_model_are_those_of_its_areas(coarse):
    areas = vertex_areas(coarse.mean, coarse.mesh.faces)
    np.testing.assert_allclose(coarse.weights, areas / areas.sum(), rtol=0.05)
    np.testing.assert_allclose(coarse.weights.sum(), 1.0)


def test_resampling_finer_keeps_the_variance_and_the_scores(shapes, model):
    # The image of a smooth mode keeps its length up to the integration error of the mesh; the
    # third mode is partly the independent noise of the points, which interpolation averages.
    fine = resampled(model, 900)
    np.testing.assert_allclose(fine.variances[:2], model.variances[:2], rtol=0.02)
    old, new = project(model, shapes.aligned)[:, :2], fine.variances[:2]
    np.testing.assert_allclose(old.var(axis=0, ddof=1), new, rtol=0.02)


def test_resampling_the_model_is_resampling_its_shapes(shapes, model, coarse):
    # Another route: one shape's own deviation carried alone, as a model of one mode.
    onto = resampled_onto(model, coarse.mean, coarse.mesh.faces)
    lone = replace(truncated(model, 1), residual_variance=0.0)
    moved = resampled_onto(lone, coarse.mean, coarse.mesh.faces)
    image = moved.modes[0] * np.sqrt(moved.variances[0])
    expected = reconstruct(onto, project(onto, onto.mean + image)) - onto.mean
    np.testing.assert_allclose(image, expected, atol=ROUNDING * 50.0)


def test_a_level_holds_some_of_the_own_points(shapes, model):
    stored = StoredModel(model, project(model, shapes.aligned), shapes.ids, _levelled(shapes))
    level = at_level(stored, 0)
    index = stored.template.levels[0].index
    np.testing.assert_array_equal(level.model.mean, model.mean[index])
    np.testing.assert_allclose(
        reconstruct(level.model, level.scores), shapes.aligned[:, index], atol=ROUNDING * 50.0
    )
    assert level.ids == stored.ids
    assert level.template.levels == ()
    np.testing.assert_allclose(level.model.weights.sum(), 1.0)


def test_resampling_refuses(shapes, model):
    faces = model.mesh.faces
    stored = StoredModel(model, np.empty((0, len(model.modes))), (), None)
    with pytest.raises(InputError, match="template with coarser levels"):
        at_level(stored, 0)
    with pytest.raises(InputError, match="from 0 to 0, found 3"):
        at_level(replace(stored, template=_levelled(shapes)), 3)
    with pytest.raises(InputError, match="indices from 0"):
        resampled_onto(model, model.mean[:10], faces)
    with pytest.raises(InputError, match="no triangle"):
        resampled_onto(model, model.mean, faces[:0])
    with pytest.raises(InputError, match="each in a triangle"):
        resampled_onto(model, np.vstack([model.mean, model.mean[:1]]), faces)
    with pytest.raises(InputError, match="expected 2 openings"):
        resampled_onto(model, model.mean, np.delete(faces, 200, axis=0))
    with pytest.raises(TopologyError, match="part LV"):
        resampled_onto(model, model.mean, np.vstack([faces, faces[:1]]))
    with pytest.raises(InputError, match="some area"):
        resampled_onto(model, _with_ring_on_one_point(model, 200), faces)
    flat = replace(
        model,
        mesh=replace(model.mesh, faces=faces[:0], face_part=model.mesh.face_part[:0], loops={}),
    )
    with pytest.raises(InputError, match="model with triangles"):
        resampled(flat, 100)


def _with_ring_on_one_point(model, point):
    vertices = np.array(model.mean)
    around = model.mesh.faces[(model.mesh.faces == point).any(axis=1)]
    vertices[np.unique(around)] = model.mean[point]
    return vertices


def _distance_from_curve(points, curve):
    step = np.roll(curve, -1, axis=0) - curve
    offset = points[:, None] - curve
    share = np.clip((offset * step).sum(axis=2) / (step**2).sum(axis=1), 0.0, 1.0)
    return np.linalg.norm(offset - share[:, :, None] * step, axis=2).min(axis=1)


def _levelled(shapes):
    """The template with a coarser level: every second row and column of the grid of points."""
    rows, columns = 17, 32
    index = np.arange(rows * columns).reshape(rows, columns)[::2, ::2]
    place = np.arange(index.size).reshape(index.shape)
    right = np.roll(place, -1, axis=1)
    a, b, c, d = place[:-1], right[:-1], right[1:], place[1:]
    faces = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], 2).reshape(-1, 3)
    level = replace(
        shapes.template.levels[0],
        index=index.ravel(),
        faces=faces,
        face_part=np.repeat([0, 1], len(faces) // 2),
    )
    return replace(shapes.template, levels=(level,))
