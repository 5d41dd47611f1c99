import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ostiform.errors import InputError
from ostiform.surface import boundary_loops, enclosed_volume, genus, vertex_areas
from ostiform.surface.extraction import level_field, level_surface, level_values
from tests.oracles.label_volumes import ellipsoid_distance, posed_grid, voxel_centers

AXES = np.array([25.0, 30.0, 45.0])
VOLUME = 4.0 / 3.0 * np.pi * AXES.prod()


@pytest.mark.parametrize(
    ("spacing", "most_mm", "most_percent"),
    [((1.2, 1.2, 1.2), 0.12, 0.5), ((1.2, 1.2, 7.0), 0.25, 1.5), ((7.0, 1.2, 1.2), 0.25, 1.5)],
)
def test_an_ellipsoid_in_any_pose_comes_back(spacing, most_mm, most_percent, rng):
    # Asked for: 0.3 mm and 1 % at 1.2 mm, 0.6 mm and 3 % at 7 mm; the bounds are those measured.
    for _ in range(2):
        turn = Rotation.random(rng=rng).as_matrix()
        size, affine, center = posed_grid(spacing, 110.0, rng)
        inside = (((voxel_centers(size, affine) - center) @ turn / AXES) ** 2).sum(axis=1) < 1
        vertices, faces = level_surface(level_field(inside.reshape(size), affine))
        assert genus(faces) == 0
        assert boundary_loops(faces) == ()
        error = ellipsoid_distance((vertices - center) @ turn, AXES)
        weights = vertex_areas(vertices, faces)
        through = int(np.argmax(spacing))
        index = ((vertices - affine[:3, 3]) @ np.linalg.inv(affine[:3, :3]).T)[:, through]
        filled = np.flatnonzero(
            inside.reshape(size).any(axis=tuple(a for a in range(3) if a != through))
        )
        is_end = (index < filled[0]) | (index > filled[-1])
        assert weights @ error / weights.sum() < most_mm
        assert weights[is_end] @ error[is_end] / weights[is_end].sum() < 0.6
        assert 100 * abs(enclosed_volume(vertices, faces) / VOLUME - 1) < most_percent


def test_a_field_between_slices_is_exact_for_a_ball():
    size, affine = (41, 41, 9), np.diag([1.0, 1.0, 5.0, 1.0])
    affine[:3, 3] = [-20.0, -20.0, -20.0]
    inside = (voxel_centers(size, affine) ** 2).sum(axis=1) < 15.3**2
    vertices, faces = level_surface(level_field(inside.reshape(size), affine))
    radius = np.linalg.norm(vertices, axis=1)
    middle = np.abs(vertices[:, 2]) < 12.0
    np.testing.assert_allclose(radius[middle], 15.3, atol=0.6)
    assert abs(radius[middle].mean() - 15.3) < 0.1
    assert enclosed_volume(vertices, faces) > 0


def test_the_field_tells_inside_from_outside(rng):
    size, affine, center = posed_grid((1.0, 1.0, 1.0), 50.0, rng)
    points = voxel_centers(size, affine)
    inside = np.linalg.norm(points - center, axis=1) < 15.0
    field = level_field(inside.reshape(size), affine)
    probes = center + 20.0 * rng.uniform(-1, 1, (300, 3))
    distance = 15.0 - np.linalg.norm(probes - center, axis=1)
    clear = np.abs(distance) > 1.0
    assert ((level_values(field, probes) > 0)[clear] == (distance > 0)[clear]).all()


def test_a_label_that_is_empty_or_one_voxel_thick_is_refused():
    with pytest.raises(InputError, match="expected voxels of the label, found none"):
        level_field(np.zeros((4, 4, 4), bool), np.eye(4))
    thin = np.zeros((9, 9, 9), bool)
    thin[2:6, 2:6, 4] = True
    with pytest.raises(InputError, match="found 1 along axis 2"):
        level_field(thin, np.eye(4))
