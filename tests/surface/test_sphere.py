import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ostiform.errors import InputError
from ostiform.surface import (
    count_flipped,
    exact_orientations,
    inverse_stereographic,
    normalised,
    rotation_between,
    spherical_areas,
    spherical_fibonacci,
    stereographic,
    triangle_determinants,
)

ROUNDING = 1e-14  # a few dozen operations on numbers of size one

OCTAHEDRON = np.array(
    [[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=np.float64
)
OCTANTS = np.array(
    [
        [0, 1, 4],
        [1, 2, 4],
        [2, 3, 4],
        [3, 0, 4],
        [1, 0, 5],
        [2, 1, 5],
        [3, 2, 5],
        [0, 3, 5],
    ]
)


def test_stereographic_is_inverted_to_rounding():
    directions = spherical_fibonacci(1000)
    np.testing.assert_allclose(
        inverse_stereographic(stereographic(directions)), directions, atol=ROUNDING
    )


def test_a_circle_about_the_north_pole_has_the_cotangent_of_half_its_radius():
    radius = np.array([1e-6, 0.1, 1.0, np.pi / 2, 3.0])
    directions = np.stack([np.sin(radius), np.zeros(5), np.cos(radius)], axis=1)
    np.testing.assert_allclose(np.abs(stereographic(directions)), 1 / np.tan(radius / 2), rtol=1e-9)


def test_the_north_pole_has_no_projection():
    with pytest.raises(InputError, match="north pole"):
        stereographic(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))


def test_a_vector_without_direction_is_refused():
    with pytest.raises(InputError, match="first at position 1"):
        normalised(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]))


def test_an_octant_has_half_pi_of_area_and_unit_determinant():
    np.testing.assert_allclose(spherical_areas(OCTAHEDRON, OCTANTS), np.pi / 2, rtol=ROUNDING)
    np.testing.assert_allclose(triangle_determinants(OCTAHEDRON, OCTANTS), 1.0, rtol=ROUNDING)
    assert (exact_orientations(OCTAHEDRON, OCTANTS) == 1).all()


def test_reversed_triangles_are_counted_as_flipped_with_negative_area():
    faces = OCTANTS.copy()
    faces[2] = faces[2][::-1]
    assert count_flipped(OCTAHEDRON, faces) == 1
    np.testing.assert_allclose(spherical_areas(OCTAHEDRON, faces)[2], -np.pi / 2, rtol=ROUNDING)
    np.testing.assert_allclose(spherical_areas(OCTAHEDRON, faces).sum(), 3 * np.pi, rtol=ROUNDING)


def test_the_exact_orientation_sees_what_rounding_hides():
    # Three points on a great circle but for one step of the last digit of one z.
    base = np.array([[1.0, 0.0, 0.0], [0.6, 0.8, 0.0], [0.28, 0.96, 0.0]])
    assert exact_orientations(base, np.array([[0, 1, 2]]))[0] == 0
    for sign in (1.0, -1.0):
        moved = base.copy()
        moved[2, 2] = sign * 5e-324
        assert exact_orientations(moved, np.array([[0, 1, 2]]))[0] == sign


def test_no_faces_have_no_orientations():
    assert len(exact_orientations(OCTAHEDRON, np.zeros((0, 3), dtype=np.int64))) == 0


@given(st.lists(st.floats(-1, 1), min_size=6, max_size=6))
def test_the_rotation_between_directions_is_the_smallest_one(numbers):
    a, b = np.array(numbers[:3]), np.array(numbers[3:])
    if min(np.linalg.norm(a), np.linalg.norm(b)) < 1e-3:
        return
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    rotation = rotation_between(a, b)
    # Near opposite directions the half turn is as exact as the sum of the two is, sqrt of rounding.
    np.testing.assert_allclose(rotation @ a, b, atol=1e-7)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(rotation), 1.0, atol=1e-12)
    np.testing.assert_allclose(rotation @ np.cross(a, b), np.cross(a, b), atol=1e-7)


def test_opposite_directions_are_turned_by_half_a_turn():
    rotation = rotation_between(np.array([0.0, 0.0, 2.0]), np.array([0.0, 0.0, -1.0]))
    np.testing.assert_allclose(rotation @ [0, 0, 1], [0, 0, -1], atol=ROUNDING)
    np.testing.assert_allclose(np.trace(rotation), -1.0, atol=ROUNDING)


def test_fibonacci_points_are_spread_evenly():
    points = spherical_fibonacci(500)
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 1.0, rtol=ROUNDING)
    distances = np.linalg.norm(points[:, None] - points[None], axis=2) + 9 * np.eye(500)
    even = np.sqrt(8 * np.pi / np.sqrt(3) / 500)  # edge of 500 points in equilateral triangles
    assert distances.min(axis=1).min() > 0.7 * even
    with pytest.raises(InputError, match="at least one point"):
        spherical_fibonacci(0)
