"""Triangles as pixels: what is in front, from which side, and what a point behind it is."""

import numpy as np
import pytest

from ostiform.errors import InputError
from ostiform.report.raster import rasterised
from ostiform.report.shading import View, shaded_surface

EXTENT = np.array([-1.0, 1.0, -1.0, 1.0])
RED, BLUE = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
SQUARE = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0.0]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])
FROM_ABOVE = View(np.eye(3), "above")


def drawn(corners, colours, **kwargs):
    spread = np.repeat(np.asarray(colours)[:, None, :], 3, axis=1)
    return rasterised(np.asarray(corners), spread, EXTENT, (20, 20), **kwargs)


@pytest.mark.parametrize("order", [[0, 1], [1, 0]])
def test_the_nearer_triangle_hides_the_further_in_any_order(order):
    triangle = SQUARE[FACES[0]]
    corners = np.stack([triangle, triangle + [0, 0, 1.0]])[order]
    picture = drawn(corners, np.stack([RED, BLUE])[order])
    np.testing.assert_array_equal(picture.image[12, 12], [0, 0, 255])


def test_a_square_covers_a_quarter_of_the_picture_exactly():
    picture = drawn(SQUARE[FACES], [RED, RED])
    is_red = (picture.image == [255, 0, 0]).all(axis=2)
    assert is_red.sum() == 100
    assert (picture.image[~is_red] == 255).all()
    assert is_red[5:15, 5:15].all()


def test_the_top_row_is_the_upper_edge():
    picture = drawn([[[-1, 0.5, 0], [1, 0.5, 0], [0, 1, 0.0]]], [RED])
    assert (picture.image[:5] != 255).any()
    assert (picture.image[5:] == 255).all()


def test_edges_are_drawn_in_their_colour():
    picture = drawn(SQUARE[FACES], [RED, RED], edge_colour=np.stack([BLUE, BLUE]), edge_width=3.0)
    np.testing.assert_array_equal(picture.image[5, 10], [0, 0, 255])
    np.testing.assert_array_equal(picture.image[7, 8], [255, 0, 0])


def test_points_behind_a_triangle_are_not_seen():
    picture = drawn(SQUARE[FACES], [RED, RED])
    points = np.array([[0.2, 0.1, -0.5], [0.2, 0.1, 0.5], [0.8, 0.8, -9], [3, 0, 9], [0.2, 0.1, 0]])
    np.testing.assert_array_equal(picture.sees(points, 1e-9), [False, True, True, False, True])


def test_the_inside_is_darker_than_the_outside():
    colours = np.stack([RED, RED])
    outside = shaded_surface(FROM_ABOVE, SQUARE, FACES, colours, EXTENT, (20, 20))
    inside = shaded_surface(FROM_ABOVE, SQUARE, FACES[:, ::-1], colours, EXTENT, (20, 20))
    assert 0 < inside.image[10, 10, 0] < outside.image[10, 10, 0]


def test_light_comes_from_the_upper_left():
    facing = {}
    for name, normal in {"left": [-1, 0, 1], "right": [1, 0, 1], "up": [0, 1, 1]}.items():
        eye = np.array(normal) / np.sqrt(2)
        across = np.cross([0.3, 0.9, 0.1], eye)
        across = across / np.linalg.norm(across)
        turned = SQUARE @ np.stack([across, np.cross(eye, across), eye])
        picture = shaded_surface(FROM_ABOVE, turned, FACES, np.stack([RED, RED]), EXTENT, (20, 20))
        facing[name] = picture.image[10, 10, 0]
    assert facing["left"] > facing["right"]
    assert facing["up"] > facing["right"]


def test_triangles_that_are_not_finite_or_have_no_area_are_left_out():
    corners = np.stack([SQUARE[FACES[0]], np.full((3, 3), np.nan), np.zeros((3, 3))])
    assert np.isfinite(drawn(corners, [RED, RED, RED]).nearness.max())


@pytest.mark.parametrize(
    ("extent", "size"), [([-1, 1, -1, 1], (0, 5)), ([1, 1, 0, 1], (5, 5)), ([0, 1, 1, 0], (5, 5))]
)
def test_a_picture_needs_pixels_and_an_extent(extent, size):
    with pytest.raises(InputError, match="a picture"):
        rasterised(np.zeros((1, 3, 3)), np.zeros((1, 3, 3)), np.array(extent, float), size)
