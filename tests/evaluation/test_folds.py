"""Cross-validation: every shape is tested exactly once, never by a model that has seen it."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ostiform.errors import InputError
from ostiform.evaluation import Division, Fold, Folds, cross_validation_folds
from ostiform.study import ShapeId


def make_ids(phases_per_subject):
    return [
        ShapeId(f"s{subject}", f"p{phase}", phase / count)
        for subject, count in enumerate(phases_per_subject)
        for phase in range(count)
    ]


populations = st.lists(st.integers(1, 12), min_size=1, max_size=45).filter(
    lambda counts: sum(counts) >= 3 and not (len(counts) == 2 and sum(counts) < 4)
)


@given(populations)
def test_every_shape_is_held_out_exactly_once_and_never_trains_its_own_model(counts):
    ids = make_ids(counts)
    tested = []
    for fold in cross_validation_folds(ids).folds:
        tested.extend(fold.test)
        assert not set(fold.train) & set(fold.test)
        assert len(fold.train) + len(fold.test) == len(ids)
    assert sorted(tested) == list(range(len(ids)))


@given(populations)
def test_a_subject_is_left_out_with_all_its_phases(counts):
    ids = make_ids(counts)
    folds = cross_validation_folds(ids)
    for fold in folds.folds:
        trained = {ids[index].subject for index in fold.train}
        tested = {ids[index].subject for index in fold.test}
        if folds.division is not Division.PHASE_BLOCKS:
            assert not trained & tested


@pytest.mark.parametrize(
    ("subjects", "division", "count"),
    [
        (1, Division.PHASE_BLOCKS, 5),
        (2, Division.PHASE_BLOCKS, 10),
        (3, Division.SUBJECTS, 3),
        (20, Division.SUBJECTS, 20),
        (21, Division.SUBJECT_GROUPS, 10),
        (43, Division.SUBJECT_GROUPS, 10),
    ],
)
def test_the_number_of_folds_follows_the_number_of_subjects(subjects, division, count):
    folds = cross_validation_folds(make_ids([6] * subjects))
    assert (folds.division, len(folds.folds)) == (division, count)


@pytest.mark.parametrize(
    ("subjects", "most", "division", "count"),
    [
        (1, 3, Division.PHASE_BLOCKS, 3),
        (2, 3, Division.PHASE_BLOCKS, 2),
        (4, 10, Division.SUBJECTS, 4),
        (4, 2, Division.SUBJECT_GROUPS, 2),
        (43, 5, Division.SUBJECT_GROUPS, 5),
        (43, 50, Division.SUBJECTS, 43),
    ],
)
def test_there_are_at_most_as_many_folds_as_asked_for(subjects, most, division, count):
    folds = cross_validation_folds(make_ids([6] * subjects), most)
    assert (folds.division, len(folds.folds)) == (division, count)


def test_numbers_of_modes_end_where_the_smallest_fold_has_no_more():
    folds = cross_validation_folds(make_ids([2, 2, 4]))  # trained on 6, 6 and 4 shapes
    assert folds.mode_counts(10) == (0, 1, 2, 3)
    assert folds.mode_counts(2) == (0, 1, 2)


def test_blocks_of_phases_are_contiguous_in_time_whatever_the_order_of_the_study():
    ids = make_ids([25])[::-1]
    for fold in cross_validation_folds(ids).folds:
        phases = sorted(int(ids[index].phase[1:]) for index in fold.test)
        assert phases == list(range(phases[0], phases[0] + 5))


@pytest.mark.parametrize(
    ("folds", "message"),
    [
        ([Fold("a", (1, 2), (0,)), Fold("b", (0, 2), (1,))], "exactly once"),
        ([Fold("a", (2,), (0, 1)), Fold("b", (0,), (1, 2))], "exactly once"),
        ([Fold("a", (1, 2), (0, 1)), Fold("b", (0,), (2,))], "own training set"),
    ],
)
def test_wrong_folds_are_refused(folds, message):
    with pytest.raises(InputError, match=message):
        Folds(Division.SUBJECTS, 3, tuple(folds))


@pytest.mark.parametrize("counts", [[1], [2], [1, 1]])
def test_too_few_shapes_are_refused(counts):
    with pytest.raises(InputError, match="at least 2 training shapes"):
        cross_validation_folds(make_ids(counts))
