import pickle  # noqa: TID251 (what multiprocessing uses)

import numpy as np
import pytest

from ostiform.arrays import frozen_floats, frozen_ints, frozen_mapping, read_only
from ostiform.errors import InputError


def test_frozen_arrays_are_read_only_copies_of_the_input():
    given = np.zeros((2, 3))
    frozen = frozen_floats(given, (None, 3), "points")
    given[0, 0] = 1.0
    assert frozen[0, 0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        frozen[0, 0] = 1.0


def test_a_frozen_array_is_not_copied_again():
    frozen = frozen_ints([[0, 1, 2]], (None, 3), "faces")
    assert frozen_ints(frozen, (1, 3), "faces") is frozen


@pytest.mark.parametrize("shape", [(2, 2), (3,), (3, 3)])
def test_a_wrong_shape_is_named(shape):
    with pytest.raises(InputError, match=r"points: expected an array of shape \(2, 3\), found"):
        frozen_floats(np.zeros(shape), (2, 3), "points")


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_numbers_that_are_not_finite_are_counted_and_located(bad):
    values = np.zeros((4, 3))
    values[2, 1] = bad
    with pytest.raises(InputError, match=r"found 1 that are NaN or infinite.*\(2, 1\)"):
        frozen_floats(values, (None, 3), "points")


def test_frozen_mappings_keep_order_refuse_change_and_travel_between_processes():
    mapping = frozen_mapping({"b": 1, "a": 2})
    assert list(mapping) == ["b", "a"]
    assert pickle.loads(pickle.dumps(mapping)) == {"b": 1, "a": 2}
    with pytest.raises(TypeError):
        mapping["c"] = 3  # type: ignore[index]


def test_a_read_only_view_shows_the_same_numbers_and_leaves_the_array_writable():
    array = np.arange(6.0)
    view = read_only(array)
    assert view.base is array
    assert not view.flags.writeable
    assert array.flags.writeable
    np.testing.assert_array_equal(read_only(array.reshape(2, 3).T), array.reshape(2, 3).T)
