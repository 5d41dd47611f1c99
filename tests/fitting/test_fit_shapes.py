"""Fits to shapes that the model has never seen, with known truth."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import kstest

from ostiform.errors import InputError
from ostiform.evaluation import surface_distances
from ostiform.fitting import (
    CloudTarget,
    ContourTarget,
    FitSettings,
    FitStatus,
    LandmarkTarget,
    Leftover,
    SurfaceTarget,
    checked_size,
    fit_prior,
    fit_shape,
)
from ostiform.model import ModelMesh, StoredModel, fit_model, mesh_of_template, posterior, truncated
from ostiform.surface import boundary_loops, face_areas, read_mesh
from tests.fitting.fitting_cases import drawn_pose, drawn_shape, rms, stored_lopsided, surface_of

KNOWN = FitSettings(pose="known")


def true_distance(prior, points, truth):
    faces = prior.model.mesh.faces
    return surface_distances(points[None], faces, truth, faces)[0].mean


def sliced(prior, points, levels):
    """Return horizontal rings of a shape: where edges of its mesh cross planes, by angle."""
    faces = prior.model.mesh.faces
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges = np.unique(np.sort(edges, axis=1), axis=0)
    rings = []
    for level in levels:
        height = points[edges][:, :, 2] - level
        cross = edges[height[:, 0] * height[:, 1] < 0.0]
        a, b = points[cross[:, 0]], points[cross[:, 1]]
        share = (level - a[:, 2]) / (b[:, 2] - a[:, 2])
        ring = a + share[:, None] * (b - a)
        order = np.argsort(np.arctan2(ring[:, 1], ring[:, 0]))
        rings.append(np.concatenate([ring[order], ring[order[:1]]]))
    return tuple(rings)


def random_cloud(prior, points, rng, count, noise, outliers):
    faces = prior.model.mesh.faces
    areas = face_areas(points, faces)
    chosen = rng.choice(len(faces), count, p=areas / areas.sum())
    cloud = np.einsum("nk,nki->ni", rng.dirichlet(np.ones(3), count), points[faces[chosen]])
    cloud += rng.normal(scale=noise, size=cloud.shape)
    wrong = rng.permutation(count)[: round(outliers * count)]
    low, high = 1.4 * points.min(axis=0), 1.4 * points.max(axis=0)
    cloud[wrong] = rng.uniform(low, high, size=(len(wrong), 3))
    return cloud


def test_a_surface_is_fitted_wherever_it_lies(prior, rng):
    truth = drawn_shape(prior, rng)
    turn, shift = drawn_pose(rng, 25.0)
    fit = fit_shape(prior, [surface_of(prior, truth @ turn.T + shift)])
    assert fit.status is FitStatus.CONVERGED
    assert true_distance(prior, (fit.points - shift) @ turn, truth) < 0.15
    assert set(fit.openings.values()) == {"LV.aortic", "LA.vein"}
    assert fit.residues.to_model.mean < 0.15
    assert fit.residues.to_target is not None
    assert fit.residues.to_target.mean < 0.15


@pytest.mark.parametrize("angle", [75.0, 125.0, 180.0])
def test_any_rotation_is_found_where_the_pose_is_unknown(prior, rng, angle):
    truth = drawn_shape(prior, rng)
    turn, shift = drawn_pose(rng, angle)
    target = surface_of(prior, truth @ turn.T + shift)
    fit = fit_shape(prior, [target], FitSettings(pose="unknown"))
    back = (fit.points - shift) @ turn
    # Ellipsoids of nearly equal axes look alike when turned by half a turn: the surface decides.
    assert true_distance(prior, back, truth) < 0.2


def test_the_result_moves_with_the_data(prior, rng):
    truth = drawn_shape(prior, rng)
    _, shift = drawn_pose(rng, 0.0)
    one = fit_shape(prior, [surface_of(prior, truth)])
    two = fit_shape(prior, [surface_of(prior, truth + shift)])
    np.testing.assert_allclose(two.points - shift, one.points, atol=0.02)
    np.testing.assert_allclose(two.point_sd, one.point_sd, rtol=0.02)


def test_faces_that_run_the_other_way_round_change_nothing(prior, rng):
    truth = drawn_shape(prior, rng)
    faces = prior.model.mesh.faces
    one = fit_shape(prior, [surface_of(prior, truth)])
    two = fit_shape(prior, [surface_of(prior, truth, faces[:, ::-1].copy())])
    np.testing.assert_allclose(two.points, one.points, atol=0.1)


def test_equal_input_gives_equal_output(prior, rng):
    target = surface_of(prior, drawn_shape(prior, rng))
    one, two = (fit_shape(prior, [target], FitSettings(pose="unknown")) for _ in range(2))
    np.testing.assert_array_equal(one.points, two.points)
    np.testing.assert_array_equal(one.point_covariance, two.point_covariance)


def test_size_belongs_to_the_pose_where_asked(prior, rng):
    truth = 1.3 * prior.mean[: len(prior.model.mean)]
    fit = fit_shape(prior, [surface_of(prior, truth)], FitSettings(scaling="similarity"))
    np.testing.assert_allclose(fit.pose.scale, 1.3, rtol=0.03)
    rigid = fit_shape(prior, [surface_of(prior, truth)])
    np.testing.assert_allclose(rigid.pose.scale, 1.0)
    assert rigid.typicality.mahalanobis > fit.typicality.mahalanobis


@pytest.fixture(scope="module")
def lopsided():
    return fit_prior(stored_lopsided())


def test_any_rotation_is_tried_where_the_near_pose_fails(lopsided, rng):
    truth = drawn_shape(lopsided, rng)
    turn = Rotation.from_rotvec([0.0, np.pi, 0.0]).as_matrix()
    fit = fit_shape(lopsided, [surface_of(lopsided, truth @ turn.T)])
    assert true_distance(lopsided, fit.points @ turn, truth) < 0.2
    assert "turned further than expected" in fit.notes[0]
    assert set(fit.openings.values()) == {"LV.aortic", "LA.vein"}
    assert fit_shape(lopsided, [surface_of(lopsided, truth)]).notes == ()


def test_a_mirrored_target_is_told(lopsided, rng):
    truth = drawn_shape(lopsided, rng)
    faces = lopsided.model.mesh.faces[:, ::-1]
    fit = fit_shape(lopsided, [SurfaceTarget(truth * [-1.0, 1.0, 1.0], faces, {})])
    assert "fits far better as its mirror image (0." in fit.notes[-1]


def test_an_opening_that_was_cut_too_short_is_told(prior, rng):
    truth, mesh = drawn_shape(prior, rng), prior.model.mesh
    vein = truth[mesh.loops["LA.vein"]]
    far = np.linalg.norm(truth - vein.mean(axis=0), axis=1)
    kept = mesh.faces[(far[mesh.faces] > np.ptp(vein, axis=0).max() / 2.0 + 4.0).all(axis=1)]
    fit = fit_shape(prior, [surface_of(prior, truth, kept)])
    assert "LA.vein" in {**fit.openings}.values() or "mm from LA.vein" in fit.notes[0]


def test_cut_edges_do_not_attract(prior, rng):
    truth = drawn_shape(prior, rng)
    faces = prior.model.mesh.faces
    height = truth[faces].mean(axis=1)[:, 0]
    kept = faces[height < np.quantile(height, 0.6)]
    fit = fit_shape(prior, [surface_of(prior, truth, kept)])
    seen = np.unique(kept)
    assert rms(fit.points[seen], truth[seen]) < 1.5
    hidden = np.setdiff1d(np.arange(len(truth)), seen)
    # Points without data go where the model expects them, and say that they are less sure.
    assert true_distance(prior, fit.points, truth) < 0.8
    assert np.isnan(fit.residue[hidden]).mean() > 0.9
    assert np.isfinite(fit.residue[seen]).mean() > 0.8
    assert fit.point_sd[hidden].mean() > 1.05 * fit.point_sd[seen].mean()
    assert 0.4 < fit.residues.covered < 0.75


def test_a_missing_part_is_predicted(prior, rng):
    mesh = prior.model.mesh
    truth = drawn_shape(prior, rng)
    ventricle = mesh.faces[mesh.face_part == 0]
    fit = fit_shape(prior, [SurfaceTarget(truth, ventricle, {}, "LV")])
    assert "LV.mitral" in fit.openings.values()
    atrium = np.unique(mesh.faces[mesh.face_part == 1])
    mean = prior.mean[: len(truth)]
    assert rms(fit.points[atrium], truth[atrium]) < rms(mean[atrium], truth[atrium])


def test_named_openings_are_taken_at_their_word(prior, rng):
    truth = drawn_shape(prior, rng)
    mesh = prior.model.mesh
    loops = {name: mesh.loops[name] for name in ("LV.aortic", "LA.vein")}
    fit = fit_shape(prior, [SurfaceTarget(truth, mesh.faces, loops)])
    assert not fit.openings
    for rim in loops.values():
        assert rms(fit.points[rim].mean(axis=0)[None], truth[rim].mean(axis=0)[None]) < 0.5


@pytest.mark.parametrize("outliers", [0.0, 0.2])
def test_noise_and_outliers_of_a_cloud_are_borne(prior, rng, outliers):
    truth = drawn_shape(prior, rng)
    cloud = random_cloud(prior, truth, rng, 1500, 1.0, outliers)
    fit = fit_shape(prior, [CloudTarget(cloud)])
    assert true_distance(prior, fit.points, truth) < 0.5
    assert 0.5 < fit.noise_mm["points"] < 1.6
    assert fit.outlier_share >= 0.5 * outliers
    assert fit.residues.to_target is None
    assert not np.isfinite(fit.residue).any()


def test_contours_fit_better_the_more_there_are(prior, rng):
    errors = []
    truths = [drawn_shape(prior, rng) for _ in range(3)]
    for count in (2, 6):
        levels = [np.linspace(t[:, 2].min(), t[:, 2].max(), 2 * count + 1)[1::2] for t in truths]
        errors.append(
            np.mean(
                [
                    true_distance(
                        prior,
                        fit_shape(prior, [ContourTarget(sliced(prior, t, level))]).points,
                        t,
                    )
                    for t, level in zip(truths, levels, strict=True)
                ]
            )
        )
    assert errors[1] < 0.6 * errors[0]
    assert errors[1] < 0.4


def test_landmarks_give_the_gaussian_posterior(stored, prior):
    small = truncated(stored.model, 4)
    nothing = Leftover(0.0, np.ones(len(small.mean)), 5.0, 0.0, 1.0, 8, 4.0)
    bare = fit_prior(StoredModel(small, stored.scores[:, :4], stored.ids, None), nothing)
    truth = bare.mean[: len(small.mean)] + bare.modes[: len(small.mean)] @ np.full(
        bare.modes.shape[2], 0.05
    )
    chosen = np.arange(0, len(truth), 40)
    target = LandmarkTarget(tuple(map(str, chosen)), truth[chosen])
    fit = fit_shape(bare, [target], FitSettings(pose="known", noise_mm=2.0))
    # Residuals are far below the noise, where Student's weights are (nu + 3) / nu = 2.
    expected = posterior(small, chosen, truth[chosen], 2.0 / np.sqrt(2.0))
    np.testing.assert_allclose(fit.points, expected.mean, atol=0.02)


def test_a_few_landmarks_place_the_model(prior, rng):
    truth = drawn_shape(prior, rng)
    turn, shift = drawn_pose(rng, 100.0)
    chosen = rng.choice(len(truth), 12, replace=False)
    target = LandmarkTarget(tuple(map(str, chosen)), truth[chosen] @ turn.T + shift)
    fit = fit_shape(prior, [target], FitSettings(pose="unknown"))
    assert rms((fit.points - shift) @ turn, truth) < rms(prior.mean[: len(truth)], truth)
    assert fit.noise_mm.keys() == {"landmarks"}


def test_landmarks_that_fix_no_pose_are_refused(prior):
    target = LandmarkTarget(("LV.aortic", "LA.vein"), prior.mean[:2])
    with pytest.raises(InputError, match="at least three"):
        fit_shape(prior, [target])
    fit = fit_shape(prior, [target], KNOWN)
    assert np.isfinite(fit.points).all()


def test_the_posterior_is_calibrated_and_few_are_called_outliers(prior):
    inside, flagged, percentiles = [], 0, []
    for seed in range(16):
        own = np.random.default_rng(seed)
        truth = drawn_shape(prior, own)
        cloud = random_cloud(prior, truth, own, 600, 0.7, 0.05)
        fit = fit_shape(prior, [CloudTarget(cloud)])
        sd = np.sqrt(np.einsum("pii->pi", fit.point_covariance))
        inside.append((np.abs(fit.points - truth) < 1.96 * sd).mean())
        flagged += fit.typicality.is_outlier
        percentiles.append(fit.typicality.percentile)
    assert 0.88 < np.mean(inside) < 0.99
    assert flagged <= 2
    assert kstest(percentiles, "uniform").pvalue > 0.001


def test_a_shape_of_another_kind_is_called_an_outlier(prior):
    truth = prior.mean[: len(prior.model.mean)] * [2.2, 0.6, 1.0]
    fit = fit_shape(prior, [surface_of(prior, truth)])
    assert fit.typicality.is_outlier
    assert fit.typicality.reasons


def test_scores_are_those_of_the_fitted_shape(prior, rng):
    truth = drawn_shape(prior, rng)
    fit = fit_shape(prior, [surface_of(prior, truth)])
    inverse = np.linalg.inv(fit.pose.matrix)
    own = fit.points @ inverse[:3, :3].T + inverse[:3, 3]
    weighted = (own - prior.model.mean) * prior.model.weights[:, None]
    expected = np.tensordot(prior.model.modes, weighted, axes=([1, 2], [0, 1]))
    np.testing.assert_allclose(fit.scores, expected, atol=1e-6)
    assert (np.linalg.eigvalsh(fit.score_covariance) > -1e-9).all()


@pytest.mark.parametrize("factor", [1000.0, 10.0, 0.1, 0.001])
def test_wrong_units_are_named(prior, factor):
    points = factor * prior.mean[: len(prior.model.mean)]
    centres = LandmarkTarget(
        tuple(prior.centres), factor * np.array([prior.mean[k] for k in prior.centres.values()])
    )
    numbered = LandmarkTarget(("3", "50", "120"), points[[3, 50, 120]])
    for target in (surface_of(prior, points), CloudTarget(points), centres, numbered):
        with pytest.raises(InputError, match="about .* times that: state the units of the file"):
            fit_shape(prior, [target])


def test_a_small_piece_of_a_surface_is_no_wrong_unit(prior):
    points = prior.mean[: len(prior.model.mean)]
    near = np.linalg.norm(points - points[200], axis=1) < 0.2 * prior.size
    assert near.sum() > 10
    assert 0.02 < checked_size(points, [CloudTarget(0.2 * points[near])]) < 0.125


def test_what_the_model_has_not_is_refused(prior):
    points, faces = prior.mean[: len(prior.model.mean)], prior.model.mesh.faces
    with pytest.raises(InputError, match="part of a target"):
        fit_shape(prior, [SurfaceTarget(points, faces, {}, "RV")])
    with pytest.raises(InputError, match="opening of a target"):
        fit_shape(prior, [SurfaceTarget(points, faces, {"LV.x": boundary_loops(faces)[0]})])
    with pytest.raises(InputError, match="at least one target"):
        fit_shape(prior, [])


def test_empty_targets_are_refused():
    with pytest.raises(InputError, match="found none"):
        CloudTarget(np.zeros((0, 3)))
    with pytest.raises(InputError, match="found none"):
        ContourTarget((np.zeros((0, 3)),))
    with pytest.raises(InputError, match="found none"):
        LandmarkTarget((), np.zeros((0, 3)))
    with pytest.raises(InputError, match="found none"):
        SurfaceTarget(np.zeros((3, 3)), np.zeros((0, 3), dtype=int), {})


def test_six_short_axis_contours_give_a_real_ventricle(shared_data):
    """One patient, 25 phases in vertex correspondence; five phases in a row left out."""
    folder = shared_data / "lv-cine"
    files = sorted(folder.glob("*_LV_ENDOCARDIAL_*.vtk"))
    raw = [read_mesh(path) for path in files]
    faces = raw[0].faces
    shapes = np.stack([mesh.vertices for mesh in raw])
    test = [10, 12, 14]
    train = [k for k in range(len(files)) if not 10 <= k < 15]
    areas = np.bincount(
        faces.ravel(), np.repeat(face_areas(shapes[0], faces) / 3.0, 3), len(shapes[0])
    )
    rims = {f"LV.{k}": np.asarray(loop) for k, loop in enumerate(boundary_loops(faces))}
    mesh = ModelMesh(
        faces, np.zeros(len(faces), int), np.zeros(shapes.shape[1], int), ("LV",), rims
    )
    model = fit_model(shapes[train], areas / areas.sum(), mesh)
    prior = fit_prior(StoredModel(model, np.empty((0, len(model.modes))), (), None))
    axis = np.linalg.svd(shapes[0] - shapes[0].mean(axis=0), full_matrices=False)[2]
    for k in test:
        own = shapes[k] @ axis.T[:, [1, 2, 0]]  # long axis last
        middle = np.append(own[:, :2].mean(axis=0), 0.0)
        levels = np.linspace(own[:, 2].min(), own[:, 2].max(), 13)[1::2]
        rings = sliced(prior, own - middle, levels)
        back = axis.T[:, [1, 2, 0]].T
        target = ContourTarget(tuple((ring + middle) @ back for ring in rings))
        fit = fit_shape(prior, [target])
        distance = surface_distances(fit.points[None], faces, shapes[k], faces)[0].mean
        assert distance < 0.6
        assert distance < 0.3 * surface_distances(model.mean[None], faces, shapes[k], faces)[0].mean


def test_the_mesh_of_the_template_is_the_models(stored):
    assert stored.template is not None
    np.testing.assert_array_equal(mesh_of_template(stored.template).faces, stored.model.mesh.faces)


def test_contours_whose_pairs_swap_to_and_fro_settle(prior):
    for seed in range(4):
        truth = drawn_shape(prior, np.random.default_rng(seed))
        levels = np.linspace(*np.percentile(truth[:, 2], [10.0, 90.0]).tolist(), 5)  # type: ignore[call-overload]
        fit = fit_shape(prior, [ContourTarget(sliced(prior, truth, levels))])
        assert fit.status is FitStatus.CONVERGED
