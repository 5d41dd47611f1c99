"""Hole-filled conformal positions, pose fits and seam warps with known answers."""

from dataclasses import replace

import numpy as np
import pytest

from ostiform.domain import Circle
from ostiform.embedding import conformal_holes
from ostiform.embedding.area_targets import part_scales
from ostiform.embedding.pose_fit import best_rotation, best_turn, posed_moments
from ostiform.embedding.seam_warp import seams_on_circles
from ostiform.surface import count_flipped, face_areas
from tests.oracles.spherical_domains import SEAM, circle, domain_of_circles

POSE = np.eye(4)


def rotation_z(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def angle_between(one, two):
    return float(np.degrees(np.arccos(np.clip(one @ two, -1.0, 1.0))))


@pytest.fixture(scope="module")
def balanced():
    # four equal holes at the corners of a tetrahedron: the identity is conformal and balanced
    corner = np.degrees(np.arccos(-1.0 / 3.0))
    rims = {"A.p": circle(0, 0, 15)}
    rims |= {f"A.{k}": circle(corner, 10 + 120 * k, 15) for k in range(3)}
    return domain_of_circles(rims, count=3000, pole="A.p")


def test_holes_of_the_round_sphere_are_where_they_are(balanced):
    component, sphere, _ = balanced
    holes = conformal_holes(component, "A.p", POSE)
    assert set(holes.directions) == {"A.0", "A.1", "A.2"}
    for name, found in holes.directions.items():
        assert angle_between(found, sphere.rims[name].center) < 2.0
        np.testing.assert_allclose(holes.radii[name], sphere.rims[name].radius, rtol=0.08)


def test_holes_follow_the_pose_and_ignore_unit_and_loop_start(balanced):
    component, _, _ = balanced
    first = conformal_holes(component, "A.p", POSE)
    turn = rotation_z(0.8)
    pose = np.eye(4)
    pose[:3, :3] = turn
    turned = conformal_holes(component, "A.p", pose)
    changed = replace(
        component,
        vertices=30.0 * component.vertices + 5.0,
        rims={name: np.roll(rim, 3) for name, rim in component.rims.items()},
    )
    same = conformal_holes(changed, "A.p", POSE)
    for name, direction in first.directions.items():
        np.testing.assert_allclose(turned.directions[name], turn @ direction, atol=1e-6)
        np.testing.assert_allclose(same.directions[name], direction, atol=2e-3)
        np.testing.assert_allclose(same.radii[name], first.radii[name], rtol=1e-2)


def test_halves_of_the_sphere_lie_on_their_hemispheres():
    rims = {"LV.aortic": circle(125, 0, 12), "LA.a": circle(45, 20, 5), "LA.b": circle(40, 200, 5)}
    component, sphere, _ = domain_of_circles(
        rims, seam=circle(0, 0, 90), count=3000, pole="LV.mitral"
    )
    holes = conformal_holes(component, "LV.mitral", POSE)
    assert set(holes.directions) == set(rims)
    for name, found in holes.directions.items():
        assert angle_between(found, sphere.rims[name].center) < 3.0
        np.testing.assert_allclose(holes.radii[name], sphere.rims[name].radius, rtol=0.1)


def test_a_closed_component_has_no_holes():
    component, _, _ = domain_of_circles({}, count=300)
    holes = conformal_holes(component, None, POSE)
    assert holes.directions == {}
    assert holes.radii == {}


def test_without_a_pole_the_rim_of_most_vertices_is_taken():
    rims = {"A.a": circle(0, 0, 30), "A.b": circle(120, 0, 8)}
    component, _, _ = domain_of_circles(rims, count=800)
    assert set(conformal_holes(component, None, POSE).directions) == {"A.b"}


def test_pose_fits_undo_rotations(rng, balanced):
    component, _, identity = balanced
    stretched = component.vertices * np.array([1.0, 1.4, 0.7])
    pose = np.eye(4)
    pose[:3, :3] = rotation_z(0.9)
    moments = posed_moments(stretched, component.faces, identity, pose)
    base = best_turn(posed_moments(stretched, component.faces, identity, POSE))
    np.testing.assert_allclose(best_turn(moments), rotation_z(0.9) @ base, atol=1e-9)
    free = best_rotation(moments)
    np.testing.assert_allclose(free @ free.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(free), 1.0, rtol=1e-12)
    other = np.trace(rotation_z(0.1) @ free @ moments.T)
    assert np.trace(free @ moments.T) > other


def test_a_displaced_seam_is_carried_back_without_moving_the_rims():
    rims = {"LV.o": circle(140, 0, 10), "LA.a": circle(30, 20, 5)}
    component, sphere, identity = domain_of_circles(
        rims, seam=circle(0, 0, 90), count=3000, pole="LV.mitral"
    )
    longitude = np.arctan2(identity[:, 1], identity[:, 0])
    latitude = np.arctanh(np.clip(identity[:, 2], -1 + 1e-12, 1 - 1e-12))
    fade = np.exp(-((latitude / 0.2) ** 2))
    moved = latitude + (0.06 + 0.04 * np.cos(2 * longitude)) * fade
    displaced = np.stack(
        [np.cos(longitude) / np.cosh(moved), np.sin(longitude) / np.cosh(moved), np.tanh(moved)],
        axis=1,
    )
    (curve,) = component.seams.values()
    assert np.abs(displaced[curve, 2]).max() > 0.09
    carried = seams_on_circles(component, sphere, displaced)
    np.testing.assert_array_equal(carried[curve, 2], 0.0)
    for rim in component.rims.values():
        np.testing.assert_allclose(carried[rim], displaced[rim], atol=1e-3)
    assert count_flipped(carried, component.faces) == 0


def test_a_seam_that_is_no_great_circle_is_carried_to_its_circle():
    seam = Circle(np.array([1.0, 0.5, 2.0]), 0.7)
    component, sphere, identity = domain_of_circles({}, seam=seam, count=2000)
    turned = identity @ np.array(
        [[1.0, 0.0, 0.0], [0.0, np.cos(0.05), -np.sin(0.05)], [0.0, np.sin(0.05), np.cos(0.05)]]
    )
    carried = seams_on_circles(component, sphere, turned)
    cosines = carried[component.seams[SEAM]] @ seam.center
    np.testing.assert_allclose(cosines, np.cos(0.7), atol=1e-12)
    assert count_flipped(carried, component.faces) == 0


def test_scales_give_each_part_the_size_of_its_region():
    component, sphere, identity = domain_of_circles({}, seam=circle(0, 0, 90), count=3000)
    plain = part_scales(component, sphere, identity)
    np.testing.assert_allclose(plain, 1.0, rtol=0.02)
    # the second part four times as large on the surface: about half the scale away from the seam
    second = np.setdiff1d(component.faces[component.face_part == 1], component.seams[SEAM])
    vertices = component.vertices.copy()
    vertices[second] *= 2.0
    grown = replace(component, vertices=vertices)
    scales = part_scales(grown, sphere, identity)
    areas = np.bincount(grown.face_part, face_areas(vertices, grown.faces))
    height = identity[component.faces].mean(axis=1)[:, 2]
    np.testing.assert_allclose(scales[height < -0.8], 1.0, rtol=1e-9)
    np.testing.assert_allclose(scales[height > 0.8], np.sqrt(areas[0] / areas[1]), rtol=0.01)
    assert (np.diff(scales[np.argsort(height)]) < 1e-3).all()
