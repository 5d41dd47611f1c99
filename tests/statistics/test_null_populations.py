"""Where there is no effect, p-values are uniform: Kolmogorov-Smirnov over seeded populations.

Each case draws 300 populations without an effect. With 199 permutations the p-values lie on a grid
of 1/200, which moves the distribution function by at most 0.005; the 1 % point of the statistic
for 300 values is 0.094. The bite tests show that the same check refuses a test that is wrong.
"""

import numpy as np
import pytest
from scipy.stats import kstest

from ostiform.model import ModelMesh, ShapeModel, StoredModel
from ostiform.statistics import (
    Covariate,
    covariate_of,
    design_of,
    permutations,
    point_test,
    score_test,
    subject_shapes,
)
from ostiform.study import ShapeId

POPULATIONS = 300
PERMUTATIONS = 199
LEVEL = 0.01
SPREAD = np.exp(-0.4 * np.arange(9))
"""Standard deviations of the scores, falling as those of shapes do."""

POINT = ShapeModel(
    mean=np.zeros((1, 3)),
    modes=np.eye(3)[:, None, :],
    variances=np.array([3.0, 2.0, 1.0]),
    weights=np.ones(1),
    mesh=ModelMesh(
        np.empty((0, 3), dtype=np.int64),
        np.empty(0, dtype=np.int64),
        np.zeros(1, dtype=np.int64),
        ("dot",),
        {},
    ),
    residual_variance=0.0,
    sample_count=0,
)


def p_values(draw):
    """Return the p-values of the whole shape and of one point for every population."""
    found = []
    for seed in range(POPULATIONS):
        rng = np.random.default_rng([1983, seed])
        scores, design = draw(rng)
        orders = permutations(len(scores), PERMUTATIONS, rng)
        whole = score_test(scores, design, orders).p_value
        points = point_test(scores[:, None, :3], design, orders)
        along = point_test(scores[:, None, :1], design, orders)
        found.append((whole, points.p_value[0], along.p_value[0]))
    return np.array(found)


def assert_uniform(values):
    for column in values.T:
        assert kstest(column, "uniform").pvalue > LEVEL


def groups(rng):
    scores = rng.normal(size=(24, 9)) * SPREAD
    return scores, design_of(covariate_of("group", ["a", "b"] * 12))


def few_subjects(rng):
    """Eight: of an age each, for two groups of four have only 35 different divisions."""
    scores = rng.normal(size=(8, 9)) * SPREAD
    return scores, design_of(Covariate("age", rng.uniform(20.0, 80.0, size=8)))


def three_groups_with_heavy_tails(rng):
    scores = rng.standard_t(3, size=(24, 9)) * SPREAD
    return scores, design_of(covariate_of("group", ["a", "b", "c"] * 8))


def age(rng):
    scores = rng.normal(size=(24, 9)) * SPREAD
    return scores, design_of(Covariate("age", rng.uniform(20.0, 80.0, size=24)))


def nuisance(rng):
    """Age shapes the heart and goes with ejection fraction, which itself does nothing."""
    years = rng.uniform(20.0, 80.0, size=24)
    sex = np.tile([0.0, 1.0], 12)
    fraction = 80.0 - 0.3 * years + rng.normal(scale=5.0, size=24)
    scores = rng.normal(size=(24, 9)) * SPREAD
    scores += 0.1 * np.outer(years, SPREAD) + 2.0 * np.outer(sex, SPREAD[::-1])
    adjusted = [Covariate("age", years), Covariate("sex", sex, ("f", "m"))]
    return scores, design_of(Covariate("fraction", fraction), adjusted)


def repeated_phases(rng, subjects=16):
    """Two to six phases of each subject, far more alike than those of different subjects."""
    ids, scores = [], []
    for subject in range(subjects):
        own = rng.normal(size=3) * [2.0, 1.5, 1.0]
        count = int(rng.integers(2, 7))
        for phase in range(count):
            ids.append(ShapeId(f"S{subject}", str(phase), phase / count))
            scores.append(own + 0.2 * rng.normal(size=3))
    return StoredModel(POINT, np.array(scores), tuple(ids), None)


def subjects_with_phases(rng):
    stored = repeated_phases(rng)
    return subject_shapes(stored).scores, design_of(covariate_of("group", ["a", "b"] * 8))


@pytest.mark.parametrize(
    "draw",
    [groups, few_subjects, three_groups_with_heavy_tails, age, nuisance, subjects_with_phases],
)
def test_p_values_are_uniform_where_there_is_no_effect(draw):
    assert_uniform(p_values(draw))


def test_the_check_bites_where_phases_are_shuffled_as_if_they_were_subjects():
    def shapes_as_subjects(rng):
        stored = repeated_phases(rng)
        labels = ["ab"[int(id.subject[1:]) % 2] for id in stored.ids]
        return stored.scores, design_of(covariate_of("group", labels))

    with pytest.raises(AssertionError):
        assert_uniform(p_values(shapes_as_subjects))


def test_the_check_bites_where_nuisance_is_not_adjusted_for():
    def unadjusted(rng):
        scores, design = nuisance(rng)
        return scores, design_of(Covariate("fraction", design.interest[:, 0]))

    with pytest.raises(AssertionError):
        assert_uniform(p_values(unadjusted))


def test_family_p_values_are_uniform_where_there_is_no_effect_anywhere():
    smallest = []
    for seed in range(POPULATIONS):
        rng = np.random.default_rng([1993, seed])
        values = rng.normal(size=(20, 40, 3)) + rng.normal(size=(20, 1, 3))  # points go together
        orders = permutations(20, PERMUTATIONS, rng)
        design = design_of(covariate_of("group", ["a", "b"] * 10))
        smallest.append(point_test(values, design, orders).family_p_value.min())
    assert_uniform(np.array(smallest)[:, None])
