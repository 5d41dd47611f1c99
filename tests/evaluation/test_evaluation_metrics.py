"""Distances, compactness, specificity, coverage, truth: closed forms and second routes."""

import numpy as np
import pytest

from ostiform.errors import InputError
from ostiform.evaluation import (
    Compactness,
    OriginalMesh,
    distance_to_truth,
    model_compactness,
    model_specificity,
    population_coverage,
    shape_coverage,
    surface_distances,
    truth,
)
from ostiform.evaluation.distances import diameter
from ostiform.model import fit_model, mesh_of_template, reconstruct, sample_scores, truncated
from ostiform.surface.quantiles import weighted_quantile
from tests.populations import area_weights, population, two_part_template

ROUNDING = 1e-10


def plane(size, count, height=0.0):
    ticks = np.linspace(0.0, size, count)
    x, y = np.meshgrid(ticks, ticks, indexing="ij")
    points = np.stack([x, y, np.full_like(x, height)], axis=2).reshape(-1, 3)
    index = np.arange(count**2).reshape(count, count)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)
    return points, faces


def test_the_distance_of_parallel_planes_is_their_gap():
    points, faces = plane(10.0, 6)
    other, other_faces = plane(10.0, 9, height=0.7)
    (distance,) = surface_distances(points[None], faces, other, other_faces)
    np.testing.assert_allclose([distance.mean, distance.p95, distance.maximum], 0.7, rtol=ROUNDING)


def test_the_surface_distance_is_the_mean_of_both_directions_and_pools_the_rest():
    # A unit square over a square of side 3: from the small one the gap is h everywhere; from the
    # large one it is h where they overlap and more outside.
    small, small_faces = plane(1.0, 21, height=0.5)
    large, large_faces = plane(3.0, 61)
    (distance,) = surface_distances(small[None], small_faces, large, large_faces)
    outside = np.hypot(
        0.5, np.linalg.norm(np.maximum(large[:, :2] - 1.0, 0.0), axis=1)
    )  # distance of the large square's vertices
    weights = area_weights(large, large_faces)
    np.testing.assert_allclose(distance.mean, 0.5 * (0.5 + weights @ outside), rtol=1e-9)
    np.testing.assert_allclose(distance.maximum, np.hypot(0.5, np.hypot(2.0, 2.0)), rtol=1e-9)
    # Half of the weight is at h, so 95 % of the pool is 90 % of the large square.
    np.testing.assert_allclose(distance.p95, weighted_quantile(outside, weights, 0.90), rtol=0.02)


def test_the_surface_distance_does_not_depend_on_the_order_of_its_arguments():
    small, small_faces = plane(1.0, 21, height=0.5)
    large, large_faces = plane(3.0, 61)
    (one,) = surface_distances(small[None], small_faces, large, large_faces)
    (two,) = surface_distances(large[None], large_faces, small, small_faces)
    np.testing.assert_allclose([two.mean, two.maximum], [one.mean, one.maximum], rtol=ROUNDING)


def test_the_surface_distance_does_not_depend_on_mesh_density():
    slanted, faces = plane(10.0, 81)
    slanted = slanted + slanted[:, :1] * np.array([0.0, 0.0, 0.1])  # rises by 1 over 10
    crowded = slanted.copy()
    crowded[:, 0] = 10.0 * (crowded[:, 0] / 10.0) ** 3  # most vertices near x = 0
    crowded[:, 2] = 0.1 * crowded[:, 0]
    flat, flat_faces = plane(10.0, 3)
    even, uneven = surface_distances(np.stack([slanted, crowded]), faces, flat, flat_faces)
    np.testing.assert_allclose(uneven.mean, even.mean, rtol=0.02)


@pytest.mark.parametrize(
    ("share", "expected"), [(0.0, 1.0), (0.25, 1.0), (0.26, 2.0), (0.5, 2.0), (0.51, 7.0), (1, 7)]
)
def test_a_weighted_quantile_is_reached_by_its_share_of_the_weight(share, expected):
    values, weights = np.array([7.0, 1.0, 2.0]), np.array([2.0, 1.0, 1.0])
    assert weighted_quantile(values, weights, share) == expected


def test_a_quantile_of_nothing_is_refused():
    for values in (np.empty(0), np.ones(2)):
        with pytest.raises(InputError, match="positive weight"):
            weighted_quantile(values, np.zeros(len(values)), 0.5)


def test_the_diameter_is_the_diagonal_of_the_bounding_box():
    assert diameter(np.array([[0.0, 0, 0], [3, 4, 0], [1, 1, 12]])) == 13.0


def test_compactness_accumulates_the_variances_to_the_total():
    shapes = population(3, 4, np.random.default_rng(1))
    model = fit_model(shapes.aligned, shapes.weights, mesh_of_template(shapes.template))
    short = model_compactness(truncated(model, 4))
    np.testing.assert_allclose(short.cumulative[-1] + model.variances[4:].sum(), short.total)
    np.testing.assert_allclose(short.total, model.total_variance, rtol=ROUNDING)


def test_the_number_of_modes_for_a_share_is_the_smallest_that_reaches_it():
    compact = Compactness(np.array([6.0, 3.0, 1.0]), 12.0)
    found = [compact.modes_for(share) for share in (0.1, 0.5, 0.6, 0.75, 0.8, 0.9)]
    assert found == [1, 1, 2, 2, 3, 4]


def test_specificity_by_scores_equals_specificity_by_points():
    shapes = population(3, 3, np.random.default_rng(5))
    model = truncated(
        fit_model(shapes.aligned, shapes.weights, mesh_of_template(shapes.template)), 4
    )
    found = model_specificity(model, shapes.aligned, np.random.default_rng(8), 60, (0, 2))
    np.testing.assert_array_equal(found.mode_counts, [0, 2, 4])
    scores = sample_scores(model, 60, np.random.default_rng(8), limit=3.0)
    for column, count in enumerate((0, 2, 4)):
        samples = reconstruct(model, scores[:, :count])
        squared = ((samples[:, None] - shapes.aligned) ** 2).sum(axis=3) @ model.weights  # (S, N)
        nearest = np.sqrt(squared.min(axis=1))
        np.testing.assert_allclose(found.mean[column], nearest.mean(), rtol=1e-9)
        np.testing.assert_allclose(
            found.standard_error[column], nearest.std(ddof=1) / np.sqrt(60), rtol=1e-6, atol=1e-9
        )


def test_specificity_scales_with_the_shapes():
    shapes = population(3, 3, np.random.default_rng(5))
    mesh = mesh_of_template(shapes.template)
    one, ten = (
        model_specificity(
            fit_model(scale * shapes.aligned, shapes.weights, mesh),
            scale * shapes.aligned,
            np.random.default_rng(8),
            100,
        ).mean
        for scale in (1.0, 10.0)
    )
    np.testing.assert_allclose(ten, 10.0 * one, rtol=1e-6)


def test_a_surface_sampled_at_its_own_vertices_is_covered_exactly():
    template = two_part_template()
    points = 40.0 * template.points
    found = shape_coverage(OriginalMesh(points, template.faces), points, points, template.faces)
    np.testing.assert_allclose([found.p95, found.maximum], 0.0, atol=1e-12)
    assert found.smallest_share_ratio == 1.0
    shares = area_weights(points, template.faces)
    np.testing.assert_allclose(found.smallest_share, shares.min() * len(shares), rtol=ROUNDING)


def test_coverage_sees_points_that_abandon_a_region():
    original = two_part_template(33, 48)
    template = two_part_template(9, 16)
    good = 40.0 * template.points
    latitude = np.arcsin(template.points[:, 2])
    squeezed = np.minimum(latitude, np.radians(30.0) + 0.1 * (latitude - np.radians(30.0)))
    lift = np.cos(squeezed) / np.cos(latitude)
    bad = 40.0 * np.column_stack([template.points[:, :2] * lift[:, None], np.sin(squeezed)])
    mesh = OriginalMesh(40.0 * original.points, original.faces)
    before = shape_coverage(mesh, good, good, template.faces)
    after = shape_coverage(mesh, bad, good, template.faces)
    assert after.p95 > 5.0 * before.p95
    assert after.smallest_share_ratio < 0.5
    # The farthest original point is the rim at 60 degrees, the sampling ends at 33: a chord.
    chord = 2.0 * 40.0 * np.sin(np.radians(60.0 - 33.0) / 2.0)
    np.testing.assert_allclose(after.maximum, chord, rtol=0.02)


def ellipsoid_maps(semi_axes):
    """Return the true maps of ellipsoids: material coordinates are unit vectors."""

    def to_material(id, part, points):
        directions = points / semi_axes[int(id.subject.split()[1])]
        return directions / np.linalg.norm(directions, axis=1, keepdims=True)

    def from_material(id, part, material):
        return material * semi_axes[int(id.subject.split()[1])]

    return to_material, from_material


def true_population(count, rng, turn=0.0):
    """Return ellipsoids in true correspondence, the upper part of shape 0 turned about z."""
    template = two_part_template()
    semi_axes = rng.uniform(30.0, 50.0, size=(count, 3))
    shapes = population(count, 1, rng, template)
    directions = np.repeat(template.points[None], count, axis=0)
    upper = template.part == 1
    rotation = np.array(
        [[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]]
    )
    directions[0, upper] = directions[0, upper] @ rotation.T
    points = directions * semi_axes[:, None]
    moved = type(shapes)(
        template, shapes.ids, directions, points, points, shapes.transforms, shapes.weights
    )
    return moved, semi_axes


def test_the_true_correspondence_has_no_distance_to_itself(rng):
    shapes, semi_axes = true_population(4, rng)
    found = distance_to_truth(shapes, *ellipsoid_maps(semi_axes))
    assert found.mean < 1e-12 * 50.0
    assert found.p95 < 1e-12 * 50.0


def test_the_distance_to_truth_is_the_mean_over_ordered_pairs_by_the_definition(rng):
    shapes, semi_axes = true_population(4, rng, turn=0.2)
    found = distance_to_truth(shapes, *ellipsoid_maps(semi_axes))
    means, pooled = [], []
    for i in range(4):
        for j in range(4):
            if i != j:
                carried = shapes.points[i] / semi_axes[i] * semi_axes[j]
                errors = np.linalg.norm(carried - shapes.points[j], axis=1)
                means.append(shapes.weights @ errors)
                pooled.append(errors)
    np.testing.assert_allclose(found.mean, np.mean(means), rtol=1e-9)
    np.testing.assert_allclose(found.p95, np.percentile(pooled, 95.0), rtol=1e-6)


def test_the_distance_to_truth_of_a_turned_part_is_that_part_s_alone(rng):
    shapes, semi_axes = true_population(4, rng, turn=0.2)
    found = distance_to_truth(shapes, *ellipsoid_maps(semi_axes))
    assert found.parts["LV"][0] < 1e-12 * 50.0
    share = shapes.weights[shapes.template.part == 1].sum()
    np.testing.assert_allclose(found.parts["LA"][0] * share, found.mean, rtol=1e-9)


def test_a_part_of_the_points_shows_the_distance_to_truth(rng, monkeypatch):
    shapes, semi_axes = true_population(4, rng, turn=0.2)
    every = distance_to_truth(shapes, *ellipsoid_maps(semi_axes))
    monkeypatch.setattr(truth, "MOST_POINTS", len(shapes.template.points) // 3)
    third = distance_to_truth(shapes, *ellipsoid_maps(semi_axes))
    assert third.mean != every.mean
    np.testing.assert_allclose(third.mean, every.mean, rtol=0.05)
    np.testing.assert_allclose(third.parts["LA"][0], every.parts["LA"][0], rtol=0.05)


def test_one_shape_has_no_distance_to_truth(rng):
    shapes, semi_axes = true_population(1, rng)
    with pytest.raises(InputError, match="at least 2 shapes"):
        distance_to_truth(shapes, *ellipsoid_maps(semi_axes))


def test_a_population_is_covered_as_its_shapes_are_one_by_one(rng):
    shapes = population(2, 2, rng)
    faces = shapes.template.faces
    initial = shapes.points + rng.normal(scale=0.1, size=shapes.points.shape)
    originals = [OriginalMesh(points, faces) for points in shapes.points + 0.3]
    found = population_coverage(originals, shapes.points, initial, faces)
    for one, own in zip(found, zip(originals, shapes.points, initial, strict=True), strict=True):
        alone = shape_coverage(*own, faces)
        np.testing.assert_allclose(one.p95, alone.p95, rtol=1e-12)
        np.testing.assert_allclose(one.maximum, alone.maximum, rtol=1e-12)
        assert one.smallest_share_ratio == alone.smallest_share_ratio


def test_of_very_many_shapes_the_pairs_of_some_are_measured(rng, monkeypatch):
    shapes, semi_axes = true_population(5, rng, turn=0.2)
    monkeypatch.setattr(truth, "MOST_SHAPES", 2)
    found = distance_to_truth(shapes, *ellipsoid_maps(semi_axes))
    errors = [
        np.linalg.norm(shapes.points[i] / semi_axes[i] * semi_axes[j] - shapes.points[j], axis=1)
        for i, j in ((0, 4), (4, 0))
    ]
    np.testing.assert_allclose(found.mean, np.mean(errors @ shapes.weights), rtol=1e-9)
