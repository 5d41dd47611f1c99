"""Weighted generalised Procrustes: closed forms, invariances, two routes, every error."""

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from ostiform.correspondence.alignment import AlignmentStatus, align, align_to
from ostiform.domain.procrustes import best_rotations, transformed
from ostiform.errors import InputError

# Rounding of sums over a few dozen points; the iteration stops at 1e-12 of the size.
ROUNDING = 1e-9


def population(rng, n_shapes=6, n_points=40, spread=0.15):
    base = rng.normal(size=(n_points, 3)) * [3.0, 2.0, 1.0]
    return base + spread * rng.normal(size=(n_shapes, n_points, 3))


def weights_of(rng, n_points=40):
    weights = rng.uniform(0.2, 2.0, n_points)
    return weights / weights.sum()


def random_motion(rng, scale=1.0):
    motion = np.eye(4)
    motion[:3, :3] = scale * Rotation.random(random_state=rng).as_matrix()
    motion[:3, 3] = 20.0 * rng.normal(size=3)
    return motion


def moved(points, motions):
    return np.stack([transformed(p, m) for p, m in zip(points, motions, strict=True)])


def pairwise_differences(aligned):
    """All inner products of centred shapes: what one global motion cannot change."""
    flat = aligned - aligned.mean(axis=(0, 1))
    return np.einsum("npi,mqi->nmpq", flat, flat)


def test_a_known_motion_is_recovered(rng):
    points = population(rng, 1)
    motion = random_motion(rng)
    found = align_to(points, transformed(points[0], motion), weights_of(rng))
    np.testing.assert_allclose(found, motion, atol=ROUNDING)


def test_a_known_similarity_is_recovered(rng):
    points = population(rng, 3)
    motion = random_motion(rng, scale=1.7)
    targets = moved(points, [motion] * 3)
    found = align_to(points, targets, weights_of(rng), "similarity")
    np.testing.assert_allclose(found, motion, atol=ROUNDING)


@pytest.mark.parametrize("mode", ["rigid", "similarity"])
def test_the_closed_form_agrees_with_a_numerical_minimum(rng, mode):
    points, weights = population(rng, 2, 12, 0.5), weights_of(rng, 12)
    targets = moved(population(rng, 2, 12, 0.5), [random_motion(rng)] * 2)

    def cost(parameters):
        scale = np.exp(parameters[6]) if mode == "similarity" else 1.0
        rotation = Rotation.from_rotvec(parameters[:3]).as_matrix()
        placed = scale * points @ rotation.T + parameters[3:6]
        return np.einsum("p,npi->", weights, (placed - targets) ** 2)

    starts = [np.r_[r.as_rotvec(), np.zeros(4)] for r in Rotation.create_group("O")]
    least = min(minimize(cost, start, method="BFGS").fun for start in starts)
    placed = transformed(points, np.stack([align_to(points, targets, weights, mode)] * 2))
    found = np.einsum("p,npi->", weights, (placed - targets) ** 2)
    np.testing.assert_allclose(found, least, rtol=1e-8)


def test_the_rotation_is_proper_even_where_a_reflection_fits_better(rng):
    points = population(rng, 1)
    mirrored = points[0] * [1.0, 1.0, -1.0]
    found = align_to(points, mirrored, weights_of(rng))
    np.testing.assert_allclose(np.linalg.det(found[:3, :3]), 1.0, rtol=1e-12)


def test_best_rotations_reach_the_stated_gain(rng):
    correlations = rng.normal(size=(50, 3, 3))
    rotations, gains = best_rotations(correlations)
    np.testing.assert_allclose(np.linalg.det(rotations), 1.0, rtol=1e-12)
    np.testing.assert_allclose(
        np.einsum("nij,nji->n", rotations, correlations), gains.sum(axis=1), atol=1e-12
    )
    others = Rotation.random(200, random_state=rng).as_matrix()
    reached = np.einsum("kij,nji->nk", others, correlations)
    assert (reached <= gains.sum(axis=1)[:, None] + 1e-12).all()


@pytest.mark.parametrize("mode", ["rigid", "similarity"])
def test_moving_groups_rigidly_changes_the_result_by_one_global_motion_only(rng, mode):
    points, weights = population(rng), weights_of(rng)
    groups = np.array([0, 0, 1, 1, 1, 2])
    motions = [random_motion(rng) for _ in range(3)]
    before = align(points, weights, mode, groups)
    after = align(moved(points, [motions[g] for g in groups]), weights, mode, groups)
    np.testing.assert_allclose(
        pairwise_differences(after.aligned), pairwise_differences(before.aligned), atol=1e-7
    )


def test_similarity_also_removes_the_size_of_a_group(rng):
    points, weights = population(rng), weights_of(rng)
    before = align(points, weights, "similarity")
    motions = [random_motion(rng, scale) for scale in (1.3, 0.8, 1.0, 1.1, 0.9, 0.7)]
    after = align(moved(points, motions), weights, "similarity")
    ratio = np.linalg.norm(after.mean - after.mean.mean(0)) / np.linalg.norm(
        before.mean - before.mean.mean(0)
    )
    np.testing.assert_allclose(
        pairwise_differences(after.aligned),
        ratio**2 * pairwise_differences(before.aligned),
        atol=1e-6,
    )


def test_similarity_keeps_the_mean_size(rng):
    points, weights = population(rng), weights_of(rng)
    points = points * np.linspace(0.7, 1.4, len(points))[:, None, None]
    aligned = align(points, weights, "similarity").aligned

    def mean_size(shapes):
        centred = shapes - np.einsum("p,npi->ni", weights, shapes)[:, None]
        return np.sqrt(np.einsum("p,npi->n", weights, centred**2)).mean()

    np.testing.assert_allclose(mean_size(aligned), mean_size(points), rtol=ROUNDING)


@pytest.mark.parametrize("mode", ["rigid", "similarity", "none"])
def test_the_order_of_the_shapes_does_not_matter(rng, mode):
    points, weights = population(rng), weights_of(rng)
    points = moved(points, [random_motion(rng) for _ in points])
    groups = np.array([0, 0, 1, 2, 2, 3])
    order = rng.permutation(len(points))
    before = align(points, weights, mode, groups)
    after = align(points[order], weights, mode, groups[order])
    np.testing.assert_allclose(after.aligned, before.aligned[order], atol=ROUNDING)


def test_two_shapes_equally_far_from_their_mean_have_one_reference(rng):
    points, weights = population(rng, 2), weights_of(rng)
    before, after = align(points, weights), align(points[::-1], weights)
    assert before.reference == 1 - after.reference
    np.testing.assert_allclose(after.aligned, before.aligned[::-1], atol=ROUNDING)


def test_the_frame_is_the_input_frame_of_the_reference(rng):
    points = population(rng)
    found = align(points, weights_of(rng))
    np.testing.assert_allclose(found.transforms[found.reference], np.eye(4), atol=0)
    np.testing.assert_allclose(found.aligned[found.reference], points[found.reference])


def test_scaling_the_input_scales_the_result(rng):
    points, weights = population(rng), weights_of(rng)
    one, thousand = align(points, weights), align(1000.0 * points, weights)
    np.testing.assert_allclose(thousand.aligned, 1000.0 * one.aligned, rtol=1e-9, atol=1e-6)


def test_the_transforms_make_the_aligned_shapes_and_their_mean(rng):
    points = population(rng)
    found = align(points, weights_of(rng), "similarity", np.array([5, 5, 5, 9, 9, 9]))
    np.testing.assert_allclose(transformed(points, found.transforms), found.aligned)
    np.testing.assert_allclose(found.aligned.mean(axis=0), found.mean)
    np.testing.assert_allclose(found.transforms[0], found.transforms[2], atol=0)


def test_the_motion_of_a_group_is_kept(rng):
    """A subject that only translates between phases keeps its translation: closed form."""
    weights = weights_of(rng)
    base = population(rng, 1)[0]
    path = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0]])
    subject = base + path[:, None, :]
    points = np.concatenate([subject, moved(subject, [random_motion(rng)] * 3)])
    jointly = align(points, weights, "rigid", np.repeat([0, 1], 3)).aligned
    np.testing.assert_allclose(jointly[3:], jointly[:3], atol=ROUNDING)
    np.testing.assert_allclose(np.linalg.norm(jointly[1] - jointly[0], axis=1), 1.0, atol=ROUNDING)
    one_by_one = align(points, weights, "rigid").aligned
    np.testing.assert_allclose(one_by_one[1], one_by_one[0], atol=ROUNDING)


def test_every_group_is_at_its_best_position_to_the_mean(rng):
    """Theorem: at the minimum no single group can be moved nearer to the mean."""
    points, weights = population(rng), weights_of(rng)
    groups = np.array([0, 0, 1, 1, 2, 2])
    found = align(moved(points, [random_motion(rng)] * 6), weights, "rigid", groups)
    assert found.status is AlignmentStatus.CONVERGED
    for group in range(3):
        again = align_to(found.aligned[groups == group], found.mean, weights)
        np.testing.assert_allclose(again, np.eye(4), atol=1e-8)


def test_a_mirrored_shape_is_reported_and_not_reflected(rng):
    points = population(rng)
    points[4] *= [-1.0, 1.0, 1.0]
    found = align(points, weights_of(rng))
    np.testing.assert_array_equal(found.mirrored, np.arange(6) == 4)
    np.testing.assert_allclose(np.linalg.det(found.transforms[:, :3, :3]), 1.0, rtol=1e-12)


def test_a_flat_shape_is_not_called_mirrored(rng):
    points = population(rng) * [1.0, 1.0, 0.0]
    assert not align(points, weights_of(rng)).mirrored.any()


def test_weights_count_relative_to_their_sum(rng):
    points, weights = population(rng), weights_of(rng)
    np.testing.assert_allclose(
        align(points, 7.0 * weights).aligned, align(points, weights).aligned, atol=ROUNDING
    )


def test_no_alignment_leaves_the_shapes_where_they_are(rng):
    points = population(rng)
    found = align(points, weights_of(rng), "none")
    assert found.status is AlignmentStatus.NOT_ALIGNED
    np.testing.assert_array_equal(found.aligned, points)
    np.testing.assert_array_equal(align_to(points, points[0], weights_of(rng), "none"), np.eye(4))


def test_the_iteration_limit_is_told(rng):
    found = align(population(rng, spread=1.0), weights_of(rng), max_iterations=1)
    assert found.status is AlignmentStatus.ITERATION_LIMIT


def test_a_single_shape_stays_where_it_is(rng):
    points = population(rng, 1)
    np.testing.assert_allclose(align(points, weights_of(rng)).aligned, points)


def test_the_inputs_are_not_changed(rng):
    points, weights = population(rng), weights_of(rng)
    copies = points.copy(), weights.copy()
    align(points, weights, "similarity")
    np.testing.assert_array_equal(points, copies[0])
    np.testing.assert_array_equal(weights, copies[1])


def test_unusable_input_is_refused(rng):
    points, weights = population(rng), weights_of(rng)
    with pytest.raises(InputError, match="one of rigid, similarity, none"):
        align(points, weights, "affine")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="one of rigid, similarity, none"):
        align_to(points, points[0], weights, "affine")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="one label for each of 6"):
        align(points, weights, groups=[0, 1])
    with pytest.raises(InputError, match="not below zero"):
        align(points, -weights)
    with pytest.raises(InputError, match="positive sum"):
        align(points, 0.0 * weights)
    with pytest.raises(InputError, match="weights"):
        align(points, weights[1:])
    with pytest.raises(InputError, match="at least one shape"):
        align(points[:0], weights)
    with pytest.raises(InputError, match="NaN"):
        align(np.where(points > 3.0, np.nan, points), weights)
    with pytest.raises(InputError, match="at one position"):
        align(np.concatenate([points, np.ones_like(points[:1])]), weights)
    with pytest.raises(InputError, match="at one position"):
        align_to(np.ones_like(points), points[0], weights)
    with pytest.raises(InputError, match="target of the alignment"):
        align_to(points, points[:2], weights)
