"""Discs with holes: Tutte, circles in the plane, the flow, the opening, the untangling."""

import numpy as np
import pytest

from ostiform.domain import Circle, Sphere
from ostiform.embedding.disc import (
    Disc,
    arc_length_angles,
    cone_filled,
    plane_circle,
    pole_frame,
    tutte_disc,
)
from ostiform.embedding.opening import opened_disc
from ostiform.embedding.part_discs import part_discs
from ostiform.embedding.rims import rims_turned
from ostiform.embedding.untangle import untangled
from ostiform.surface import (
    count_flipped,
    euler_characteristic,
    spherical_areas,
    stereographic,
)
from tests.oracles.implicit_atria import atrium, opened_component


def direction(polar, azimuth):
    polar, azimuth = np.radians(polar), np.radians(azimuth)
    return np.array(
        [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)]
    )


CIRCLES = {
    "LA.mitral": Circle(direction(0, 0), np.radians(25)),
    "LA.PV1": Circle(direction(118, -32), np.radians(4)),
    "LA.PV2": Circle(direction(125, 28), np.radians(4)),
    "LA.PV3": Circle(direction(118, -150), np.radians(4)),
    "LA.PV4": Circle(direction(125, 155), np.radians(4)),
}


@pytest.fixture(scope="module")
def component():
    return opened_component(atrium(6.0), 2.6, relax=6)


@pytest.fixture(scope="module")
def disc(component):
    sphere = Sphere("LA", ("LA",), CIRCLES, {}, "LA.mitral")
    (part,) = part_discs(component, sphere)
    np.testing.assert_array_equal(part.vertices, np.arange(len(component.vertices)))
    return part.disc


@pytest.fixture(scope="module")
def opened(disc):
    return opened_disc(disc)


def _rims(disc):
    is_rim = np.zeros(len(disc.vertices), dtype=bool)
    for opening in (disc.outer, *disc.holes):
        is_rim[opening.loop] = True
    return is_rim


def test_the_image_of_a_circle_is_the_circle_through_its_points(rng):
    for _ in range(5):
        circle = Circle(direction(rng.uniform(60, 150), rng.uniform(0, 360)), rng.uniform(0.1, 0.6))
        frame = pole_frame(Circle(direction(20, 70), 0.2))
        center, radius = plane_circle(circle, frame)
        points = stereographic(circle.points(np.linspace(0, 6, 7)) @ frame.T)
        np.testing.assert_allclose(np.abs(points - center), radius, rtol=1e-10)


def test_a_circle_about_the_south_pole_is_centred():
    center, radius = plane_circle(Circle(direction(180, 0), 0.3), np.eye(3))
    np.testing.assert_allclose(abs(center), 0.0, atol=1e-15)
    np.testing.assert_allclose(radius, np.tan(0.15), rtol=1e-12)


def test_cones_close_the_holes(component, disc):
    filled, apexes = cone_filled(disc.faces, len(disc.vertices), [h.loop for h in disc.holes])
    assert len(apexes) == 4
    assert euler_characteristic(component.faces) == 2 - 5
    assert euler_characteristic(filled) == 2 - 1


def test_arc_length_angles_are_shares_of_the_perimeter():
    square = np.array([[0.0, 0, 0], [3, 0, 0], [3, 1, 0], [0, 1, 0]])
    angles = arc_length_angles(square, np.arange(4))
    np.testing.assert_allclose(angles, 2 * np.pi * np.array([0, 3, 4, 7]) / 8.0, rtol=1e-12)


def test_a_rim_edge_of_length_zero_still_has_an_angle():
    square = np.array([[0.0, 0, 0], [0, 0, 0], [3, 1, 0], [0, 1, 0]])
    assert (np.diff(arc_length_angles(square, np.arange(4))) > 0).all()


def test_the_hole_filled_tutte_map_is_an_embedding(disc, opened):
    assert count_flipped(opened.tutte, disc.faces) == 0
    total = float(spherical_areas(opened.tutte, disc.faces).sum())
    cap = 2.0 * np.pi * (1.0 - np.cos(np.radians(25)))
    np.testing.assert_allclose(total, 4.0 * np.pi - cap, rtol=0.02)  # polygon for the circle


def test_rims_come_to_their_circles_at_arc_length(disc, opened):
    for hole in disc.holes:
        for directions in (opened.opened, opened.arc_length):
            cosines = directions[hole.loop] @ hole.circle.center
            np.testing.assert_allclose(np.arccos(cosines), hole.circle.radius, rtol=1e-6)
        angles = hole.circle.angles(opened.arc_length[hole.loop])
        expected = -arc_length_angles(disc.vertices, hole.loop)
        difference = np.angle(np.exp(1j * (angles - expected)))
        np.testing.assert_allclose(difference, difference[0], atol=1e-6)


def test_opening_folds_few_triangles_and_untangling_none(disc, opened):
    folded = count_flipped(opened.arc_length, disc.faces)
    assert folded < 0.05 * len(disc.faces)
    result = untangled(opened.arc_length, disc.faces, _rims(disc))
    assert result.folded == 0
    assert count_flipped(result.directions, disc.faces) == 0
    rims = _rims(disc)
    np.testing.assert_array_equal(result.directions[rims], opened.arc_length[rims])
    np.testing.assert_allclose(np.linalg.norm(result.directions, axis=1), 1.0, rtol=1e-12)


def test_untangling_moves_only_the_neighbourhood_of_folds(disc, opened):
    flat = untangled(opened.arc_length, disc.faces, _rims(disc)).directions
    inner = np.flatnonzero(~_rims(disc))
    vertex = int(inner[len(inner) // 2])
    tangled = flat.copy()
    around = disc.faces[(disc.faces == vertex).any(axis=1)]
    across = flat[around[0][around[0] != vertex]].mean(axis=0)  # middle of the opposite edge
    tangled[vertex] = 3.0 * across - 2.0 * flat[vertex]
    tangled[vertex] /= np.linalg.norm(tangled[vertex])
    assert count_flipped(tangled, disc.faces) > 0
    result = untangled(tangled, disc.faces, _rims(disc))
    assert result.folded == 0
    moved = np.linalg.norm(result.directions - tangled, axis=1) > 0
    assert 0 < moved.sum() < 0.5 * len(moved)


def test_untangling_says_what_it_could_not_unfold(disc, opened):
    everything = np.ones(len(disc.vertices), dtype=bool)
    result = untangled(opened.opened, disc.faces, everything)
    assert result.folded == count_flipped(opened.opened, disc.faces)
    np.testing.assert_array_equal(result.directions, opened.opened)


def test_a_map_without_folds_is_not_touched(disc, opened):
    result = untangled(opened.tutte, disc.faces, _rims(disc))
    assert result.directions is opened.tutte
    assert result.iterations == 0


def test_rims_can_be_turned_little_by_little(disc, opened):
    fixed = _rims(disc)
    start = untangled(opened.opened, disc.faces, fixed).directions
    curves = [
        (hole.circle, hole.loop, hole.circle.angles(opened.arc_length[hole.loop]) + 0.4)
        for hole in disc.holes
    ]
    outer = disc.outer
    curves.append((outer.circle, outer.loop, outer.circle.angles(start[outer.loop])))
    result = rims_turned(disc.vertices, disc.faces, start, curves, fixed)
    assert result.folded == 0
    for circle, loop, angles in curves:
        np.testing.assert_allclose(result.directions[loop], circle.points(angles), atol=1e-12)


def test_turning_rims_reports_folds_that_stay(disc, opened):
    everything = np.ones(len(disc.vertices), dtype=bool)
    result = rims_turned(disc.vertices, disc.faces, opened.opened, [], everything)
    assert result.folded > 0


def test_holes_that_must_change_places_pass_each_other(component):
    circles = dict(CIRCLES)
    circles["LA.PV1"], circles["LA.PV3"] = circles["LA.PV3"], circles["LA.PV1"]
    (part,) = part_discs(component, Sphere("LA", ("LA",), circles, {}, "LA.mitral"))
    result = untangled(opened_disc(part.disc).arc_length, component.faces, _rims(part.disc))
    assert result.folded == 0
    areas = spherical_areas(result.directions, component.faces)
    assert 10.0 < areas.sum() < 4.0 * np.pi  # once, not twice


def test_a_pole_at_the_end_of_a_tube_does_not_crowd_the_rest(component):
    circles = dict(CIRCLES)
    circles["LA.PV1"] = Circle(direction(0, 0), np.radians(4))
    circles["LA.mitral"] = Circle(direction(100, -32), np.radians(25))
    (part,) = part_discs(component, Sphere("LA", ("LA",), circles, {}, "LA.PV1"))
    assert part.disc.outer.name == "LA.PV1"
    outer = -arc_length_angles(part.disc.vertices, part.disc.outer.loop)
    zeta, _ = tutte_disc(part.disc, outer)
    assert np.median(np.abs(zeta)) < 0.05 / np.tan(np.radians(2))  # crowded by Tutte's map
    opened = opened_disc(part.disc)
    result = untangled(opened.arc_length, component.faces, _rims(part.disc))
    assert result.folded == 0


def test_given_outer_directions_are_kept(disc):
    turned = Disc(disc.vertices, disc.faces, disc.outer, disc.holes)
    free = opened_disc(turned).arc_length
    loop = disc.outer.loop
    angles = disc.outer.circle.angles(free[loop]) + 1.0
    given = disc.outer.circle.points(angles)
    held = opened_disc(turned, given)
    np.testing.assert_allclose(held.arc_length[loop], given, atol=1e-9)
    result = untangled(held.arc_length, disc.faces, _rims(disc))
    assert result.folded == 0
