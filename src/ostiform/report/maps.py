"""Pictures of maps to the sphere: stereographic views with flipped triangles (HY Fig. 2)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure

from ostiform.arrays import BoolArray, FloatArray, IntArray
from ostiform.report.style import FLIPPED, PART_COLOURS, figure, styled

__all__ = ["MapPanel", "distortion_figure", "map_figure"]

WIDEST = 3.0  # radius of the disc shown, times the 98 % radius of the opening's neighbourhood


@dataclass(frozen=True, slots=True, eq=False)
class MapPanel:
    """One state of a map, as seen in the stereographic plane.

    Attributes
    ----------
    title : str
    points : (V, 2) float64
        Stereographic coordinates.
    faces : (F, 3) int64
    flipped : (F,) bool
    curves : tuple of (n,) int64
        Rims and seams, vertex indices in order.
    controls : (C, 2) float64
        Control points, empty where there are none.
    """

    title: str
    points: FloatArray
    faces: IntArray
    flipped: BoolArray
    curves: tuple[IntArray, ...]
    controls: FloatArray


def map_figure(panels: Sequence[MapPanel], zoom: FloatArray | None = None) -> Figure:
    """Draw the states of a map side by side (HY Fig. 2).

    Parameters
    ----------
    panels : sequence of MapPanel
    zoom : (3,) float64 or None
        Centre and radius of a disc of the plane to draw in a second row, as the paper does
        around the boundaries.
    """
    with styled():
        rows = 1 if zoom is None else 2
        drawing = figure(48.0 * len(panels), 56.0 * rows)
        grid = drawing.subplots(rows, len(panels), squeeze=False)
        for column, panel in enumerate(panels):
            _draw_map(grid[0, column], panel)
            flips = int(panel.flipped.sum())
            grid[0, column].set_title(f"{panel.title}\n{flips} of {len(panel.faces)} turned over")
            if zoom is not None:
                _draw_map(grid[1, column], panel)
                grid[1, column].set_xlim(zoom[0] - zoom[2], zoom[0] + zoom[2])
                grid[1, column].set_ylim(zoom[1] - zoom[2], zoom[1] + zoom[2])
    return drawing


def distortion_figure(
    angle: Sequence[FloatArray], area: Sequence[FloatArray], labels: Sequence[str]
) -> Figure:
    """Draw the distributions over shapes of angle and area distortion.

    Parameters
    ----------
    angle : per label, (N,) float64
        Median ratio of singular values of each shape's map.
    area : per label, (N, 2) float64
        1st and 99th percentile of the area share ratio.
    labels : sequence of str
        Component names.
    """
    with styled():
        drawing = figure(150.0, 60.0)
        left, right = drawing.subplots(1, 2)
        for index, label in enumerate(labels):
            colour = PART_COLOURS[index % len(PART_COLOURS)]
            left.hist(angle[index], bins=12, color=colour, alpha=0.7, label=label)
            order = np.arange(len(area[index]))
            right.vlines(order, area[index][:, 0], area[index][:, 1], color=colour, label=label)
        left.set_xlabel("angle distortion of a shape (median $\\sigma_1/\\sigma_2$)")
        left.set_ylabel("shapes")
        right.set_yscale("log")
        right.set_xlabel("shape")
        right.set_ylabel("area share, 1 % to 99 %")
        left.legend()
    return drawing


def _draw_map(axes: Axes, panel: MapPanel) -> None:
    axes.set_aspect("equal")
    axes.set_axis_off()
    corners = panel.points[panel.faces]  # (F, 3, 2)
    axes.add_collection(
        PolyCollection(
            list(corners[~panel.flipped]),
            facecolors="#E8EEF2",
            edgecolors="#5A6B78",
            linewidths=0.15,
            rasterized=True,
        )
    )
    axes.add_collection(
        PolyCollection(
            list(corners[panel.flipped]),
            facecolors=FLIPPED,
            edgecolors="#7A2E00",
            linewidths=0.15,
            rasterized=True,
        )
    )
    loops = [panel.points[np.append(curve, curve[0])] for curve in panel.curves]
    axes.add_collection(LineCollection(loops, colors="#0072B2", linewidths=1.0))
    if len(panel.controls):
        axes.scatter(panel.controls[:, 0], panel.controls[:, 1], s=12, color="#000000", zorder=3)
    extent = np.abs(panel.points[np.isfinite(panel.points).all(axis=1)])
    reach = WIDEST if not extent.size else min(WIDEST, 1.05 * float(extent.max()))
    axes.set_xlim(-reach, reach)
    axes.set_ylim(-reach, reach)
