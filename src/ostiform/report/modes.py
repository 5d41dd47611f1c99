"""Pictures of the modes of variation (HY Fig. 3)."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from ostiform.arrays import FloatArray
from ostiform.model import ShapeModel
from ostiform.report.cutaway import drawn_faces
from ostiform.report.shading import (
    VIEWS,
    View,
    draw_raster,
    draw_scale_bar,
    draw_visible_curves,
    shaded_surface,
)
from ostiform.report.style import (
    PART_COLOURS,
    PRINT_DPI,
    grid_of_panels,
    part_colours,
    plain_figure,
    shortened,
    styled,
)

PANEL_MM = 36.0
TITLE_MM = 6.0
LEGEND_MM = 6.0
TALLEST = 1.6
"""Height of a panel against its width, at most."""


def modes_figure(
    model: ShapeModel, mode: int, deviations: tuple[float, ...] = (-3.0, -2.0, 0.0, 2.0, 3.0)
) -> Figure:
    """Draw the mean displaced along one mode, seen from two sides (HY Fig. 3).

    Where there are several parts, a legend below names their colours.

    Parameters
    ----------
    model : ShapeModel
    mode : int
        From zero.
    deviations : tuple of float
        In standard deviations.
    """
    colours = part_colours(model.mesh.face_part)
    shown = drawn_faces(model, VIEWS)
    scale = float(np.sqrt(model.variances[mode]))
    shapes = [model.mean + sd * scale * model.modes[mode] for sd in deviations]
    extents = extents_of(VIEWS, shapes)
    sides = extents[:, 1::2] - extents[:, ::2]  # (views, 2): all panels have the same scale
    height = PANEL_MM * float(sides[0, 1] / sides[0, 0])
    parts = _parts(model)
    below = LEGEND_MM if len(parts) > 1 else 0.0
    with styled():
        drawing = plain_figure(PANEL_MM * len(deviations), 2 * height + TITLE_MM + below)
        grid = grid_of_panels(
            drawing, len(VIEWS), len(deviations), PANEL_MM, height, TITLE_MM, bottom_mm=below
        )
        if below:
            patches = [
                Patch(
                    color=PART_COLOURS[index % len(PART_COLOURS)],
                    label=shortened(model.mesh.parts[index]),
                )
                for index in parts
            ]
            drawing.legend(
                handles=patches, loc="lower center", ncols=len(parts), borderaxespad=0.2, fontsize=8
            )
        size = (round(PANEL_MM / 25.4 * PRINT_DPI), round(height / 25.4 * PRINT_DPI))
        for row, view in enumerate(VIEWS):
            drawn = shown[row]
            faces = model.mesh.faces[drawn]
            for column, (sd, points) in enumerate(zip(deviations, shapes, strict=True)):
                axes = grid[row][column]
                picture = shaded_surface(view, points, faces, colours[drawn], extents[row], size)
                draw_raster(axes, picture)
                loops = [points[loop] for loop in model.mesh.loops.values()]
                draw_visible_curves(axes, picture, view, loops, "#1b2733")
                if column == 0 and row == len(VIEWS) - 1:
                    draw_scale_bar(axes, extents[row])
                if row == 0:
                    axes.set_title("mean" if sd == 0 else f"{_signed(sd)} sd", pad=2.0)
    return drawing


def _signed(value: float) -> str:
    return f"{value:+g}".replace("-", "\N{MINUS SIGN}")


def _parts(model: ShapeModel) -> list[int]:
    return [i for i in range(len(model.mesh.parts)) if (model.mesh.part == i).any()]


def extents_of(views: Sequence[View], shapes: Sequence[FloatArray]) -> FloatArray:
    """Return left, right, bottom, top (views, 4) of equal size that hold all shapes.

    Parameters
    ----------
    views : sequence of View
    shapes : sequence of (n, 3) float64, mm
    """
    boxes = []
    for view in views:
        seen = np.vstack([view.seen(points)[:, :2] for points in shapes])
        boxes.append([seen.min(axis=0), seen.max(axis=0)])
    low, high = np.moveaxis(np.array(boxes), 1, 0)  # each (views, 2)
    half = 0.53 * (high - low).max(axis=0)  # 3 % of margin on each side
    half[1] = max(half[1], 0.6 * half[0])
    half[0] = max(half[0], half[1] / TALLEST)
    centre = 0.5 * (low + high)
    edges = np.stack([centre - half, centre + half], axis=2)  # (views, 2 axes, 2 ends)
    flat: FloatArray = edges.reshape(len(views), 4)
    return flat
