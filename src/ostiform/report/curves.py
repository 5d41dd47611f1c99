"""The curves of the evidence: variance, residues, specificity, convergence (HY Fig. 4)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ostiform.arrays import FloatArray
from ostiform.evaluation import VolumeCurve
from ostiform.report.style import (
    COLOURS,
    KIND_NAMES,
    MARKERS,
    MM3_PER_ML,
    PART_COLOURS,
    SUBJECT_COLOURS,
    figure,
    shortened,
    styled,
)

MODES_DRAWN = 15
KIND_MARKERS = {"conformal": "o", "euclidean": "s", "optimal": "^"}
TERM_NAMES = {"length": "description length", "distance": "squared distance"}
LABELLED_SUBJECTS = 8
"""More names than this do not fit into a legend."""


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


@dataclass(frozen=True, slots=True)
class GainPoint:
    """How much less variance the optimal model has than another one.

    Attributes
    ----------
    value : float
        Share of the other's variance.
    interval : (float, float) or None
    paper : float or None
        What the paper reports.
    """

    value: float
    interval: tuple[float, float] | None
    paper: float | None


def evidence_figure(
    variance: Mapping[str, Band],
    residue: Mapping[str, Band],
    specificity: Mapping[str, Band],
) -> Figure:
    """Draw cumulative variance, left-out residue and specificity of the three models (HY Fig. 4).

    Only the first `MODES_DRAWN` modes are drawn; the curves are flat after them.

    Parameters
    ----------
    variance : mapping of kind to Band, mm^2
        Cumulative variance after 1, 2, ... modes.
    residue : mapping of kind to Band, mm
        Surface residue of left-out shapes; without any the panel is left out.
    specificity : mapping of kind to Band, mm
    """
    panels = [
        ("Compactness", "cumulative variance (mm²)", variance),
        ("Generalisation", "surface residue, left out (mm)", residue),
        ("Specificity", "distance to nearest shape (mm)", specificity),
    ]
    drawn = [panel for panel in panels if panel[2]]
    with styled():
        drawing = figure(64.0 * len(drawn), 80.0)
        grid = drawing.subplots(1, len(drawn), squeeze=False)[0]
        for axes, (title, label, bands) in zip(grid, drawn, strict=True):
            _bands(axes, bands)
            axes.set_title(title)
            axes.set_ylabel(label)
            axes.set_xlabel("modes")
            axes.xaxis.set_major_locator(MaxNLocator(nbins=6, integer=True))
            if max(band.modes.max() for band in bands.values()) < 2:
                axes.set_xlim(-0.5, 2.5)
        handles, labels = grid[0].get_legend_handles_labels()
        drawing.legend(handles, labels, loc="outside upper center", ncols=len(labels))
    return drawing


def gains_figure(gains: Mapping[str, GainPoint], differences: Mapping[str, Band]) -> Figure:
    """Draw what the optimal model gains over the other two.

    Parameters
    ----------
    gains : mapping of kind to GainPoint
        In total variance.
    differences : mapping of kind to Band, mm
        Residue of left-out shapes, the other model minus the optimal one, by number of modes;
        without any the panel is left out.
    """
    with styled():
        drawing = figure(75.0 + (85.0 if differences else 0.0), 66.0)
        grid = drawing.subplots(1, 2 if differences else 1, squeeze=False)[0]
        axes = grid[0]
        for row, (kind, gain) in enumerate(gains.items()):
            if gain.interval is not None:
                axes.hlines(row, *(100 * end for end in gain.interval), color=COLOURS[kind])
            axes.plot(100 * gain.value, row, "o", color=COLOURS[kind])
            if gain.paper is not None:
                label = "in the paper" if row == 0 else None
                axes.plot(100 * gain.paper, row, "x", color="#54626f", label=label)
        axes.axvline(0.0, color="#54626f", linewidth=0.8)
        axes.set_yticks(range(len(gains)), [f"over {_short(KIND_NAMES[kind])}" for kind in gains])
        axes.set_ylim(len(gains) - 0.5, -0.5)
        axes.set_xlabel("gain in total variance (%)")
        axes.set_title("Compactness")
        axes.legend(fontsize=8, frameon=True)
        if differences:
            axes = grid[1]
            for kind, band in differences.items():
                _band(axes, kind, band, f"over {KIND_NAMES[kind]}")
            axes.axhline(0.0, color="#54626f", linewidth=0.8)
            axes.set_xlabel("modes")
            axes.set_ylabel("residue: other − optimal (mm)")
            axes.xaxis.set_major_locator(MaxNLocator(nbins=6, integer=True))
            axes.set_title("Generalisation")
            axes.margins(y=0.3)
            axes.legend(fontsize=8, loc="best")
    return drawing


def _short(name: str) -> str:
    return name.replace(" ", "\n")


def convergence_figure(history: Sequence[Mapping[str, Any]]) -> Figure:
    """Draw the objective against time, a line per level, and its terms, a line for each.

    The terms are drawn as what each has changed by since its level began, so that large ones do
    not hide small ones; the lines add up to the change of the objective.

    Parameters
    ----------
    history : sequence of mapping
        `SweepRecord` as plain values, of the levels to be drawn.
    """
    seconds = np.cumsum([record["seconds"] for record in history])
    objective = np.array([record["objective"] for record in history])
    levels = np.array([record["level"] for record in history])
    runs = np.split(np.arange(len(levels)), np.flatnonzero(np.diff(levels)) + 1)
    names = list(dict.fromkeys(name for record in history for name in record["terms"]))
    with styled():
        drawing = figure(170.0, 66.0)
        left, right = drawing.subplots(1, 2)
        for index, run in enumerate(runs):
            look = _marked_line(index)
            left.plot(seconds[run], objective[run], label=f"level {levels[run[0]]}", **look)
        for index, name in enumerate(names):
            values = np.array([record["terms"].get(name, 0.0) for record in history])
            for number, run in enumerate(runs):
                label = TERM_NAMES.get(name, name) if number == 0 else None
                look = _marked_line(index)
                right.plot(seconds[run], values[run] - values[run[0]], label=label, **look)
        right.axhline(0.0, color="#1b2733", linewidth=0.6)
        left.set_ylabel("objective")
        right.set_ylabel("change since the level began")
        for axes, title in ((left, "Objective"), (right, "Its terms")):
            axes.set_title(title)
            axes.set_xlabel("time (s)")
            axes.legend(fontsize=7)
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
        drawing = figure(120.0, 85.0)
        axes = drawing.subplots()
        names = list(dict.fromkeys(subjects))
        across = scores[:, 1] if scores.shape[1] > 1 else np.zeros(len(scores))
        for index, name in enumerate(names):
            own = np.flatnonzero(np.array(subjects) == name)
            own = own[np.argsort(times[own])]
            closed = np.append(own, own[0])
            look = {"marker": "."} | _look(index, len(names))
            axes.plot(scores[closed, 0], across[closed], label=shortened(name), **look)
        axes.set_xlabel(f"mode 1 (sd; {100 * share[0]:.0f} % of the variance)")
        if scores.shape[1] > 1:
            axes.set_ylabel(f"mode 2 (sd; {100 * share[1]:.0f} %)")
        else:
            axes.set_yticks([])
        axes.set_aspect("equal", adjustable="datalim")
        if len(names) <= LABELLED_SUBJECTS:
            drawing.legend(loc="outside right upper")
    return drawing


def volumes_figure(curves: Sequence[VolumeCurve]) -> Figure:
    """Draw the volumes of every part over the cycle, one line per subject.

    Parameters
    ----------
    curves : sequence of VolumeCurve
        At least one.
    """
    parts = list(dict.fromkeys(curve.part for curve in curves))
    subjects = list(dict.fromkeys(curve.subject for curve in curves))
    with styled():
        drawing = figure(max(85.0 * len(parts), 100.0), 75.0)
        grid = drawing.subplots(1, len(parts), squeeze=False)[0]
        for axes, part in zip(grid, parts, strict=True):
            for curve in curves:
                if curve.part != part:
                    continue
                look = _look(subjects.index(curve.subject), len(subjects))
                axes.plot(
                    np.append(curve.times, curve.times[0] + 1.0),
                    np.append(curve.volumes, curve.volumes[0]) / MM3_PER_ML,
                    label=shortened(curve.subject),
                    **look,
                )
            axes.set_title(part)
            axes.set_xlabel("time (fraction of the cycle)")
            axes.set_ylabel("volume (ml)")
            axes.set_ylim(bottom=0.0)
        if len(subjects) <= LABELLED_SUBJECTS:
            handles, labels = grid[0].get_legend_handles_labels()
            drawing.legend(handles, labels, loc="outside upper center", ncols=min(len(labels), 4))
    return drawing


def _look(index: int, count: int) -> dict[str, Any]:
    """Line of one of several subjects; many of them are not told apart."""
    if count > LABELLED_SUBJECTS:
        return {"color": PART_COLOURS[5], "linewidth": 0.8, "alpha": 0.6}
    return _marked_line(index)


def _marked_line(index: int) -> dict[str, Any]:
    """One of several lines: colour and marker tell them apart, in print too."""
    return {
        "color": SUBJECT_COLOURS[index % len(SUBJECT_COLOURS)],
        "marker": MARKERS[index % len(MARKERS)],
        "markersize": 3.5,
        "linewidth": 1.1,
    }


def _bands(axes: Axes, bands: Mapping[str, Band]) -> None:
    for kind, band in bands.items():
        _band(axes, kind, band, KIND_NAMES[kind])
    axes.set_ylim(bottom=0.0)


def _band(axes: Axes, kind: str, band: Band, label: str) -> None:
    """A curve of one kind of model; colour and marker tell the kinds apart, in print too."""
    shown = band.modes <= MODES_DRAWN
    modes, mean, half = band.modes[shown], band.mean[shown], band.half_width[shown]
    colour, marker = COLOURS[kind], KIND_MARKERS[kind]
    axes.plot(modes, mean, color=colour, label=label, marker=marker, markersize=3.5)
    axes.fill_between(
        modes,
        mean - half,
        mean + half,
        facecolor=to_rgba(colour, 0.1),
        edgecolor=to_rgba(colour, 0.6),
        linewidth=0.6,
    )
