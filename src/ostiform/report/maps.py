"""Pictures of maps to the sphere: stereographic views with flipped triangles (HY Fig. 2)."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from ostiform.arrays import BoolArray, FloatArray, IntArray
from ostiform.report.raster import rasterised
from ostiform.report.shading import draw_raster
from ostiform.report.style import (
    FLIPPED,
    PRINT_DPI,
    grid_of_panels,
    plain_figure,
    styled,
)

WIDEST = 3.0  # radius of the disc shown, times the 98 % radius of the opening's neighbourhood
PANEL_MM = 40.0
GAP_MM = 2.0
TITLE_MM = 10.0
EDGE_PIXELS = 1.1
UPRIGHT = "#EEF3F6"
UPRIGHT_EDGE = "#6A7B88"
FLIPPED_EDGE = "#B84A00"


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
        Control points in the interior, empty where there are none.
    boundary_controls : (B, 2) float64
        Control points on openings and seams.
    says_flips : bool
        Whether the title counts the triangles that are turned over.
    """

    title: str
    points: FloatArray
    faces: IntArray
    flipped: BoolArray
    curves: tuple[IntArray, ...]
    controls: FloatArray
    boundary_controls: FloatArray = field(default_factory=lambda: np.empty((0, 2)))
    says_flips: bool = True


def map_figure(panels: Sequence[MapPanel], zoom: FloatArray | None = None) -> Figure:
    """Draw the states of a map side by side (HY Fig. 2).

    Parameters
    ----------
    panels : sequence of MapPanel
    zoom : (3,) float64 or None
        Centre and radius of a disc of the plane to draw in a second row, as the paper does
        around the boundaries.
    """
    rows = 1 if zoom is None else 2
    with styled():
        cell = PANEL_MM + GAP_MM
        drawing = plain_figure(cell * len(panels), cell * rows + TITLE_MM)
        grid = grid_of_panels(drawing, rows, len(panels), PANEL_MM, PANEL_MM, TITLE_MM, GAP_MM)
        for column, panel in enumerate(panels):
            reach = _reach(panel)
            _draw_map(grid[0][column], panel, np.array([-reach, reach, -reach, reach]))
            flips = int(panel.flipped.sum())
            second = f"{flips} turned over" if panel.says_flips else _counted(panel)
            grid[0][column].set_title(f"{panel.title}\n{second}", pad=3.0)
            if zoom is not None:
                x, y, radius = zoom
                window = np.array([x - radius, x + radius, y - radius, y + radius])
                _draw_map(grid[1][column], panel, window)
                _frame(grid[0][column], window, linestyle="--")
                _frame(grid[1][column], window, linestyle="-")
    return drawing


def _draw_map(axes: Axes, panel: MapPanel, window: FloatArray) -> None:
    size = round(PANEL_MM / 25.4 * PRINT_DPI)
    corners = np.zeros((len(panel.faces), 3, 3))
    corners[:, :, :2] = panel.points[panel.faces]
    corners[panel.flipped, :, 2] = 1.0  # in front of what they cover
    fill = np.where(panel.flipped[:, None], to_rgb(FLIPPED), to_rgb(UPRIGHT))  # (F, 3)
    edges = np.where(panel.flipped[:, None], to_rgb(FLIPPED_EDGE), to_rgb(UPRIGHT_EDGE))
    picture = rasterised(
        corners, np.repeat(fill[:, None, :], 3, axis=1), window, (size, size), edges, EDGE_PIXELS
    )
    draw_raster(axes, picture)
    loops = [panel.points[np.append(curve, curve[0])] for curve in panel.curves]
    axes.add_collection(LineCollection(loops, colors="#0072B2", linewidths=1.0))
    for points, marker, face in (
        (panel.controls, "o", "#000000"),
        (panel.boundary_controls, "s", "#ffffff"),
    ):
        if len(points):
            axes.scatter(
                points[:, 0],
                points[:, 1],
                s=5,
                marker=marker,
                facecolor=face,
                edgecolor="#000000",
                linewidth=0.6,
                zorder=3,
            )


def _counted(panel: MapPanel) -> str:
    return f"{len(panel.controls)} inside, {len(panel.boundary_controls)} on curves"


def _reach(panel: MapPanel) -> float:
    extent = np.abs(panel.points[np.isfinite(panel.points).all(axis=1)])
    return WIDEST if not extent.size else min(WIDEST, 1.05 * float(extent.max()))


def _frame(axes: Axes, window: FloatArray, linestyle: str) -> None:
    left, right, bottom, top = window
    axes.add_patch(
        Rectangle(
            (left, bottom),
            right - left,
            top - bottom,
            fill=False,
            edgecolor="#1b2733",
            linewidth=0.8,
            linestyle=linestyle,
        )
    )
