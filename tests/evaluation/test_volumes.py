"""Volumes of capped shapes against bodies of known volume, and their curves over the cycle."""

from itertools import pairwise

import numpy as np
import pytest

from ostiform.errors import InputError
from ostiform.evaluation import enclosed_volumes, part_volumes, surface_sizes, volume_curves
from ostiform.model import mesh_of_template
from ostiform.study import ShapeId
from ostiform.surface import Surface
from tests.populations import population, two_part_template

ROUNDING = 1e-12  # relative: sums of a few hundred products


def open_frustum(n, low, high, height):
    """Return a frustum over a regular n-gon without its two ends, their rims, and its volume."""
    angles = 2 * np.pi * np.arange(n) / n
    ring = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    points = np.vstack(
        [
            np.column_stack([low * ring, np.zeros(n)]),
            np.column_stack([high * ring, np.full(n, height)]),
        ]
    )
    i, j = np.arange(n), np.roll(np.arange(n), -1)
    faces = np.vstack([np.stack([i, j, n + j], 1), np.stack([i, n + j, n + i], 1)])
    loops = [i, n + i[::-1]]
    area = 0.5 * n * np.sin(2 * np.pi / n)
    return points, faces, loops, area * height * (low**2 + low * high + high**2) / 3


def test_a_closed_tetrahedron_needs_no_cap():
    points = np.vstack([np.zeros(3), np.eye(3)])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    volumes = enclosed_volumes(points[None], faces, [])
    np.testing.assert_allclose(volumes, [1 / 6], rtol=ROUNDING)


@pytest.mark.parametrize(("low", "high"), [(1.0, 1.0), (2.0, 0.5)])
def test_an_open_frustum_capped_at_both_ends_has_the_volume_of_the_body(low, high):
    points, faces, loops, volume = open_frustum(17, low, high, 3.0)
    found = enclosed_volumes(points[None], faces, loops)
    np.testing.assert_allclose(found, [volume], rtol=ROUNDING)


def test_sizes_of_a_mesh_have_the_names_of_the_clinical_ones():
    points, faces, (low, high), volume = open_frustum(17, 20.0, 5.0, 30.0)
    sizes = surface_sizes({"LV": Surface(points, faces, {"mitral": low, "aortic": high})})
    area, edge = 0.5 * 17 * np.sin(2 * np.pi / 17), 2.0 * 17 * np.sin(np.pi / 17)
    assert sizes == pytest.approx(
        {
            "LV_volume_ml": volume / 1000.0,
            "LV_mitral_area_mm2": 400.0 * area,
            "LV_mitral_perimeter_mm": 20.0 * edge,
            "LV_aortic_area_mm2": 25.0 * area,
            "LV_aortic_perimeter_mm": 5.0 * edge,
        }
    )


def test_turning_the_surface_inside_out_turns_the_sign():
    points, faces, loops, volume = open_frustum(9, 1.0, 2.0, 1.0)
    found = enclosed_volumes(points[None], faces[:, ::-1], [loop[::-1] for loop in loops])
    np.testing.assert_allclose(found, [-volume], rtol=ROUNDING)


def test_a_volume_does_not_move_with_the_shape_and_scales_with_the_cube(rng):
    points, faces, loops, volume = open_frustum(12, 1.0, 2.0, 3.0)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn[:, 0] *= np.sign(np.linalg.det(turn))
    moved = np.stack([points @ turn.T + [3e3, -2e3, 1e3], 2.0 * points])
    found = enclosed_volumes(moved, faces, loops)
    np.testing.assert_allclose(found, [volume, 8 * volume], rtol=1e-9)  # far from the origin


def test_a_cap_that_is_missing_is_named():
    points, faces, loops, _ = open_frustum(9, 1.0, 2.0, 1.0)
    with pytest.raises(InputError, match="close it"):
        enclosed_volumes(points[None], faces, loops[:1])


def test_a_cap_that_runs_the_wrong_way_is_found():
    points, faces, loops, _ = open_frustum(9, 1.0, 2.0, 1.0)
    with pytest.raises(InputError, match="close it"):
        enclosed_volumes(points[None], faces, [loops[0], loops[1][::-1]])


def test_parts_that_meet_at_a_seam_add_up_to_the_whole(rng):
    shapes = population(2, 3, rng, two_part_template(9, 16))
    mesh = mesh_of_template(shapes.template)
    parts = part_volumes(shapes.points, mesh)
    outer = [mesh.loops["LV.aortic"], mesh.loops["LA.vein"]]
    whole = enclosed_volumes(shapes.points, mesh.faces, outer)
    assert list(parts) == ["LV", "LA"]
    np.testing.assert_allclose(parts["LV"] + parts["LA"], whole, rtol=1e-9)


def test_alignment_without_scaling_keeps_the_volumes(rng):
    shapes = population(2, 3, rng, two_part_template(9, 16))
    mesh = mesh_of_template(shapes.template)
    here, there = part_volumes(shapes.points, mesh), part_volumes(shapes.aligned, mesh)
    np.testing.assert_allclose(here["LV"], there["LV"], rtol=1e-9)


def test_a_curve_follows_time_and_gives_the_ejection_fraction():
    ids = [ShapeId("s", "b", 0.5), ShapeId("s", "a", 0.0), ShapeId("alone", "x", 0.0)]
    (curve,) = volume_curves(ids, {"LV": np.array([50.0, 125.0, 80.0])})
    assert (curve.subject, curve.phases) == ("s", ("a", "b"))
    np.testing.assert_allclose(curve.volumes, [125.0, 50.0])
    assert curve.phases[curve.largest] == "a"
    assert curve.phases[curve.smallest] == "b"
    np.testing.assert_allclose(curve.ejection_fraction, 0.6, rtol=ROUNDING)
    assert all(a < b for a, b in pairwise(curve.times))


def test_shapes_of_one_phase_have_no_curve():
    assert volume_curves([ShapeId("a", "", 0.0)], {"LV": np.ones(1)}) == ()


def test_a_volume_for_every_shape_is_needed():
    with pytest.raises(InputError, match="one for each of 1 shapes"):
        volume_curves([ShapeId("a", "", 0.0)], {"LV": np.ones(2)})
