"""Outlines of labels in their slices: where the wall is, and where the image only ends."""

import numpy as np

from ostiform.fitting.label_contours import label_outlines


def ball(shape, spacing, centre, radius):
    grid = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1) * spacing
    affine = np.diag([*spacing, 1.0])
    return np.linalg.norm(grid - centre, axis=-1) < radius, affine


def test_thick_slices_give_one_smooth_ring_each():
    centre = np.array([40.0, 40.0, 36.0])
    mask, affine = ball((60, 60, 9), np.array([1.4, 1.4, 8.0]), centre, 30.0)
    found = label_outlines(mask, affine, "sa", "LV")
    assert [item.slice for item in found] == [f"sa {k + 1}" for k in range(1, 9)]
    for item in found:
        assert item.is_outline
        assert item.part == "LV"
        (curve,) = item.curves
        height = curve[0, 2] - centre[2]
        radius = np.linalg.norm(curve[:, :2] - centre[:2], axis=1)
        assert abs(radius.mean() - np.sqrt(30.0**2 - height**2)) < 0.25
        assert radius.std() < 0.45  # a staircase of 1.4 mm pixels has 0.5 and more


def test_where_the_image_ends_there_is_no_wall():
    mask, affine = ball((30, 60, 5), np.array([1.4, 1.4, 8.0]), np.array([40.0, 40.0, 16.0]), 25.0)
    (curve,) = label_outlines(mask, affine, "sa", None)[2].curves
    assert np.linalg.norm(curve[0] - curve[-1]) > 20.0  # open
    inside = curve[:, 0] < 29 * 1.4 - 1.0
    radius = np.linalg.norm(curve[inside, :2] - 40.0, axis=1)
    assert np.abs(radius - 25.0).max() < 1.0


def test_one_slice_is_named_after_its_view():
    mask, affine = ball((60, 60, 1), np.array([1.4, 1.4, 8.0]), np.array([40.0, 40.0, 0.0]), 30.0)
    assert [item.slice for item in label_outlines(mask, affine, "4ch", "LV")] == ["4ch"]


def test_an_image_of_equal_steps_is_one_body():
    mask, affine = ball((40, 40, 40), np.ones(3), np.full(3, 20.0), 15.0)
    (item,) = label_outlines(mask, affine, "ct", "LV")
    assert item.slice == "ct"
    assert len(item.curves) > 5
