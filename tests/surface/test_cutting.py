import numpy as np
import pytest

from ostiform.errors import InputError
from ostiform.surface import boundary_loops, face_areas, genus
from ostiform.surface.cutting import cut_along_zero, tube_cut
from ostiform.surface.extraction import level_field, level_surface
from tests.oracles.holed_spheres import holed_sphere
from tests.oracles.label_volumes import voxel_centers


def sphere():
    vertices, faces = holed_sphere(1500, [])
    return 20.0 * vertices, faces


def two_tubes():
    """A ball with two parallel tubes that end blind."""
    affine = np.eye(4)
    affine[:3, 3] = -25.0
    points = voxel_centers((51, 51, 70), affine)
    inside = np.linalg.norm(points, axis=1) < 15
    for x in (-8.0, 8.0):
        in_tube = np.hypot(points[:, 0] - x, points[:, 1]) < 4
        inside |= in_tube & (points[:, 2] > 0) & (points[:, 2] < 35)
    return level_surface(level_field(inside.reshape(51, 51, 70), affine))


def test_a_cut_leaves_the_surface_but_for_its_curve():
    vertices, faces = sphere()
    cut = cut_along_zero(vertices, faces, vertices[:, 2] - 5.0)
    # What is moved onto the curve stays within the surface's own faces.
    assert face_areas(cut.vertices, cut.faces).sum() == pytest.approx(
        face_areas(vertices, faces).sum(), rel=2e-3
    )
    assert genus(cut.faces) == 0
    heights = cut.vertices[cut.faces][:, :, 2] - 5.0
    assert (heights[cut.side > 0] > -1e-9).all()
    assert (heights[cut.side < 0] < 1e-9).all()
    for side in (1, -1):
        (loop,) = boundary_loops(cut.faces[cut.side == side])
        np.testing.assert_allclose(cut.vertices[loop, 2], 5.0, atol=1e-9)


def test_a_cut_leaves_no_slivers():
    vertices, faces = sphere()
    cut = cut_along_zero(vertices, faces, vertices @ np.array([0.1, 0.3, 0.9]) - 3.0)
    corners = cut.vertices[cut.faces]
    lengths = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    assert lengths.min() > 0.1 * np.median(lengths)


def test_a_plane_cuts_only_the_tube_it_is_meant_for():
    vertices, faces = two_tubes()
    center = np.array([8.0, 0.0, 28.0])
    cut = tube_cut(vertices, faces, vertices[:, 2] - 28.0, center, 10.0)
    (loop,) = boundary_loops(cut.faces)
    np.testing.assert_allclose(cut.vertices[loop].mean(axis=0), center, atol=0.3)
    # The other tube still ends where it did.
    left = cut.vertices[np.unique(cut.faces)]
    assert left[left[:, 0] < 0, 2].max() > 34.0
    assert left[left[:, 0] > 0, 2].max() < 28.5


def test_a_plane_that_meets_nothing_is_refused():
    vertices, faces = sphere()
    with pytest.raises(InputError, match="closed curve within 10 of its centre, found none"):
        tube_cut(vertices, faces, vertices[:, 2] - 50.0, np.array([0.0, 0, 50]), 10.0)
    with pytest.raises(InputError, match="found the nearest 30 away"):
        tube_cut(vertices, faces, vertices[:, 2], np.array([30.0, 0, 0]), 10.0)
