"""Pictures of shapes coloured by a quantity of their points."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import matplotlib
import numpy as np
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from ostiform.arrays import FloatArray
from ostiform.model import ShapeModel
from ostiform.report.cutaway import drawn_faces
from ostiform.report.modes import extents_of
from ostiform.report.shading import (
    AMBIENT,
    FRONT,
    VIEWS,
    draw_raster,
    draw_scale_bar,
    draw_visible_curves,
    shaded_surface,
)
from ostiform.report.style import (
    PRINT_DPI,
    grid_of_panels,
    part_colours,
    plain_figure,
    shortened,
    styled,
)
from ostiform.surface import Surface

COLOUR_MAP: Final = matplotlib.colormaps["viridis"]
"""Readable with any colour vision, and in grey (van der Walt and Smith 2015)."""

WITHOUT = 0.86
"""Grey of points without a value."""

CODED_AMBIENT = 0.75
"""Little shade where the colour says a number."""

PANEL_MM = 36.0
GAP_MM = 4.0
TITLE_MM = 6.0
LINE_MM = 3.4
BAR_MM = 11.0
LINE = "#1b2733"
MOST_LINES = 6
LONGEST_LINE = 28
"""Characters of a title before it is broken."""


@dataclass(frozen=True, slots=True, eq=False)
class PointColumn:
    """One quantity of the points of the mean shape.

    Attributes
    ----------
    title : str
    values : (P,) float64
        In `units`; NaN where there is none, which is drawn grey.
    largest, smallest : float
        Ends of the scale.
    units : str
    """

    title: str
    values: FloatArray
    largest: float
    smallest: float = 0.0
    units: str = "mm"


def points_figure(model: ShapeModel, columns: Sequence[PointColumn]) -> Figure:
    """Draw the mean shape from two sides, coloured by several quantities, each with its scale.

    Parameters
    ----------
    model : ShapeModel
    columns : sequence of PointColumn
        At least one.
    """
    extents = extents_of(VIEWS, [model.mean])
    height = _height(extents[0])
    loops = [model.mean[loop] for loop in model.mesh.loops.values()]
    shown = drawn_faces(model, VIEWS)
    with styled():
        drawing = plain_figure(
            len(columns) * (PANEL_MM + GAP_MM), 2 * (height + GAP_MM) + TITLE_MM + BAR_MM
        )
        grid = grid_of_panels(drawing, 2, len(columns), PANEL_MM, height, TITLE_MM, GAP_MM, BAR_MM)
        for index, column in enumerate(columns):
            colours = _coloured(model, column.values, column.largest, column.smallest)
            for row, view in enumerate(VIEWS):
                axes = grid[row][index]
                drawn = shown[row]
                picture = shaded_surface(
                    view,
                    model.mean,
                    model.mesh.faces[drawn],
                    colours[drawn],
                    extents[row],
                    _size(height),
                    CODED_AMBIENT,
                )
                draw_raster(axes, picture)
                draw_visible_curves(axes, picture, view, loops, LINE)
                if index == 0 and row == 1:
                    draw_scale_bar(axes, extents[row])
            grid[0][index].set_title(column.title, pad=2.0, fontsize=8)
            ends = column.smallest, column.largest
            _scale(drawing, index, len(columns), ends, column.units)
    return drawing


def shapes_figure(
    model: ShapeModel,
    shapes: FloatArray,
    titles: Sequence[str],
    errors: FloatArray | None = None,
    largest: float = 0.0,
) -> Figure:
    """Draw a few shapes side by side from the front, and below each where the model errs.

    Parameters
    ----------
    model : ShapeModel
        Gives the mesh and the view.
    shapes : (n, P, 3) float64, mm
        In the model's frame, at least one.
    titles : sequence of str, n
    errors : (n, P) float64, mm, optional
        A second row is coloured by them.
    largest : float, mm
        Upper end of the scale of the errors.
    """
    extent = extents_of((FRONT,), list(shapes))[0]
    height = _height(extent)
    rows = 1 if errors is None else 2
    bottom = 0.0 if errors is None else BAR_MM
    parts = part_colours(model.mesh.face_part)
    names = _names_height(titles)
    (drawn,) = drawn_faces(model, (FRONT,))
    faces = model.mesh.faces[drawn]
    with styled():
        drawing = plain_figure(
            len(titles) * (PANEL_MM + GAP_MM), rows * (height + GAP_MM) + names + bottom
        )
        grid = grid_of_panels(drawing, rows, len(titles), PANEL_MM, height, names, GAP_MM, bottom)
        for index, (points, title) in enumerate(zip(shapes, titles, strict=True)):
            coloured = [(parts, AMBIENT)]
            if errors is not None:
                coloured.append((_coloured(model, errors[index], largest), CODED_AMBIENT))
            loops = [points[loop] for loop in model.mesh.loops.values()]
            for row, (colours, ambient) in enumerate(coloured):
                axes = grid[row][index]
                picture = shaded_surface(
                    FRONT, points, faces, colours[drawn], extent, _size(height), ambient
                )
                draw_raster(axes, picture)
                draw_visible_curves(axes, picture, FRONT, loops, LINE)
                if index == 0 and row == rows - 1:
                    draw_scale_bar(axes, extent)
            grid[0][index].set_title(_broken(title), pad=2.0, fontsize=7)
        if errors is not None:
            _scale(drawing, 0, len(titles), (0.0, largest), "mm, left-out error")
    return drawing


def surfaces_figure(surfaces: Sequence[tuple[str, Mapping[str, Surface]]]) -> Figure:
    """Draw surfaces as they were read, each in a frame of its own.

    Parameters
    ----------
    surfaces : sequence of (str, mapping of str to Surface)
        Title and the parts of each, at least one.
    """
    with styled():
        height = 1.3 * PANEL_MM
        names = _names_height([title for title, _ in surfaces])
        drawing = plain_figure(len(surfaces) * (PANEL_MM + GAP_MM), height + GAP_MM + names)
        grid = grid_of_panels(drawing, 1, len(surfaces), PANEL_MM, height, names, GAP_MM)
        for axes, (title, parts) in zip(grid[0], surfaces, strict=True):
            vertices = np.vstack([part.vertices for part in parts.values()])
            offsets = np.cumsum([0, *(len(part.vertices) for part in parts.values())])
            faces = np.vstack(
                [p.faces + o for p, o in zip(parts.values(), offsets[:-1], strict=True)]
            )
            numbers = np.repeat(np.arange(len(parts)), [len(p.faces) for p in parts.values()])
            extent = extents_of((FRONT,), [vertices])[0]
            extent = _fitted(extent, height / PANEL_MM)
            picture = shaded_surface(
                FRONT, vertices, faces, part_colours(numbers), extent, _size(height)
            )
            draw_raster(axes, picture)
            loops = [p.vertices[loop] for p in parts.values() for loop in p.loops.values()]
            draw_visible_curves(axes, picture, FRONT, loops, LINE)
            draw_scale_bar(axes, extent)
            axes.set_title(_broken(title), pad=2.0, fontsize=7)
    return drawing


def _fitted(extent: FloatArray, proportion: float) -> FloatArray:
    """The extent widened to a height of `proportion` times its width."""
    left, right, bottom, top = extent
    wide = max(right - left, (top - bottom) / proportion)
    x, y = 0.5 * (left + right), 0.5 * (bottom + top)
    half, tall = 0.5 * wide, 0.5 * wide * proportion
    return np.array([x - half, x + half, y - tall, y + tall])


def _height(extent: FloatArray) -> float:
    return PANEL_MM * float((extent[3] - extent[2]) / (extent[1] - extent[0]))


def _size(height_mm: float) -> tuple[int, int]:
    return round(PANEL_MM / 25.4 * PRINT_DPI), round(height_mm / 25.4 * PRINT_DPI)


def _coloured(
    model: ShapeModel, values: FloatArray, largest: float, smallest: float = 0.0
) -> FloatArray:
    """Red, green, blue (F, 3, 3) of the corners of the triangles."""
    share = (values - smallest) / max(largest - smallest, np.finfo(np.float64).tiny)
    colours: FloatArray = COLOUR_MAP(np.clip(share, 0.0, 1.0))[:, :3]
    colours[np.isnan(values)] = WITHOUT
    corners: FloatArray = colours[model.mesh.faces]
    return corners


def _scale(drawing: Figure, index: int, count: int, ends: tuple[float, float], label: str) -> None:
    """A colour bar below a column of the grid."""
    width, height = drawing.get_size_inches() * 25.4
    cell = width / count
    axes = drawing.add_axes(
        ((index * cell + 0.15 * cell) / width, 7.0 / height, 0.7 * cell / width, 2.0 / height)
    )
    mappable = matplotlib.cm.ScalarMappable(Normalize(*ends), COLOUR_MAP)
    bar = drawing.colorbar(mappable, cax=axes, orientation="horizontal")
    bar.ax.tick_params(labelsize=6, length=2.0, pad=1.0)
    bar.outline.set_linewidth(0.4)  # type: ignore[operator]
    bar.set_label(label, fontsize=6, labelpad=1.0)
    bar.locator = matplotlib.ticker.MaxNLocator(4)
    bar.update_ticks()


def _names_height(titles: Sequence[str]) -> float:
    return 1.0 + LINE_MM * max(_broken(title).count("\n") + 1 for title in titles)


def _broken(title: str) -> str:
    """A title in lines that fit above a panel; what is longer still is cut."""
    return "\n".join(shortened(line, LONGEST_LINE) for line in title.split("\n")[:MOST_LINES])
