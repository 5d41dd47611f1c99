"""Shaded pictures of triangulated surfaces, drawn by Matplotlib alone.

Triangles are sorted by depth and shaded by their normals (painter's algorithm, orthographic). It
needs no display, no OpenGL and no native renderer, so it works on any server, and it is exact
enough for closed, finely triangulated surfaces.
"""

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection

from ostiform.arrays import FloatArray, IntArray

__all__ = ["View", "draw_curves", "draw_surface", "two_views"]

AMBIENT = 0.35
LIGHT = np.array([0.3, 0.5, 0.8])  # in view coordinates: right, up, towards the eye
SMALLEST_NORM = 1e-300


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


def two_views(points: FloatArray, upward: FloatArray) -> tuple[View, View]:
    """Return two views a quarter turn apart about an axis that points up in the picture.

    Parameters
    ----------
    points : (n, 3) float64
        What will be seen; its widest extent across the axis lies in the plane of the first view.
    upward : (3,) float64
        The axis, of any length above zero.
    """
    up = upward / np.linalg.norm(upward)
    across = points - points.mean(axis=0)
    across = across - np.outer(across @ up, up)
    right = np.linalg.svd(across, full_matrices=False)[2][0]
    right = right - (right @ up) * up
    right = right / np.linalg.norm(right)
    right = right * (1.0 if right[np.argmax(np.abs(right))] > 0 else -1.0)  # a definite side
    eye = np.cross(right, up)
    return (
        View(np.stack([right, up, eye]), "front"),
        View(np.stack([-eye, up, right]), "side"),
    )


def draw_surface(
    axes: Axes,
    view: View,
    vertices: FloatArray,
    faces: IntArray,
    colours: FloatArray,
    alpha: float = 1.0,
) -> None:
    """Draw a shaded surface.

    Parameters
    ----------
    axes : matplotlib Axes
    view : View
    vertices : (V, 3) float64
    faces : (F, 3) int64
    colours : (F, 3) float64
        Red, green, blue in [0, 1] of every triangle.
    alpha : float
        Opacity.
    """
    seen = view.seen(vertices)
    corners = seen[faces]  # (F, 3 corners, 3)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1), SMALLEST_NORM)[:, None]
    # The inside, seen through an opening, is lit from behind and a little darker.
    inside = normals[:, 2] < 0
    normals = np.where(inside[:, None], -normals, normals)
    light = LIGHT / np.linalg.norm(LIGHT)
    brightness = AMBIENT + (1.0 - AMBIENT) * np.clip(normals @ light, 0.0, 1.0)
    brightness = np.where(inside, 0.6 * brightness, brightness)
    order = np.argsort(corners[:, :, 2].mean(axis=1))
    shaded = np.clip(colours * brightness[:, None], 0.0, 1.0)[order]
    triangles = PolyCollection(
        list(corners[order][:, :, :2]),
        facecolors=shaded,
        edgecolors=shaded,
        linewidths=0.2,
        alpha=alpha,
        rasterized=True,
    )
    axes.add_collection(triangles)
    _frame(axes, seen)


def draw_curves(
    axes: Axes, view: View, curves: list[FloatArray], colour: str, width: float = 1.2
) -> None:
    """Draw closed curves, each (n, 3), on top of what is there."""
    seen = [view.seen(np.vstack([curve, curve[:1]]))[:, :2] for curve in curves]
    axes.add_collection(LineCollection(seen, colors=colour, linewidths=width))


def _frame(axes: Axes, seen: FloatArray) -> None:
    axes.set_aspect("equal")
    axes.set_axis_off()
    low, high = seen[:, :2].min(axis=0), seen[:, :2].max(axis=0)
    margin = 0.03 * (high - low).max()
    axes.set_xlim(low[0] - margin, high[0] + margin)
    axes.set_ylim(low[1] - margin, high[1] + margin)
