import numpy as np
import pytest

from ostiform.errors import InputError
from ostiform.study import LoopFacts, loop_facts, named_loops

VEINS = {"a": (0.0, 0, 0), "b": (10.0, 0, 0), "c": (0.0, 10, 0), "d": (0.0, 0, 10)}


def facts(*centers):
    return [LoopFacts(np.array(center, float), 9.0, 12) for center in centers]


def points(**stated):
    return {name: np.array(point, float) for name, point in stated.items()}


def test_facts_of_a_polygon_weigh_its_edges_by_length():
    square = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0]])
    found = loop_facts(square, np.arange(5))
    np.testing.assert_allclose(found.center, [1, 1, 0])
    assert (found.perimeter, found.n_vertices) == (8.0, 5)


def test_a_loop_of_one_position_has_a_centre():
    found = loop_facts(np.ones((3, 3)), np.arange(3))
    np.testing.assert_array_equal(found.center, [1, 1, 1])
    assert found.perimeter == 0.0


def test_rough_points_name_loops_one_to_one(rng):
    names = list(VEINS)
    order = rng.permutation(4)
    loops = facts(*(np.array(VEINS[names[k]]) + rng.normal(size=3) for k in order))
    named = named_loops(names, loops, {}, points(**VEINS), 20.0)
    assert [int(order[named[name]]) for name in names] == [0, 1, 2, 3]
    assert list(named) == names


def test_the_sum_of_distances_decides_not_the_nearest_point():
    # Both points are nearest to the first loop; one to one, b must take the second.
    loops = facts((0, 0, 0), (10, 0, 0))
    named = named_loops(["a", "b"], loops, {}, points(a=(-1, 0, 0), b=(2, 0, 0)), 20.0)
    assert named == {"a": 0, "b": 1}


def test_one_ostium_without_a_point_takes_the_loop_that_is_left():
    loops = facts(*VEINS.values())
    some = points(**{name: VEINS[name] for name in "acd"})
    assert named_loops("abcd", loops, {}, some, 20.0) == {"a": 0, "b": 1, "c": 2, "d": 3}


def test_one_ostium_needs_no_point_and_none_needs_no_loop():
    assert named_loops(["a"], facts((1, 2, 3)), {}, {}, 20.0) == {"a": 0}
    assert named_loops([], [], {}, {}, 20.0) == {}


def test_loops_already_named_keep_their_names():
    loops = facts((0, 0, 0), (10, 0, 0), (0, 10, 0))
    named = named_loops("abc", loops, {"a": 1}, points(b=(0, 9, 0), a=(0, 0, 0)), 20.0)
    assert named == {"a": 1, "b": 2, "c": 0}


def test_an_extra_loop_is_refused_with_a_list_of_all():
    with pytest.raises(InputError, match=r"expected 2 openings \(a, b\), found 3: loop 1 at") as e:
        named_loops("ab", facts((0, 0, 0), (10, 0, 0), (0, 10.25, 0)), {}, points(**VEINS), 20.0)
    assert "loop 3 at [0, 10.25, 0] mm, perimeter 9 mm, 12 vertices" in str(e.value)


def test_a_missing_loop_is_refused():
    with pytest.raises(InputError, match=r"expected 1 openings \(a\), found 0"):
        named_loops("a", [], {}, {}, 20.0)
    with pytest.raises(InputError, match="expected a closed surface, found 1"):
        named_loops([], facts((0, 0, 0)), {}, {}, 20.0)


def test_points_that_do_not_tell_all_loops_apart_are_refused():
    with pytest.raises(InputError, match=r"\[ostia.points\] to tell b, c apart"):
        named_loops("abc", facts((0, 0, 0), (9, 0, 0), (0, 9, 0)), {}, points(a=(0, 0, 0)), 20.0)


def test_a_point_nowhere_near_a_loop_is_refused():
    with pytest.raises(
        InputError, match="rough point of a near an opening, found the nearest 991 cm"
    ):
        named_loops("ab", facts((0, 0, 0), (9, 0, 0)), {}, points(a=(1000, 0, 0)), 20.0, "cm")
