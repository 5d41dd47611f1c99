"""Figures of how much the maps distort: angles, areas, and the tangent across seams."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from ostiform.arrays import FloatArray
from ostiform.evaluation import ANGLE_EDGES, AREA_EDGES, JUMP_EDGES
from ostiform.report.style import PART_COLOURS, figure, styled

OUTER = (0.05, 0.95)
QUIET = "#54626f"


def distortion_figure(
    angles: Sequence[FloatArray], areas: Sequence[FloatArray], labels: Sequence[str]
) -> Figure:
    """Draw how the surface is shared out over angle and area distortion.

    Parameters
    ----------
    angles, areas : per label, (N, bins) float64
        Share of the surface of every shape in the bins `ANGLE_EDGES` and `AREA_EDGES`.
    labels : sequence of str
        Component names.
    """
    with styled():
        drawing = figure(170.0, 66.0)
        left, right = drawing.subplots(1, 2)
        for index, label in enumerate(labels):
            colour = PART_COLOURS[index % len(PART_COLOURS)]
            _shares(left, angles[index], ANGLE_EDGES, colour, label)
            _shares(right, areas[index], AREA_EDGES, colour, label)
        left.set_title("Angles")
        left.set_xlabel("σ₁/σ₂ of a triangle (1 = conformal)")
        _logarithmic(left, (1.0, 10.0))
        right.set_title("Areas")
        right.set_xlabel("share of the sphere / share of the surface")
        _logarithmic(right, (0.05, 20.0))
        right.axvline(1.0, color=QUIET, linewidth=0.8)
        left.set_ylabel("share of the surface (% per bin)")
        if len(labels) > 1:
            handles, names = left.get_legend_handles_labels()
            drawing.legend(handles, names, loc="outside upper center", ncols=len(labels))
    return drawing


def seam_figure(
    jumps: Mapping[str, FloatArray],
    floors: Mapping[str, float],
    kinks: Mapping[str, tuple[FloatArray, FloatArray]],
) -> Figure:
    """Draw the kink of the maps across the seams.

    Parameters
    ----------
    jumps : mapping of seam name to (N, bins) float64
        Share of the seam's length of every shape in the bins `JUMP_EDGES` of the relative jump.
    floors : mapping of seam name to float
        The jump that the meshes themselves have beside the seam, mean over the shapes.
    kinks : mapping of seam name to two (N,) float64
        ``|g+| / |g-|`` of every shape as it is mapped, and after the warps.
    """
    with styled():
        drawing = figure(170.0, 66.0)
        left, right = drawing.subplots(1, 2)
        ticks, names = [], []
        for index, (seam, shares) in enumerate(jumps.items()):
            colour = PART_COLOURS[index % len(PART_COLOURS)]
            _shares(left, shares, JUMP_EDGES, colour, seam)
            if np.isfinite(floors[seam]):
                label = "floor of the meshes, mean" if index == 0 else None
                left.axvline(floors[seam], color=QUIET, linewidth=1.0, linestyle="--", label=label)
            for place, values in enumerate(kinks[seam]):
                across = 2.5 * index + place
                spread = 0.5 * (np.arange(len(values)) + 0.5) / len(values) - 0.25
                right.plot(across + spread, values, ".", color=colour, alpha=0.7)
                right.hlines(values.mean(), across - 0.3, across + 0.3, color="#1b2733")
                ticks.append(across)
                side = "warped" if place else "mapped"
                names.append(side if len(jumps) == 1 else f"{side}\n{seam}")
        left.set_xlim(0.0, JUMP_EDGES[-1])
        left.set_title("Along the seam")
        left.set_xlabel("relative jump of the derivative across the seam")
        left.set_ylabel("share of the seam (% per bin)")
        left.legend(fontsize=8)
        right.set_xticks(ticks, names, fontsize=9 if len(jumps) == 1 else 6)
        right.set_xlim(min(ticks) - 0.6, max(ticks) + 0.6)
        right.set_title("Between shapes")
        right.set_ylabel("kink |g₊| / |g₋|")
        right.margins(y=0.25)
    return drawing


def _shares(axes: Axes, shares: FloatArray, edges: FloatArray, colour: str, label: str) -> None:
    percent = 100.0 * shares
    low, high = np.quantile(percent, OUTER, axis=0)
    axes.stairs(percent.mean(axis=0), edges, color=colour, linewidth=1.4, label=label)
    if len(shares) > 2:
        axes.fill_between(
            edges,
            np.append(low, low[-1]),
            np.append(high, high[-1]),
            step="post",
            color=colour,
            alpha=0.25,
            linewidth=0.0,
        )
    axes.set_ylim(bottom=0.0)


def _plain(value: float, _: int) -> str:
    return f"{value:g}"


def _logarithmic(axes: Axes, limits: tuple[float, float]) -> None:
    axes.set_xscale("log")
    axes.set_xlim(*limits)
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(FuncFormatter(_plain))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.tick_params(axis="x", labelsize=8)
