"""Triangles as pixels: a depth buffer for the pictures of surfaces and of maps.

It needs no display, no OpenGL and no native renderer, so it works on any server. Hidden triangles
are hidden exactly, pixel by pixel, and the one image is shared by every file format.
"""

from dataclasses import dataclass

import numpy as np

from ostiform.arrays import BoolArray, FloatArray
from ostiform.compiled import kernel
from ostiform.errors import InputError

SUPERSAMPLES = 2
"""Samples per pixel and direction, averaged: what smooths the edges."""

BACKGROUND = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Raster:
    """A picture of triangles.

    Attributes
    ----------
    image : (H, W, 3) uint8
        Top row first.
    nearness : (h, w) float64
        Third coordinate of what is seen, at every sample; -inf where nothing is.
    extent : (4,) float64
        Left, right, bottom and top edge of the picture.
    """

    image: np.ndarray
    nearness: FloatArray
    extent: FloatArray

    def sees(self, points: FloatArray, tolerance: float) -> BoolArray:
        """Whether points (n, 3) lie in the picture and not behind a triangle.

        Parameters
        ----------
        points : (n, 3) float64
        tolerance : float
            How far a point may lie behind the surface and still count as on it.
        """
        rows, columns = self.nearness.shape
        left, right, bottom, top = self.extent
        column = np.floor((points[:, 0] - left) / (right - left) * columns).astype(np.int64)
        row = np.floor((top - points[:, 1]) / (top - bottom) * rows).astype(np.int64)
        inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        behind = self.nearness[np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)]
        seen: BoolArray = inside & (points[:, 2] >= behind - tolerance)
        return seen


def rasterised(
    corners: FloatArray,
    colours: FloatArray,
    extent: FloatArray,
    size: tuple[int, int],
    edge_colour: FloatArray | None = None,
    edge_width: float = 0.0,
) -> Raster:
    """Draw triangles, the nearer in front of the further.

    Parameters
    ----------
    corners : (F, 3, 3) float64
        Right, up, and towards the eye, of each corner.
    colours : (F, 3, 3) float64
        Red, green and blue in [0, 1] of each corner, interpolated between them.
    extent : (4,) float64
        Left, right, bottom and top edge of the picture, in units of the corners.
    size : (int, int)
        Width and height in pixels.
    edge_colour : (F, 3) float64, optional
        Of the edges; none are drawn without it.
    edge_width : float, pixels

    Raises
    ------
    InputError
        If the picture has no pixel or no extent.
    """
    width, height = size
    left, right, bottom, top = extent
    if min(width, height) < 1 or not (right > left and top > bottom):
        raise InputError(
            f"a picture: expected at least one pixel and a positive extent, found {width} by "
            f"{height} pixels from ({left:g}, {bottom:g}) to ({right:g}, {top:g})"
        )
    columns, rows = width * SUPERSAMPLES, height * SUPERSAMPLES
    placed = np.empty((len(corners), 3, 3))
    placed[:, :, 0] = (corners[:, :, 0] - left) / (right - left) * columns
    placed[:, :, 1] = (top - corners[:, :, 1]) / (top - bottom) * rows
    placed[:, :, 2] = corners[:, :, 2]
    finite = np.isfinite(placed).all(axis=(1, 2))
    edges = np.zeros((len(corners), 3)) if edge_colour is None else edge_colour
    half_width = 0.0 if edge_colour is None else 0.5 * edge_width * SUPERSAMPLES
    image = np.full((rows, columns, 3), BACKGROUND, dtype=np.float32)
    nearness = np.full((rows, columns), -np.inf)
    _fill(
        placed[finite],
        np.ascontiguousarray(colours[finite], dtype=np.float64),
        np.ascontiguousarray(edges[finite], dtype=np.float64),
        half_width,
        image,
        nearness,
    )
    pixels = np.empty((height, width, 3), dtype=np.uint8)
    _average(image, pixels)
    return Raster(pixels, nearness, np.asarray(extent, dtype=np.float64))


@kernel
def _fill(
    corners: FloatArray,
    colours: FloatArray,
    edge_colours: FloatArray,
    half_width: float,
    image: np.ndarray,
    nearness: FloatArray,
) -> None:
    """Fill `image` and `nearness` in place; the centre of pixel (0, 0) is at (0.5, 0.5)."""
    rows, columns = nearness.shape
    lengths = np.empty(3)
    weights = np.empty(3)
    for f in range(len(corners)):
        ax, ay = corners[f, 0, 0], corners[f, 0, 1]
        bx, by = corners[f, 1, 0], corners[f, 1, 1]
        cx, cy = corners[f, 2, 0], corners[f, 2, 1]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0.0:
            continue
        lengths[0] = np.hypot(cx - bx, cy - by)  # of the edge opposite each corner
        lengths[1] = np.hypot(ax - cx, ay - cy)
        lengths[2] = np.hypot(bx - ax, by - ay)
        first_row = max(0, int(np.ceil(min(ay, by, cy) - 0.5)))
        last_row = min(rows - 1, int(np.floor(max(ay, by, cy) - 0.5)))
        first_column = max(0, int(np.ceil(min(ax, bx, cx) - 0.5)))
        last_column = min(columns - 1, int(np.floor(max(ax, bx, cx) - 0.5)))
        for row in range(first_row, last_row + 1):
            y = row + 0.5
            for column in range(first_column, last_column + 1):
                x = column + 0.5
                weights[0] = ((bx - x) * (cy - y) - (by - y) * (cx - x)) / area
                weights[1] = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / area
                weights[2] = 1.0 - weights[0] - weights[1]
                if weights[0] < 0.0 or weights[1] < 0.0 or weights[2] < 0.0:
                    continue
                near = 0.0
                for k in range(3):
                    near += weights[k] * corners[f, k, 2]
                if near <= nearness[row, column]:
                    continue
                nearness[row, column] = near
                line = 0.0
                if half_width > 0.0:
                    for k in range(3):
                        distance = weights[k] * abs(area) / lengths[k]
                        line = max(line, min(1.0, half_width + 0.5 - distance))
                    line *= min(1.0, 2.0 * half_width)
                for channel in range(3):
                    value = 0.0
                    for k in range(3):
                        value += weights[k] * colours[f, k, channel]
                    image[row, column, channel] = (1.0 - line) * value + line * edge_colours[
                        f, channel
                    ]


@kernel
def _average(image: np.ndarray, pixels: np.ndarray) -> None:
    """Fill `pixels` (H, W, 3) with the means of the samples (H S, W S, 3), 0 to 1, as bytes."""
    height, width, _ = pixels.shape
    samples = image.shape[0] // height
    scale = 255.0 / (samples * samples)
    for row in range(height):
        for column in range(width):
            for channel in range(3):
                total = 0.0
                for i in range(samples):
                    for j in range(samples):
                        total += image[row * samples + i, column * samples + j, channel]
                pixels[row, column, channel] = int(min(255.0, max(0.0, scale * total)) + 0.5)
