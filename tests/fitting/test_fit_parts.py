"""The pieces of a fit: leftover, prior, rows, patches, labels."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ostiform.errors import InputError
from ostiform.fitting import (
    FitSettings,
    LandmarkTarget,
    Leftover,
    LeftoverSource,
    Pose,
    SurfaceTarget,
    estimated_leftover,
    fit_prior,
    fit_shape,
    leftover_of_spectrum,
    shape_deviations,
)
from ostiform.fitting.data import prepared_data
from ostiform.fitting.kernels import design_rows
from ostiform.fitting.landmarks import labelled
from ostiform.fitting.leftover import matern
from ostiform.fitting.linear import State, moved, placed_points, pose_rows
from ostiform.fitting.patches import (
    closest_on_curve,
    curve_distance,
    curve_samples,
    even_samples,
    open_patch,
)
from ostiform.fitting.prior import MOST_GROWTH
from ostiform.fitting.rim_kinds import with_openings_matched
from ostiform.model import StoredModel, fit_model, project, reconstruct
from ostiform.study import ShapeId
from ostiform.surface import closest_points, face_areas, surface_tree
from ostiform.surface.normals import vertex_normals
from tests.fitting.fitting_cases import drawn_shape, stored_ellipsoids, surface_of
from tests.populations import two_part_template


def planted(rng, groups=40, length=14.0, deviation=0.8):
    """Return a stored model of spheres with one mode of size and a smooth field of known law."""
    from ostiform.model import mesh_of_template
    from tests.populations import area_weights

    template = two_part_template(rows=15, columns=24)
    base = 40.0 * template.points
    distance = np.linalg.norm(base[:, None] - base[None], axis=2)
    covariance = deviation**2 * matern(distance, length)
    root = np.linalg.cholesky(covariance + 1e-9 * np.eye(len(base)))
    size = rng.normal(scale=0.08, size=(groups, 1, 1))
    field = np.einsum("pq,nqd->npd", root, rng.normal(size=(groups, len(base), 3)))
    shapes = base * (1.0 + size) + field
    weights = area_weights(base, template.faces)
    model = fit_model(shapes, weights, mesh_of_template(template))
    ids = tuple(ShapeId(f"s{k}", "0", 0.0) for k in range(groups))
    return StoredModel(model, project(model, shapes), ids, template)


def test_the_leftover_of_a_planted_field_is_found(rng):
    found = estimated_leftover(planted(rng))
    assert found.source is LeftoverSource.LEFT_OUT
    # Of 3 x 0.64 mm^2, the modes of 36 training shapes take a share that this bounds.
    assert 0.2 * 1.92 < found.variance < 1.0 * 1.92
    assert 5.0 < found.length < 20.0
    assert 1.0 <= found.growth < 1.3


def test_a_model_without_training_shapes_gets_a_cautious_leftover(stored):
    bare = StoredModel(stored.model, np.empty((0, len(stored.model.modes))), (), None)
    found = estimated_leftover(bare)
    assert found.source is LeftoverSource.SPECTRUM
    np.testing.assert_allclose(found.variance, 0.1 * stored.model.variances.sum(), rtol=1e-9)
    assert found == leftover_of_spectrum(stored.model) or found.length > 0.0


def test_a_leftover_of_negative_variance_is_refused():
    with pytest.raises(InputError, match="leftover of a model"):
        Leftover(-1.0, np.ones(3), 5.0, 0.0, 1.0, 4, 4.0)


def test_the_prior_has_the_variance_of_modes_and_leftover(stored, prior):
    count = len(stored.model.mean)
    of_modes = (prior.modes[:count] ** 2).sum(axis=(1, 2))
    of_field = 3.0 * (prior.field[:count] ** 2).sum(axis=1)
    total = stored.model.weights @ (of_modes + of_field) + 3.0 * prior.noise_variance
    leftover = prior.leftover
    expected = leftover.growth * stored.model.variances.sum() + leftover.variance
    np.testing.assert_allclose(total, expected, rtol=0.03)


def test_centres_of_openings_are_the_means_of_their_rims(prior):
    for name, rim in prior.model.mesh.loops.items():
        np.testing.assert_allclose(
            prior.mean[prior.centres[name]], prior.mean[rim].mean(axis=0), atol=1e-12
        )


def test_rows_are_the_derivative_of_placed_points(prior, rng):
    n_modes, n_shape = prior.modes.shape[2], prior.modes.shape[2] + 3 * prior.field.shape[1]
    turn = Rotation.from_rotvec([0.3, -0.5, 0.2]).as_matrix()
    state = State(Pose(1.1, turn, np.array([3.0, 4.0, 5.0])), rng.normal(size=n_shape))
    points = placed_points(prior, state)
    corners = rng.integers(0, len(points), size=(20, 3))
    barycentric = rng.dirichlet([1.0, 1.0, 1.0], 20)
    directions = rng.normal(size=(20, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    at = np.einsum("nk,nki->ni", barycentric, points[corners])
    turned = np.ascontiguousarray(state.pose.scale * directions @ turn)
    rows = np.concatenate(
        [
            design_rows(prior.modes, prior.field, corners, barycentric, turned),
            pose_rows(at, directions, points.mean(axis=0), 7),
        ],
        axis=1,
    )
    step = 1e-6 * rng.normal(size=n_shape + 7)
    there = placed_points(prior, moved(state, step, points.mean(axis=0), n_shape))
    change = np.einsum("nk,nki->ni", barycentric, (there - points)[corners])
    np.testing.assert_allclose(
        np.einsum("ni,ni->n", directions, change), rows @ step, atol=1e-9, rtol=1e-5
    )
    assert rows.shape[1] == n_shape + 7
    assert n_modes > 0


def test_normals_of_a_sphere_are_radial():
    template = two_part_template()
    normals = vertex_normals(template.points, template.faces)
    assert np.einsum("pi,pi->p", normals, template.points).min() > 0.9


def test_closest_points_on_a_curve_agree_with_dense_sampling(rng):
    curve = rng.normal(size=(12, 3))
    points = rng.normal(size=(30, 3))
    edge, fraction, nearest = closest_on_curve(curve, points)
    dense = curve_samples(np.concatenate([curve, curve[:1]]), 1e-3)
    brute = np.linalg.norm(points[:, None] - dense[None], axis=2).min(axis=1)
    np.testing.assert_allclose(np.linalg.norm(nearest - points, axis=1), brute, atol=2e-3)
    following = np.roll(curve, -1, axis=0)
    np.testing.assert_allclose(
        nearest, curve[edge] + fraction[:, None] * (following - curve)[edge], atol=1e-12
    )
    assert curve_distance(curve, curve) < 1e-12


def test_samples_are_even_by_area():
    template = two_part_template(rows=15, columns=24)
    areas = face_areas(template.points, template.faces)
    chosen, barycentric = even_samples(template.points, template.faces, 5000)
    share = np.bincount(chosen, minlength=len(areas)) / 5000.0
    np.testing.assert_allclose(share, areas / areas.sum(), atol=1.01 / 5000.0)
    np.testing.assert_allclose(barycentric.sum(axis=1), 1.0)
    np.testing.assert_allclose(barycentric.mean(axis=0), 1.0 / 3.0, atol=0.01)


def test_a_patch_knows_where_it_ends():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    patch = open_patch(faces, 4)
    queries = np.array([[0.5, 0.4, 1.0], [0.5, 0.5, 1.0], [2.0, 0.5, 0.0], [-1.0, -1.0, 0.0]])
    found = closest_points(surface_tree(vertices, faces), queries)
    assert patch.ends_at(found).tolist() == [False, False, True, True]
    assert len(patch.loops) == 1


def test_labels_mean_points_centres_and_rims(prior):
    target = LandmarkTarget(
        ("5", "LA.vein", "LV.aortic-1", "LV.aortic-2"), np.arange(12.0).reshape(4, 3)
    )
    found = labelled(prior, [target])
    assert found.points.tolist() == [5, prior.centres["LA.vein"]]
    np.testing.assert_allclose(found.on_rims["LV.aortic"], [[6, 7, 8], [9, 10, 11]])


@pytest.mark.parametrize("label", ["LA.tricuspid", "99999", "apex"])
def test_an_unknown_label_is_named(prior, label):
    with pytest.raises(InputError, match=label):
        labelled(prior, [LandmarkTarget((label,), np.zeros((1, 3)))])


def test_openings_are_matched_and_cuts_are_not(prior):
    mesh = prior.model.mesh
    points = prior.mean[: len(prior.model.mean)]
    low = points[mesh.faces].mean(axis=1)[:, 2] < 0.55 * points[:, 2].max()
    data = prepared_data(prior, [SurfaceTarget(points, mesh.faces[low], {})])
    _, found = with_openings_matched(prior, data, prior.mean)
    assert list(found.values()) == ["LV.aortic"]


def test_a_loop_beyond_a_rim_is_that_opening(prior):
    mesh = prior.model.mesh
    points = prior.mean[: len(prior.model.mean)].copy()
    rim = mesh.loops["LA.vein"]
    points[rim] *= [1.0, 1.0, 1.25]
    assert np.ptp(points[:, 2]) > 5.0 + np.ptp(prior.mean[:, 2])
    data = prepared_data(prior, [SurfaceTarget(points, mesh.faces, {})])
    _, found = with_openings_matched(prior, data, prior.mean)
    assert set(found.values()) == {"LV.aortic", "LA.vein"}


def test_settings_that_make_no_sense_are_refused():
    with pytest.raises(InputError, match="pose"):
        FitSettings(pose="guess")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="noise"):
        FitSettings(noise_mm=0.0)


def test_many_small_modes_join_the_leftover():
    stored = stored_ellipsoids()
    prior = fit_prior(stored)
    assert prior.modes.shape[2] <= len(stored.model.modes)
    assert prior.noise_variance > 0.0


def test_the_field_has_beyond_the_modes_what_left_out_shapes_have_there(stored):
    """Many modes take up much of a field that knows nothing of them."""
    prior = fit_prior(stored)
    assert len(stored.model.modes) > 20
    model, count = stored.model, len(stored.model.mean)
    functions = np.zeros((3 * prior.field.shape[1], count, 3))
    for axis in range(3):
        functions[axis::3, :, axis] = prior.field[:count].T
    left = functions - reconstruct(model, project(model, functions + model.mean)) + model.mean
    energy = float(((left**2).sum(axis=2) @ model.weights).sum())
    given = fit_prior(stored, replace(prior.leftover, source=LeftoverSource.GIVEN))
    growth = (prior.field[:count] ** 2).sum() / (given.field[:count] ** 2).sum()
    assert growth > 1.0
    if growth < MOST_GROWTH - 1e-9:
        np.testing.assert_allclose(energy, prior.leftover.smooth_variance, rtol=1e-6)


def test_the_directions_of_a_fit_sum_to_the_covariance_of_its_points(prior, rng):
    truth = drawn_shape(prior, rng)
    half = prior.model.mesh.faces[: len(prior.model.mesh.faces) // 2]
    fit = fit_shape(prior, [surface_of(prior, truth, half)], FitSettings(pose="known"))
    rows = shape_deviations(prior, fit, most=10_000)
    assert len(shape_deviations(prior, fit, most=7)) == 7
    found = np.einsum("qpi,qpj->pij", rows, rows)
    expected = fit.point_covariance - prior.noise_variance * np.eye(3)
    total = np.trace(expected, axis1=1, axis2=2) @ prior.model.weights
    missed = np.trace(expected - found, axis1=1, axis2=2) @ prior.model.weights
    assert 0.0 <= missed < 0.02 * total
    assert np.linalg.eigvalsh(expected - found).min() > -1e-9 * total
