"""The paper's two spheres that touch at the seam: closed forms and round trips."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ostiform.domain import (
    Circle,
    Sphere,
    circle_from_part_sphere,
    circle_to_part_sphere,
    from_part_sphere,
    stereographic_view,
    to_part_sphere,
)
from ostiform.errors import InputError
from ostiform.surface import Seam, stereographic

RIM = np.radians(30.0)
SEAM = Seam("LV.mitral", "LA.mitral")


def directions(rng, count=200):
    points = rng.normal(size=(count, 3))
    return points / np.linalg.norm(points, axis=1)[:, None]


def equator(count=50):
    angle = 2 * np.pi * np.arange(count) / count
    return np.c_[np.cos(angle), np.sin(angle), np.zeros(count)]


def left_heart(**rims):
    return Sphere(
        "LV+LA",
        ("LV", "LA"),
        {name.replace("_", "."): circle for name, circle in rims.items()},
        {SEAM: Circle(np.array([0.0, 0.0, 1.0]), np.pi / 2)},
        "LV.mitral",
    )


@pytest.mark.parametrize("side", ["first", "second"])
def test_the_equator_becomes_the_contour_about_the_north_pole(side):
    heights = to_part_sphere(equator(), side, RIM)[:, 2]
    np.testing.assert_allclose(heights, np.cos(RIM), atol=1e-14)


@pytest.mark.parametrize(("side", "pole"), [("first", -1.0), ("second", 1.0)])
def test_the_far_pole_of_each_half_becomes_the_south_pole_of_its_sphere(side, pole):
    found = to_part_sphere(np.array([[0.0, 0.0, pole]]), side, RIM)
    np.testing.assert_allclose(found, [[0.0, 0.0, -1.0]], atol=1e-14)


def test_the_two_discs_are_glued_as_the_docstring_says(rng):
    points = directions(rng)
    radius = 1.0 / np.tan(RIM / 2.0)
    zeta = stereographic(points)
    first = stereographic(to_part_sphere(points, "first", RIM))
    second = stereographic(to_part_sphere(points, "second", RIM))
    np.testing.assert_allclose(zeta, first / radius, rtol=1e-9)
    np.testing.assert_allclose(zeta, radius / second, rtol=1e-9)


@pytest.mark.parametrize("side", ["first", "second"])
@pytest.mark.parametrize("rim", [0.05, RIM, np.pi / 2, 2.5])
def test_going_to_a_part_and_back_changes_nothing(rng, side, rim):
    points = np.vstack([directions(rng), np.eye(3), -np.eye(3)])
    back = from_part_sphere(to_part_sphere(points, side, rim), side, rim)
    np.testing.assert_allclose(back, points, atol=1e-12)


@pytest.mark.parametrize("side", ["first", "second"])
def test_orientation_is_kept(rng, side):
    base = directions(rng, 100)
    triangles = base[:, None, :] + 1e-3 * rng.normal(size=(100, 3, 3))
    triangles /= np.linalg.norm(triangles, axis=2)[:, :, None]
    image = to_part_sphere(triangles.reshape(-1, 3), side, RIM).reshape(-1, 3, 3)
    np.testing.assert_array_equal(np.sign(np.linalg.det(image)), np.sign(np.linalg.det(triangles)))


@pytest.mark.parametrize("side", ["first", "second"])
@pytest.mark.parametrize("radius_deg", [0.5, 12.0, 80.0, 140.0])
def test_a_mapped_circle_is_the_circle_through_its_mapped_points(rng, side, radius_deg):
    circle = Circle(directions(rng, 1)[0], np.radians(radius_deg), 0.7)
    image = circle_to_part_sphere(circle, side, RIM)
    angles = np.linspace(0.0, 6.0, 40)
    points = to_part_sphere(circle.points(angles), side, RIM)
    np.testing.assert_allclose(points @ image.center, np.cos(image.radius), atol=1e-10)
    np.testing.assert_allclose(
        image.points(np.array([image.phase])),
        to_part_sphere(circle.points(np.array([0.7])), side, RIM),
        atol=1e-10,
    )
    inside = to_part_sphere(circle.center[None], side, RIM)[0]
    assert inside @ image.center > np.cos(image.radius)
    back = circle_from_part_sphere(image, side, RIM)
    np.testing.assert_allclose(back.center, circle.center, atol=1e-10)
    np.testing.assert_allclose([back.radius, back.phase], [circle.radius, 0.7], atol=1e-9)


def test_centres_do_not_carry_over():
    circle = Circle(np.array([1.0, 0.0, 1.0]), np.radians(20.0))
    image = circle_to_part_sphere(circle, "second", RIM)
    moved = to_part_sphere(circle.center[None], "second", RIM)[0]
    assert np.arccos(moved @ image.center) > np.radians(1.0)


@pytest.mark.parametrize("part", ["LV", "LA"])
def test_the_view_of_a_part_fills_the_unit_disc(rng, part):
    sphere = left_heart()
    mine = directions(rng)
    mine = mine[mine[:, 2] * (1 if part == "LA" else -1) > 0]
    assert (np.linalg.norm(stereographic_view(sphere, part, mine), axis=1) < 1).all()
    edge = np.linalg.norm(stereographic_view(sphere, part, equator()), axis=1)
    np.testing.assert_allclose(edge, 1.0, atol=1e-12)


@pytest.mark.parametrize("part", ["LV", "LA"])
def test_the_view_is_seen_from_outside(part):
    centre = Rotation.from_rotvec([0.3, 0.2, 0.0]).apply([0, 0, 1.0 if part == "LA" else -1.0])
    small = Circle(centre, 0.05)
    around = stereographic_view(left_heart(), part, small.points(np.linspace(0, 6, 30)))
    following = np.roll(around, -1, axis=0)
    area = 0.5 * np.sum(around[:, 0] * following[:, 1] - around[:, 1] * following[:, 0])
    assert area > 0


def test_the_view_of_a_part_without_seam_is_bounded_by_its_pole():
    pole = Circle(np.array([0.0, 1.0, 1.0]), np.radians(12.0))
    sphere = Sphere("LA", ("LA",), {"LA.mitral": pole}, {}, "LA.mitral")
    edge = stereographic_view(sphere, "LA", pole.points(np.linspace(0, 6, 20)))
    np.testing.assert_allclose(np.linalg.norm(edge, axis=1), 1.0, atol=1e-12)
    far = stereographic_view(sphere, "LA", -pole.center[None])
    np.testing.assert_allclose(far, 0.0, atol=1e-12)


def test_the_view_of_a_closed_part_shows_the_equator_as_unit_circle():
    sphere = Sphere("B", ("B",), {}, {}, None)
    edge = np.linalg.norm(stereographic_view(sphere, "B", equator()), axis=1)
    np.testing.assert_allclose(edge, 1.0, atol=1e-12)


def test_unusable_input_is_refused():
    with pytest.raises(InputError, match='"first" or "second"'):
        to_part_sphere(equator(), "left", RIM)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="between 0 and 180 degrees"):
        from_part_sphere(equator(), "first", 0.0)
    with pytest.raises(InputError, match="one of the parts LV, LA"):
        stereographic_view(left_heart(), "RA", equator())
