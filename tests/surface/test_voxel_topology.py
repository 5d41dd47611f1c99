"""Solids of voxels: what is grown is a ball, small handles are mended, large ones are told."""

import numpy as np
import pytest
from scipy import ndimage

from ostiform.surface import signed_distance, without_handles, zero_set
from ostiform.surface.voxel_kernels import flipped_while_simple
from ostiform.surface.voxel_topology import solid_genus

SIZE = (40, 40, 24)
CENTRES = np.moveaxis(np.indices(SIZE), 0, -1) - np.array([20.0, 20.0, 12.0])


def torus(major, minor):
    x, y, z = np.moveaxis(CENTRES, -1, 0)
    return (np.hypot(x, y) - major) ** 2 + z**2 < minor**2


def ball(center, radius):
    return ((CENTRES - center) ** 2).sum(axis=-1) < radius**2


def mended(mask, handles_mm, step=1.0):
    everywhere = np.ones(mask.shape, dtype=np.bool_)
    distance = signed_distance(mask, np.full(3, step))
    return without_handles(mask, distance, step, handles_mm, everywhere, everywhere)


def test_what_grows_by_simple_voxels_stays_a_ball(rng):
    field = ndimage.gaussian_filter(rng.normal(size=SIZE), 1.5)
    mask = field > np.quantile(field, 0.5)
    mask[[0, 1, -2, -1]] = mask[:, [0, 1, -2, -1]] = mask[:, :, [0, 1, -2, -1]] = False
    grown = np.zeros(SIZE, dtype=np.bool_)
    grown[tuple(np.argwhere(mask)[0])] = True
    flipped_while_simple(grown, mask & ~grown, np.zeros(SIZE, dtype=np.int64))
    vertices, faces = zero_set(np.where(grown, 1.0, -1.0))
    assert grown.sum() > 20
    assert len(vertices) - len(faces) / 2 == 2


@pytest.mark.parametrize(
    ("major", "minor", "kind"),
    [(14.0, 2.0, "cut"), (6.0, 4.5, "filled")],  # a thin ring, and one with a narrow hole
)
def test_a_handle_is_cut_or_filled_whichever_changes_less(major, minor, kind):
    mask = torus(major, minor)
    assert solid_genus(mask) == 1
    result = mended(mask, 20.0)
    assert solid_genus(result.mask) == 0
    assert [change.kind for change in result.changes] == [kind]
    assert (result.mask != mask).sum() == result.changes[0].n_voxels < 25
    assert result.mask[mask].sum() == mask.sum() - (kind == "cut") * result.changes[0].n_voxels


def test_what_is_larger_is_left_and_told():
    mask = torus(12.0, 5.0)
    result = mended(mask, 20.0)
    assert solid_genus(result.mask) == 1
    assert not result.changes
    (handle,) = result.handles
    assert handle.loop_mm > 20.0
    np.testing.assert_array_equal(result.mask, mask)
    assert not mended(mask, 50.0).handles


def test_islands_go_and_enclosed_holes_are_filled_with_their_places():
    mask = ball((0.0, 0.0, 0.0), 9.0) & ~ball((2.0, 0.0, 0.0), 1.5) | ball((15.0, 0.0, 0.0), 2.0)
    result = mended(mask, 20.0)
    np.testing.assert_array_equal(result.mask, ball((0.0, 0.0, 0.0), 9.0))
    (hole,) = result.changes
    assert hole.kind == "hole"
    np.testing.assert_allclose(hole.center, [22.0, 20.0, 12.0])
