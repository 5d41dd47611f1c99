"""Tubes that leave a ball of radius 20 mm, cut at any length and slant, end at one place again."""

import numpy as np
import pytest

from ostiform.errors import TopologyError
from ostiform.surface import (
    Surface,
    body_inside,
    boundary_loops,
    distance_from_rims,
    genus,
    height_over_body,
    rim_radius,
    shortened,
)

BALL, TUBE = 20.0, 5.0
FOOT = np.sqrt(BALL**2 - TUBE**2)
WIDE = 1.6 * TUBE


def tube_on_ball(length: float, slant: float = 0.0, turns: int = 48) -> Surface:
    """Return a ball with a tube along +x whose rim lies `length` from its foot, slanted in y."""
    angles = np.linspace(np.pi, np.arcsin(TUBE / BALL), 40)[1:]
    profile = [(BALL * np.cos(a), BALL * np.sin(a), 0.0) for a in angles]
    steps = max(4, int(length / 1.2))
    profile += [(FOOT + length * k / steps, TUBE, k / steps) for k in range(1, steps + 1)]
    around = 2.0 * np.pi * np.arange(turns) / turns
    rings = [
        np.column_stack(
            [x + share * slant * np.cos(around), r * np.cos(around), r * np.sin(around)]
        )
        for x, r, share in profile
    ]
    vertices = np.concatenate([[[-BALL, 0.0, 0.0]], *rings])
    ring = 1 + np.arange(len(rings) * turns).reshape(-1, turns)
    a, b = ring[:-1], np.roll(ring, -1, axis=1)[:-1]
    c, d = np.roll(ring, -1, axis=1)[1:], ring[1:]
    faces = np.concatenate(
        [
            np.column_stack([np.zeros(turns, np.int64), np.roll(ring[0], -1), ring[0]]),
            np.stack([a, b, c], axis=-1).reshape(-1, 3),
            np.stack([a, c, d], axis=-1).reshape(-1, 3),
        ]
    )
    return Surface(vertices, faces, {"vein": boundary_loops(faces)[0]})


@pytest.mark.parametrize(("length", "slant"), [(8.0, 0.0), (13.0, 2.5), (20.0, -4.0)])
def test_height_grows_along_the_tube_whatever_its_end(length, slant):
    surface = tube_on_ball(length, slant)
    height = height_over_body(body_inside(surface, WIDE), surface.vertices, WIDE)
    assert height is not None
    on_tube = surface.vertices[:, 0] > FOOT + 2.0
    # The ball reaches to x = 20; a tube's wall lies sqrt((x - c)^2 + 5^2) - r from the body.
    x = surface.vertices[on_tube, 0]
    expected = np.hypot(x, TUBE) - BALL
    np.testing.assert_allclose(height[on_tube], expected, atol=0.5)


def test_tubes_of_any_length_and_slant_end_at_one_place():
    ends = []
    for length, slant in [(8.0, 0.0), (13.0, 2.5), (20.0, -4.0)]:
        surface = tube_on_ball(length, slant)
        height = height_over_body(body_inside(surface, WIDE), surface.vertices, WIDE)
        short = shortened(surface, "vein", height, 4.0)
        assert genus(short.faces) == 0
        assert [loop.tolist() for loop in boundary_loops(short.faces)] == [
            np.roll(short.loops["vein"], -int(short.loops["vein"].argmin())).tolist()
        ]
        rim = short.vertices[short.loops["vein"]]
        ends.append(rim[:, 0].mean())
        assert np.ptp(rim[:, 0]) < 0.5
    # hypot(x, 5) = 24 where the height is 4
    np.testing.assert_allclose(ends, np.sqrt(24.0**2 - 25.0), atol=0.35)
    assert np.ptp(ends) < 0.25


def test_the_rest_of_the_surface_stays():
    surface = tube_on_ball(13.0)
    height = height_over_body(body_inside(surface, WIDE), surface.vertices, WIDE)
    short = shortened(surface, "vein", height, 4.0)
    kept = {tuple(v) for v in short.vertices}
    body = surface.vertices[surface.vertices[:, 0] < FOOT]
    assert all(tuple(v) in kept for v in body)


def test_a_tube_without_a_wider_body_has_no_height():
    surface = tube_on_ball(13.0)
    assert height_over_body(body_inside(surface, 21.0), surface.vertices, 21.0) is None


def test_two_openings_of_one_tube_are_refused():
    surface = tube_on_ball(20.0)
    # A second opening in the wall of the tube.
    middle = surface.vertices[surface.faces].mean(axis=1)
    hole = np.abs(middle[:, 0] - FOOT - 12.0).argmin()
    faces = np.delete(surface.faces, hole, axis=0)
    loops = {str(len(loop)): loop for loop in boundary_loops(faces)}
    two = Surface(surface.vertices, faces, {"vein": loops["48"], "branch": loops["3"]})
    height = height_over_body(body_inside(two, WIDE), two.vertices, WIDE)
    with pytest.raises(TopologyError, match="vein: expected a tube of its own.*branch share"):
        shortened(two, "vein", height, 4.0)


def test_distance_from_rims_runs_along_the_surface():
    surface = tube_on_ball(20.0)
    away = distance_from_rims(surface, ("vein",))
    np.testing.assert_allclose(away[surface.loops["vein"]], 0.0, atol=1e-12)
    on_tube = surface.vertices[:, 0] > FOOT
    along = FOOT + 20.0 - surface.vertices[on_tube, 0]
    np.testing.assert_allclose(away[on_tube], along, rtol=0.02, atol=1e-9)


def test_rim_radius_is_that_of_the_tube():
    assert rim_radius(tube_on_ball(13.0), "vein") == pytest.approx(TUBE, rel=2e-3)
