"""The curves of the evidence: variance, residues, specificity, convergence (HY Fig. 4)."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ostiform.arrays import FloatArray
from ostiform.report.style import COLOURS, KIND_NAMES, PART_COLOURS, figure, styled

__all__ = ["Band", "convergence_figure", "evidence_figure", "scores_figure"]


@dataclass(frozen=True, slots=True, eq=False)
class Band:
    """A curve over the number of modes, with the half-width of its interval.

    Attributes
    ----------
    modes : (M,) int64 or float64
    mean : (M,) float64
    half_width : (M,) float64
        Zero where there is no interval.
    """

    modes: FloatArray
    mean: FloatArray
    half_width: FloatArray


def evidence_figure(
    variance: Mapping[str, FloatArray],
    residue: Mapping[str, Band],
    specificity: Mapping[str, Band],
) -> Figure:
    """Draw cumulative variance, left-out residue and specificity of the three models (HY Fig. 4).

    Parameters
    ----------
    variance : mapping of kind to (K,) float64, mm^2
        Cumulative variance after 1, 2, ... modes.
    residue : mapping of kind to Band, mm
        Surface residue of left-out shapes.
    specificity : mapping of kind to Band, mm
    """
    with styled():
        drawing = figure(190.0, 62.0)
        first, second, third = drawing.subplots(1, 3)
        for kind, cumulative in variance.items():
            modes = np.arange(1, len(cumulative) + 1)
            first.plot(modes, cumulative, color=COLOURS[kind], label=KIND_NAMES[kind], marker=".")
        first.set_title("Compactness")
        first.set_ylabel("cumulative variance (mm$^2$ per point)")
        first.set_ylim(bottom=0.0)
        first.legend()
        _bands(second, residue)
        second.set_title("Generalisation")
        second.set_ylabel("surface residue, left out (mm)")
        _bands(third, specificity)
        third.set_title("Specificity")
        third.set_ylabel("distance to nearest shape (mm)")
        for axes in (first, second, third):
            axes.set_xlabel("modes")
            axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    return drawing


def convergence_figure(
    seconds: FloatArray, objective: FloatArray, levels: FloatArray, unit: str
) -> Figure:
    """Draw the objective against time, one colour per level.

    Parameters
    ----------
    seconds, objective, levels : (n,) float64
        One entry per accepted sweep.
    unit : str
        What the objective is, for the axis.
    """
    with styled():
        drawing = figure(120.0, 60.0)
        axes = drawing.subplots()
        for index, level in enumerate(np.unique(levels)):
            chosen = levels == level
            colour = PART_COLOURS[index % len(PART_COLOURS)]
            axes.plot(
                seconds[chosen],
                objective[chosen],
                color=colour,
                marker=".",
                label=f"level {int(level)}",
            )
        axes.set_xlabel("time (s)")
        axes.set_ylabel(unit)
        axes.legend()
    return drawing


def scores_figure(
    scores: FloatArray, subjects: list[str], times: FloatArray, share: FloatArray
) -> Figure:
    """Draw the scores of the first modes, each subject joined through its phases.

    Parameters
    ----------
    scores : (N, K) float64
        In standard deviations of each mode.
    subjects : list of str, N
    times : (N,) float64
        Fraction of the cycle, which orders the phases.
    share : (K,) float64
        Share of the total variance of each mode.
    """
    with styled():
        drawing = figure(95.0, 85.0)
        axes = drawing.subplots()
        names = list(dict.fromkeys(subjects))
        second = min(1, scores.shape[1] - 1)
        for index, name in enumerate(names):
            own = np.flatnonzero(np.array(subjects) == name)
            own = own[np.argsort(times[own])]
            closed = np.append(own, own[0])
            colour = PART_COLOURS[index % len(PART_COLOURS)]
            label = name if len(names) <= 8 else None
            axes.plot(scores[closed, 0], scores[closed, second], color=colour, linewidth=0.8)
            axes.scatter(scores[own, 0], scores[own, second], s=14, color=colour, label=label)
        axes.set_xlabel(f"mode 1 (sd; {100 * share[0]:.0f} % of the variance)")
        axes.set_ylabel(f"mode {second + 1} (sd; {100 * share[second]:.0f} %)")
        axes.set_aspect("equal", adjustable="datalim")
        if len(names) <= 8:
            axes.legend()
    return drawing


def _bands(axes: Axes, bands: Mapping[str, Band]) -> None:
    for kind, band in bands.items():
        axes.plot(band.modes, band.mean, color=COLOURS[kind], label=KIND_NAMES[kind], marker=".")
        axes.fill_between(
            band.modes,
            band.mean - band.half_width,
            band.mean + band.half_width,
            color=COLOURS[kind],
            alpha=0.15,
            linewidth=0.0,
        )
    axes.set_ylim(bottom=0.0)
