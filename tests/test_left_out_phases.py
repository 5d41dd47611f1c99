"""Where a left-out shape is put: its subject's own pose, if other phases of it were trained on."""

from types import SimpleNamespace

import numpy as np
import pytest

from ostiform.pipeline.evaluate import _known_transform
from ostiform.study import ShapeId

IDS = [ShapeId(subject, phase, 0.0) for subject in "AB" for phase in "012"]
TRANSFORMS = np.stack([np.diag([1.0, 1.0, 1.0, 1.0 + index]) for index in range(len(IDS))])


def known(test, per="subject"):
    train = [index for index in range(len(IDS)) if index not in test]
    training = SimpleNamespace(ids=[IDS[i] for i in train], transforms=TRANSFORMS[train])
    task = SimpleNamespace(
        settings=SimpleNamespace(per=per), shapes=[SimpleNamespace(id=id) for id in IDS]
    )
    return _known_transform(task, test, training)


def test_left_out_phases_take_the_pose_of_the_phases_trained_on():
    np.testing.assert_array_equal(known([1]), TRANSFORMS[0])
    np.testing.assert_array_equal(known([3, 4]), TRANSFORMS[5])


@pytest.mark.parametrize(("test", "per"), [([0, 1, 2], "subject"), ([1], "shape")])
def test_a_new_subject_and_shapes_aligned_one_by_one_are_fitted(test, per):
    assert known(test, per) is None
