"""Shaded pictures of triangulated surfaces, from an orthographic view."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection

from ostiform.arrays import BoolArray, FloatArray, IntArray
from ostiform.report.raster import Raster, rasterised

AMBIENT = 0.42
INSIDE = 0.55
"""Brightness of the inside of a surface, seen through an opening, against the outside."""

LIGHT = np.array([-0.35, 0.5, 0.8])  # in view coordinates: right, up, towards the eye
SMALLEST_NORM = 1e-300

ON_SURFACE = 0.012
"""A curve on the surface counts as hidden beyond this share of the picture's larger side: about
the edge of a triangle, the most that a pixel beside a curve lies off it."""


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """An orthographic view.

    Attributes
    ----------
    axes : (3, 3) float64
        Rows: right, up, and towards the eye, orthonormal.
    name : str
    """

    axes: FloatArray
    name: str

    def seen(self, points: FloatArray) -> FloatArray:
        """Return (n, 3) view coordinates: right, up, nearness."""
        coordinates: FloatArray = points @ self.axes.T
        return coordinates


FRONT = View(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]), "from the front")
LEFT = View(np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]), "from the left")
BEHIND = View(np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]), "from behind")
RIGHT = View(np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]]), "from the right")
VIEWS = (FRONT, LEFT)
"""From where shapes are seen: superior is up, as the frame of the files (LPS) says."""

ALL_ROUND = (*VIEWS, BEHIND, RIGHT)


def shaded_surface(
    view: View,
    vertices: FloatArray,
    faces: IntArray,
    colours: FloatArray,
    extent: FloatArray,
    size: tuple[int, int],
    ambient: float = AMBIENT,
) -> Raster:
    """Return a shaded picture of a surface.

    Parameters
    ----------
    view : View
    vertices : (V, 3) float64
    faces : (F, 3) int64
        Counter-clockwise seen from outside.
    colours : (F, 3) or (F, 3, 3) float64
        Red, green, blue in [0, 1] of every triangle, or of each of its corners.
    extent : (4,) float64
        Left, right, bottom, top in view coordinates.
    size : (int, int)
        Width and height in pixels.
    ambient : float
        Brightness in [0, 1] of what faces away from the light.
    """
    seen = view.seen(vertices)
    corners = seen[faces]  # (F, 3 corners, 3)
    spanned = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])  # (F, 3)
    normals = np.stack(
        [
            np.bincount(faces.T.ravel(), np.tile(spanned[:, axis], 3), minlength=len(seen))
            for axis in range(3)
        ],
        axis=1,
    )  # (V, 3): area-weighted sum over the triangles of each vertex
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1), SMALLEST_NORM)[:, None]
    light = LIGHT / np.linalg.norm(LIGHT)
    inside = spanned[:, 2] < 0  # (F,)
    towards = (normals @ light)[faces] * np.where(inside, -1.0, 1.0)[:, None]  # (F, 3 corners)
    brightness = ambient + (1.0 - ambient) * np.clip(towards, 0.0, 1.0)
    brightness = np.where(inside[:, None], INSIDE * brightness, brightness)
    corner_colours = colours if colours.ndim == 3 else colours[:, None, :]
    return rasterised(corners, corner_colours * brightness[:, :, None], extent, size)


def draw_raster(axes: Axes, picture: Raster) -> None:
    """Put a picture into empty axes of its proportions."""
    axes.set_axis_off()
    left, right, bottom, top = picture.extent
    axes.imshow(
        picture.image, extent=(left, right, bottom, top), interpolation="none", aspect="equal"
    )
    axes.set_xlim(left, right)
    axes.set_ylim(bottom, top)


def draw_scale_bar(axes: Axes, extent: FloatArray) -> None:
    """Draw a bar of a round number of millimetres into the lower left corner of a picture.

    Parameters
    ----------
    axes : Axes
        Coordinates are millimetres.
    extent : (4,) float64, mm
        Left, right, bottom and top edge of the picture.
    """
    left, right, bottom, top = extent
    widest = 0.3 * (right - left)
    decade = 10.0 ** np.floor(np.log10(widest))
    length = decade * max(step for step in (1.0, 2.0, 5.0) if step * decade <= widest)
    x, y = left + 0.03 * (right - left), bottom + 0.02 * (top - bottom)
    axes.plot([x, x + length], [y, y], color="#1b2733", linewidth=1.5, solid_capstyle="butt")
    axes.text(
        x,  # from the bar's left end: a short bar's label would be cut off
        y + 0.01 * (top - bottom),
        f"{length:g} mm",
        ha="left",
        va="bottom",
        fontsize=7,
    )


def draw_visible_curves(
    axes: Axes,
    picture: Raster,
    view: View,
    curves: Sequence[FloatArray],
    colour: str,
    width: float = 0.8,
) -> None:
    """Draw what can be seen of closed curves on a surface, each (n, 3)."""
    left, right, bottom, top = picture.extent
    tolerance = ON_SURFACE * max(right - left, top - bottom)
    pieces = []
    for curve in curves:
        seen = view.seen(np.vstack([curve, curve[:1]]))  # (n + 1, 3)
        middle = 0.5 * (seen[1:] + seen[:-1])
        shown = picture.sees(middle, tolerance)
        pieces += _runs(seen[:, :2], shown)
    axes.add_collection(
        LineCollection(pieces, colors=colour, linewidths=width, capstyle="round", joinstyle="round")
    )


def _runs(points: FloatArray, shown: BoolArray) -> list[FloatArray]:
    """Return the polylines (n, 2) of the edges shown (E,) of a curve through points (E + 1, 2)."""
    changes = np.flatnonzero(np.diff(np.concatenate([[False], shown, [False]])))
    return [points[start : end + 1] for start, end in changes.reshape(-1, 2)]
