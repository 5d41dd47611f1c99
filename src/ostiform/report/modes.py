"""Pictures of the mean shape and of the modes of variation (HY Fig. 3)."""

import numpy as np
from matplotlib.figure import Figure

from ostiform.arrays import FloatArray
from ostiform.model import ShapeModel
from ostiform.report.shading import View, draw_curves, draw_surface, two_views
from ostiform.report.style import PART_COLOURS, figure, styled

__all__ = ["model_views", "modes_figure"]


def model_views(model: ShapeModel) -> tuple[View, View]:
    """Return two views of a model a quarter turn apart, the second part above the first.

    A model of one part is seen with its widest opening up; a closed one along its axes.
    """
    centres = [model.mean[model.mesh.part == index].mean(axis=0) for index in _parts(model)]
    if len(centres) > 1:
        upward = centres[1] - centres[0]
    elif model.mesh.loops:
        widest = max(model.mesh.loops.values(), key=lambda loop: _perimeter(model.mean[loop]))
        upward = model.mean[widest].mean(axis=0) - centres[0]
    else:
        upward = np.linalg.svd(model.mean - centres[0], full_matrices=False)[2][0]
    return two_views(model.mean, upward)


def modes_figure(
    model: ShapeModel, mode: int, deviations: tuple[float, ...] = (-3.0, -2.0, 0.0, 2.0, 3.0)
) -> Figure:
    """Draw the mean displaced along one mode, seen from two sides (HY Fig. 3).

    Parameters
    ----------
    model : ShapeModel
    mode : int
        From zero.
    deviations : tuple of float
        In standard deviations.
    """
    views = model_views(model)
    colours = _face_colours(model)
    scale = float(np.sqrt(model.variances[mode]))
    shapes = [model.mean + sd * scale * model.modes[mode] for sd in deviations]
    extents = [_extent(view, shapes) for view in views]
    with styled():
        drawing = figure(36.0 * len(deviations), 92.0)
        grid = drawing.subplots(len(views), len(deviations), squeeze=False)
        for row, view in enumerate(views):
            for column, (sd, points) in enumerate(zip(deviations, shapes, strict=True)):
                axes = grid[row, column]
                draw_surface(axes, view, points, model.mesh.faces, colours)
                loops = [points[loop] for loop in model.mesh.loops.values()]
                draw_curves(axes, view, loops, "#222222", width=0.7)
                axes.set_xlim(extents[row][0], extents[row][1])
                axes.set_ylim(extents[row][2], extents[row][3])
                if row == 0:
                    axes.set_title("mean" if sd == 0 else f"{sd:+g} sd")
    return drawing


def _parts(model: ShapeModel) -> list[int]:
    return [i for i in range(len(model.mesh.parts)) if (model.mesh.part == i).any()]


def _face_colours(model: ShapeModel) -> FloatArray:
    palette = np.array(
        [[int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)] for colour in PART_COLOURS]
    )
    chosen: FloatArray = palette[model.mesh.face_part % len(palette)]
    return chosen


def _perimeter(loop: FloatArray) -> float:
    return float(np.linalg.norm(loop - np.roll(loop, 1, axis=0), axis=1).sum())


def _extent(view: View, shapes: list[FloatArray]) -> tuple[float, float, float, float]:
    seen = np.vstack([view.seen(points)[:, :2] for points in shapes])
    low, high = seen.min(axis=0), seen.max(axis=0)
    margin = 0.03 * float((high - low).max())
    return (
        float(low[0]) - margin,
        float(high[0]) + margin,
        float(low[1]) - margin,
        float(high[1]) + margin,
    )
