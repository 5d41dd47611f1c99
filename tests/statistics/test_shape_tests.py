"""Tests of the whole shape and of its points: closed forms, second routes, invariance."""

import itertools

import numpy as np
import pytest
from scipy.stats import f as f_distribution

from ostiform.errors import InputError
from ostiform.statistics import (
    Covariate,
    covariate_of,
    design_of,
    permutation_p_value,
    permutations,
    point_test,
    score_test,
    shrinkage_intensity,
)

ROUNDING = 1e-8


def two_groups(n):
    return covariate_of("group", ["a", "b"] * (n // 2))


def hotelling(first, second):
    """Return T^2 of two samples by its definition."""
    count = len(first) + len(second)
    scatter = sum((x - x.mean(0)).T @ (x - x.mean(0)) for x in (first, second)) / (count - 2)
    difference = first.mean(0) - second.mean(0)
    ratio = len(first) * len(second) / count
    return ratio * difference @ np.linalg.solve(scatter, difference)


def lawley_hotelling(values, design):
    """Return d tr(H E^-1) from the fits of the two nested models."""
    full = np.concatenate([design.nuisance, design.interest], axis=1)
    reduced_scatter, full_scatter = (
        (lambda r: r.T @ r)(values - x @ np.linalg.lstsq(x, values, rcond=None)[0])
        for x in (design.nuisance, full)
    )
    effect = reduced_scatter - full_scatter
    return design.degrees * np.trace(np.linalg.solve(full_scatter, effect))


def test_for_two_groups_the_statistic_is_hotellings(rng):
    values = rng.normal(size=(30, 4)) @ rng.normal(size=(4, 4))
    design = design_of(two_groups(30))
    test = score_test(values, design, permutations(30, 99, rng), n_modes=4, shrinkage=0.0)
    np.testing.assert_allclose(test.statistic, hotelling(values[::2], values[1::2]), rtol=ROUNDING)


def test_the_permutation_p_value_agrees_with_the_f_distribution_of_normal_noise(rng):
    values = rng.normal(size=(40, 3))
    values[::2, 0] += 0.6
    design = design_of(two_groups(40))
    test = score_test(values, design, permutations(40, 9999, rng), n_modes=3, shrinkage=0.0)
    exact = f_distribution.sf(test.statistic * (40 - 3 - 1) / (38 * 3), 3, 36)
    # Binomial error of 9,999 permutations and the difference of the two distributions.
    assert abs(test.p_value - exact) < 0.015


def test_with_nuisance_and_several_columns_it_is_the_trace_of_nested_fits(rng):
    values = rng.normal(size=(24, 3))
    design = design_of(
        covariate_of("group", list("abcabcabcabcabcabcabcabc")),
        [Covariate("age", rng.normal(size=24)), two_groups(24)],
    )
    test = score_test(values, design, permutations(24, 9, rng), n_modes=3, shrinkage=0.0)
    np.testing.assert_allclose(test.statistic, lawley_hotelling(values, design), rtol=ROUNDING)
    points = point_test(np.stack([values, 2.0 * values], axis=1), design, permutations(24, 9, rng))
    np.testing.assert_allclose(points.statistic, test.statistic, rtol=1e-6)
    along = point_test(values[:, :1, None], design, permutations(24, 9, rng))
    np.testing.assert_allclose(
        along.statistic, lawley_hotelling(values[:, :1], design), rtol=ROUNDING
    )


def test_every_permuted_statistic_is_that_of_the_permuted_residuals_refitted(rng):
    values = rng.normal(size=(12, 2, 3))
    design = design_of(two_groups(12), [Covariate("age", rng.normal(size=12))])
    orders = permutations(12, 5, rng)
    flat = values.reshape(12, -1)
    fitted = design.nuisance @ np.linalg.lstsq(design.nuisance, flat, rcond=None)[0]
    residuals = flat - fitted
    expected = np.array(
        [
            [
                lawley_hotelling((fitted + residuals[order]).reshape(12, 2, 3)[:, p], design)
                for p in range(2)
            ]
            for order in orders
        ]
    )  # Freedman and Lane, as published: the fit is added back and the whole model fitted again
    test = point_test(values, design, orders)
    reached = (expected >= test.statistic).sum(axis=0)
    np.testing.assert_array_equal(test.p_value, (1 + reached) / 6)
    largest = expected.max(axis=1)
    family = [(1 + (largest >= value).sum()) / 6 for value in test.statistic]
    np.testing.assert_array_equal(test.family_p_value, family)
    lone = score_test(values[:, 0], design, orders, n_modes=3, shrinkage=0.0)
    np.testing.assert_allclose(lone.null, expected[:, 0], rtol=1e-6)


def test_all_permutations_together_give_the_exact_p_value(rng):
    values = rng.normal(size=(6, 1))
    design = design_of(two_groups(6))
    orders = np.array(list(itertools.permutations(range(6))))[1:]
    test = score_test(values, design, orders, n_modes=1)
    differences = [
        abs(values[list(chosen)].mean() - values[[k for k in range(6) if k not in chosen]].mean())
        for chosen in itertools.combinations(range(6), 3)
    ]
    observed = abs(values[::2].mean() - values[1::2].mean())
    expected = np.mean(np.array(differences) >= observed * (1 - 1e-12))
    np.testing.assert_allclose(test.p_value, expected, rtol=1e-12)


def test_rotation_scale_and_offset_of_the_shapes_change_nothing(rng):
    values = rng.normal(size=(20, 6)) * np.arange(6, 0, -1)
    design = design_of(two_groups(20))
    orders = permutations(20, 99, rng)
    rotation, _ = np.linalg.qr(rng.normal(size=(6, 6)))
    first = score_test(values, design, orders)
    second = score_test(1e3 * values @ rotation + 7.0, design, orders)
    np.testing.assert_allclose(second.null, first.null, rtol=1e-6)
    assert first.p_value == second.p_value
    assert first.n_modes == second.n_modes


def test_renaming_the_subjects_changes_the_statistic_not_at_all(rng):
    values, group = rng.normal(size=(16, 3)), two_groups(16)
    order = rng.permutation(16)
    first = score_test(values, design_of(group), permutations(16, 9, rng))
    renamed = Covariate("group", group.values[order], group.levels)
    second = score_test(values[order], design_of(renamed), permutations(16, 9, rng))
    np.testing.assert_allclose(first.statistic, second.statistic, rtol=ROUNDING)


def test_modes_hold_the_share_of_variance_and_leave_degrees_of_freedom(rng):
    values = rng.normal(size=(40, 20)) * 0.5 ** np.arange(20)
    test = score_test(values, design_of(two_groups(40)), permutations(40, 9, rng))
    assert test.variance_share >= 0.9
    few = score_test(rng.normal(size=(8, 20)), design_of(two_groups(8)), permutations(8, 9, rng))
    assert few.n_modes == 3  # half of the six degrees of freedom


def test_shrinkage_is_small_for_many_subjects_and_large_for_few(rng):
    many = shrinkage_intensity(rng.normal(size=(5000, 4)) * [4.0, 3.0, 2.0, 1.0])
    few = shrinkage_intensity(rng.normal(size=(6, 4)))
    assert many < 0.01 < few <= 1.0
    assert shrinkage_intensity(rng.normal(size=(9, 1))) == 0.0


def test_shrinkage_to_the_full_leaves_euclidean_distance_of_the_means(rng):
    values = rng.normal(size=(20, 3))
    design = design_of(two_groups(20))
    test = score_test(values, design, permutations(20, 9, rng), n_modes=3, shrinkage=1.0)
    first, second = values[::2], values[1::2]
    scatter = ((first - first.mean(0)) ** 2).sum() + ((second - second.mean(0)) ** 2).sum()
    between = 5.0 * ((first.mean(0) - second.mean(0)) ** 2).sum()
    np.testing.assert_allclose(test.statistic, 18 * between / (scatter / 3.0), rtol=ROUNDING)


def test_the_explained_share_is_one_where_the_covariate_is_all_there_is(rng):
    age = Covariate("age", rng.normal(size=10))
    values = age.values[:, None] * [1.0, 2.0] + 1e-6 * rng.normal(size=(10, 2))
    test = score_test(values, design_of(age), permutations(10, 999, rng), n_modes=1)
    np.testing.assert_allclose(test.explained, 1.0, rtol=1e-9)
    assert test.p_value == 1e-3


def test_p_values_count_the_data_among_the_permutations():
    null = np.array([[1.0], [2.0], [3.0 * (1.0 - 1e-12)]])
    assert permutation_p_value(np.array([3.0]), null)[0] == 0.5
    assert permutation_p_value(np.array([9.0]), null)[0] == 0.25


def test_a_point_that_does_not_move_is_never_found(rng):
    values = rng.normal(size=(12, 3, 3))
    values[:, 1] = 5.0
    values[:, 2, 2] = 0.0  # moves in a plane
    test = point_test(values, design_of(two_groups(12)), permutations(12, 99, rng))
    assert test.p_value[1] == 1.0
    assert np.isfinite(test.statistic).all()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda d, o: score_test(np.zeros((8, 2)), d, o), "found all equal"),
        (lambda d, o: score_test(np.ones((7, 2)), d, o), "scores of the subjects"),
        (lambda d, o: score_test(np.eye(8), d, o, n_modes=7), "found 7"),
        (lambda d, o: score_test(np.eye(8), d, o, n_modes=0), "found 0"),
        (lambda d, o: score_test(np.eye(8), d, o, shrinkage=1.5), "found 1.5"),
        (lambda d, o: point_test(np.zeros((8, 5, 2)), d, o), "found 2"),
        (lambda d, o: point_test(np.zeros((7, 5, 3)), d, o), "values at the points"),
    ],
)
def test_tests_refuse(call, message):
    design = design_of(two_groups(8))
    with pytest.raises(InputError, match=message):
        call(design, permutations(8, 9, np.random.default_rng(0)))


def test_too_few_subjects_for_three_coordinates_are_refused(rng):
    design = design_of(two_groups(4))
    with pytest.raises(InputError, match="at least 5 subjects"):
        point_test(rng.normal(size=(4, 5, 3)), design, permutations(4, 9, rng))
