"""Where a left-out shape is put: its subject's own pose, if other phases of it were trained on."""

from types import SimpleNamespace
from typing import cast

import numpy as np

from ostiform.correspondence.frozen import FrozenModel
from ostiform.study import ShapeId

IDS = [ShapeId(subject, phase, 0.0) for subject in "AB" for phase in "012"]
TRANSFORMS = np.stack([np.diag([1.0, 1.0, 1.0, 1.0 + index]) for index in range(len(IDS))])


def transform_without(left_out, subject, jointly=True):
    """The known transform of a subject in a model of all shapes but some."""
    train = [index for index in range(len(IDS)) if index not in left_out]
    model = SimpleNamespace(
        jointly=jointly, ids=[IDS[index] for index in train], transforms=TRANSFORMS[train]
    )
    return FrozenModel.transform_of(cast(FrozenModel, model), subject)


def test_left_out_phases_take_the_pose_of_the_phases_trained_on():
    np.testing.assert_array_equal(transform_without([1], "A"), TRANSFORMS[0])
    np.testing.assert_array_equal(transform_without([3, 4], "B"), TRANSFORMS[5])


def test_a_new_subject_is_fitted():
    assert transform_without([0, 1, 2], "A") is None


def test_shapes_aligned_one_by_one_are_fitted():
    assert transform_without([1], "A", jointly=False) is None
