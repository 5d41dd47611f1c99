"""What tells loops apart."""

import numpy as np

from ostiform.study import loop_facts


def test_facts_of_a_polygon_weigh_its_edges_by_length():
    square = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0]])
    found = loop_facts(square, np.arange(5))
    np.testing.assert_allclose(found.center, [1, 1, 0])
    assert (found.perimeter, found.n_vertices) == (8.0, 5)


def test_a_loop_of_one_position_has_a_centre():
    found = loop_facts(np.ones((3, 3)), np.arange(3))
    np.testing.assert_array_equal(found.center, [1, 1, 1])
    assert found.perimeter == 0.0
