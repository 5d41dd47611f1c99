"""What a report says about who and when: levels of the dynamic model, and the heart's motion."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ostiform.arrays import FloatArray
from ostiform.evaluation import LEVELS, ClinicalTable, DynamicEvaluation
from ostiform.report.html import Picture, Section, Table
from ostiform.report.style import (
    MARKERS,
    SUBJECT_COLOURS,
    decimal,
    figure,
    percent,
    shortened,
    styled,
)

LEVEL_NAMES = {
    "between": "between subjects",
    "within": "within subjects (motion)",
    "common": "motion common to all",
    "departure": "own motion",
}
MODES_DRAWN = 8
CURVES_NAMED = 8
"""More subjects than this share one colour."""

SAME_AREA = 1e-9
"""Rounding of the area of a rim that is followed from another point, relative to the area."""

MEASURES = {
    "long_axis_shortening_percent": "long-axis shortening (%)",
    "twist_deg": "twist (degrees)",
}
SIZES = {
    "_volume_ml": "volume (ml)",
    "_long_axis_mm": "long axis (mm)",
    "_area_mm2": "area (mm²)",
    "_diameter_max_mm": "largest diameter (mm)",
    "_diameter_min_mm": "smallest diameter (mm)",
}
SIZES_SHOWN = 6

HEADINGS = {
    "_ejection_fraction_percent": "ejection fraction (%)",
    "_long_axis_shortening_percent": "long-axis shortening (%)",
    "_twist_deg": "twist (deg)",
}


def cycles_section(evaluation: DynamicEvaluation | None) -> Section:
    """Return the levels of a dynamic model and how left-out phases are predicted.

    Parameters
    ----------
    evaluation : DynamicEvaluation or None
        None where no subject has several phases.
    """
    title = "Who and when"
    if evaluation is None:
        return Section(
            "cycles",
            title,
            ("Every subject has one phase, so there is no motion to tell from the subjects.",),
        )
    left_out = (
        "Fewer than three subjects: none was left out, and there are no intervals."
        if evaluation.division is None
        else f"Left-out residues: {evaluation.division.value}; mean and modes of every level are "
        "computed without them, in the correspondence of all."
    )
    return Section(
        "cycles",
        title,
        (
            "The variance of all shapes is exactly that between the subjects' mean shapes and that "
            "of the motion within subjects; the motion is that common to all and each subject's "
            "own. The files dynamics.json and dynamics.h5 hold the numbers and the model.",
            left_out,
        ),
        (
            Picture(
                "levels",
                levels_figure(evaluation),
                "Cumulative variance, left-out residue and specificity of every level by the "
                "number of its modes; 0 is the mean alone.",
                "Curves over the number of modes, one per level.",
            ),
        ),
        (_levels_table(evaluation), *_phases_tables(evaluation)),
    )


def levels_figure(evaluation: DynamicEvaluation) -> Figure:
    """Draw compactness, generalisation and specificity of the levels of a dynamic model."""
    variance: dict[str, tuple[FloatArray, FloatArray]] = {}
    residue: dict[str, tuple[FloatArray, FloatArray]] = {}
    distance: dict[str, tuple[FloatArray, FloatArray]] = {}
    for name in LEVELS:
        cumulative = np.concatenate([[0.0], np.cumsum(evaluation.level(name).variances)])
        variance[name] = np.arange(float(len(cumulative))), cumulative
        if evaluation.residues is not None:
            values = getattr(evaluation.residues, name).mean(axis=0)
            residue[name] = np.arange(float(len(values))), values
        if name in evaluation.specificity:
            found = evaluation.specificity[name]
            distance[name] = found.mode_counts.astype(np.float64), found.mean
    panels = [
        ("Compactness", "variance (mm² per point)", variance),
        ("Generalisation", "left-out residue (mm)", residue),
        ("Specificity", "distance to nearest (mm)", distance),
    ]
    drawn = [panel for panel in panels if panel[2]]
    with styled():
        drawing = figure(63.0 * len(drawn), 72.0)
        grid = drawing.subplots(1, len(drawn), squeeze=False)[0]
        for axes, (title, label, lines) in zip(grid, drawn, strict=True):
            for name, (modes, values) in lines.items():
                shown = modes <= MODES_DRAWN
                axes.plot(
                    modes[shown],
                    values[shown],
                    color=SUBJECT_COLOURS[LEVELS.index(name)],
                    linestyle="--" if name == "common" else "-",
                    marker=".",
                    label=LEVEL_NAMES[name],
                )
            axes.set_title(title)
            axes.set_xlabel("modes")
            axes.set_ylabel(label)
            axes.xaxis.set_major_locator(MaxNLocator(nbins=6, integer=True))
            axes.set_ylim(bottom=0.0)
        handles, labels = grid[0].get_legend_handles_labels()
        drawing.legend(
            handles, labels, loc="outside upper center", ncols=4 if len(drawn) > 2 else 2
        )
    return drawing


def clinical_section(table: ClinicalTable) -> Section:
    """Return the course of long axis, twist and openings over the cycle."""
    subjects = [id.subject for id in table.ids]
    if len(set(subjects)) == len(subjects):
        return Section(
            "clinical",
            "Openings, long axis and twist",
            (
                "Sizes of the shapes as sampled by the model. The file clinical.csv holds them for "
                "every shape; every subject has one phase, so there is no shortening, twist or "
                "ejection to show.",
            ),
            (),
            (_sizes_table(table),),
        )
    return Section(
        "clinical",
        "Openings, long axis and twist over the cycle",
        (
            "Numbers of the shapes as sampled by the model. Annulus: the widest opening of a part; "
            "long axis: from its centre to the point of the part furthest from it on the mean "
            "shape; shortening and twist are against the phase in which the part is largest. The "
            "file clinical.csv holds all of them, the documentation defines them.",
        ),
        (
            Picture(
                "clinical",
                clinical_figure(table),
                "Shortening, twist and area of the widest opening over the cycle (one that two "
                "parts share is drawn once), one line per subject; the first phase is repeated at "
                "the end.",
                "Closed curves against time, a row of panels per part.",
            ),
        ),
        (_clinical_table(table), _sizes_table(table)),
    )


def clinical_figure(table: ClinicalTable) -> Figure:
    """Draw shortening, twist and the largest opening's area of every part over the cycle."""
    subjects = np.array([id.subject for id in table.ids])
    times = np.array([id.time for id in table.ids])
    names = list(dict.fromkeys(subjects.tolist()))
    panels = _panels(table)
    columns = max(len(row) for row in panels)
    with styled():
        drawing = figure(62.0 * columns, 58.0 * len(panels))
        grid = drawing.subplots(len(panels), columns, squeeze=False)
        for row, shown in zip(grid, panels, strict=True):
            for axes, (column, label) in zip(row, shown, strict=False):
                values = table.column(column)
                for index, name in enumerate(names):
                    own = np.flatnonzero(subjects == name)
                    own = own[np.argsort(times[own], kind="stable")]
                    colour = SUBJECT_COLOURS[index % len(SUBJECT_COLOURS)]
                    axes.plot(
                        np.append(times[own], times[own[0]] + 1.0),
                        np.append(values[own], values[own[0]]),
                        color=colour if len(names) <= CURVES_NAMED else SUBJECT_COLOURS[0],
                        linewidth=1.1 if len(names) <= CURVES_NAMED else 0.6,
                        marker=MARKERS[index % len(MARKERS)] if len(names) <= CURVES_NAMED else "",
                        markersize=3.5,
                        label=shortened(name),
                    )
                axes.set_title(label, fontsize=9)
                axes.set_xlabel("time (fraction of the cycle)")
            for axes in row[len(shown) :]:
                axes.set_axis_off()
        if len(names) <= CURVES_NAMED:
            handles, labels = grid[0][0].get_legend_handles_labels()
            drawing.legend(handles, labels, loc="outside upper center", ncols=min(len(labels), 4))
    return drawing


def _panels(table: ClinicalTable) -> list[list[tuple[str, str]]]:
    parts = [name.removesuffix("_volume_ml") for name in table.columns if name.endswith("_ml")]
    panels = []
    drawn_areas: list[str] = []  # an opening that two parts share is drawn once
    for part in parts:
        shown = [
            (f"{part}_{suffix}", f"{part}: {label}")
            for suffix, label in MEASURES.items()
            if f"{part}_{suffix}" in table.columns
        ]
        areas = [n for n in table.columns if n.endswith("_area_mm2") and _owner(table, n) == part]
        areas = [n for n in areas if not any(_is_same(table, n, m) for m in drawn_areas)]
        if areas:
            widest = max(areas, key=lambda name: float(table.column(name).mean()))
            drawn_areas.append(widest)
            opening = widest.removesuffix("_area_mm2").removeprefix(f"{part}_")
            shown.append((widest, f"{part}.{opening}: area (mm²)"))
        if shown:
            panels.append(shown)
    return panels or [[(name, name) for name in table.columns[:1]]]


def _is_same(table: ClinicalTable, first: str, second: str) -> bool:
    one, other = table.column(first), table.column(second)
    return bool(np.abs(one - other).max() <= SAME_AREA * np.abs(one).max())


def _clinical_table(table: ClinicalTable) -> Table:
    subjects = np.array([id.subject for id in table.ids])
    shown = [name for name in table.columns if name.endswith(tuple(HEADINGS))]
    rows = []
    for subject in dict.fromkeys(subjects.tolist()):
        own = subjects == subject
        cells = []
        for name in shown:
            values = table.column(name)[own]
            largest = float(values[np.abs(values).argmax()])
            cells.append("" if np.isnan(largest) else decimal(largest, 1))
        rows.append((str(subject), *cells))
    return Table(
        "Largest over the cycle", ("subject", *(_heading(name) for name in shown)), tuple(rows)
    )


def _sizes_table(table: ClinicalTable) -> Table:
    """Mean, spread and extremes of every size over the shapes."""
    rows = []
    for column in table.columns:
        name = _size_name(table, column)
        if name is None:
            continue
        values = table.column(column)
        low, high = int(values.argmin()), int(values.argmax())
        rows.append(
            (
                name,
                f"{values.mean():.1f}",
                f"{values.std(ddof=1):.1f}" if len(values) > 1 else "",
                f"{values[low]:.1f} ({table.ids[low]})",
                f"{values[high]:.1f} ({table.ids[high]})",
            )
        )
    return Table(
        "Sizes over all shapes",
        ("size", "mean", "sd", "smallest (shape)", "largest (shape)"),
        tuple(rows),
        rows_shown=SIZES_SHOWN,
    )


def _size_name(table: ClinicalTable, column: str) -> str | None:
    """Return ``LA.RSPV area (mm²)`` for ``LA_RSPV_area_mm2``; None for what is no size."""
    for suffix, text in SIZES.items():
        if column.endswith(suffix):
            named, part = column.removesuffix(suffix), _owner(table, column)
            opening = named.removeprefix(part).removeprefix("_")
            return f"{part}.{opening} {text}" if opening else f"{part} {text}"
    return None


def _owner(table: ClinicalTable, column: str) -> str:
    """Return the part that a column is about: the longest that its name begins with."""
    parts = [name.removesuffix("_volume_ml") for name in table.columns if name.endswith("_ml")]
    return max((part for part in parts if column.startswith(f"{part}_")), key=len, default="")


def _heading(column: str) -> str:
    """Return a column of ``clinical.csv`` as the head of a table: ``LV twist (deg)``."""
    for suffix, text in HEADINGS.items():
        if column.endswith(suffix):
            return f"{column.removesuffix(suffix)} {text}"
    return column


def _levels_table(evaluation: DynamicEvaluation) -> Table:
    rows = []
    for name in LEVELS:
        share, level = evaluation.shares[name], evaluation.level(name)
        interval = (
            "none"
            if share.low is None or share.high is None
            else f"{percent(share.low)} to {percent(share.high)}"
        )
        residue = (
            "not measured"
            if evaluation.residues is None
            else " / ".join(
                f"{getattr(evaluation.residues, name).mean(axis=0)[count]:.2f}"
                for count in (0, 1, 3)
            )
        )
        found = evaluation.specificity.get(name)
        rows.append(
            (
                LEVEL_NAMES[name],
                f"{level.total_variance:.2f}",
                percent(share.value),
                interval,
                str(len(level.modes)),
                residue,
                "none" if found is None else f"{found.mean[-1]:.2f}",
            )
        )
    return Table(
        "Levels of the dynamic model",
        (
            "level",
            "variance (mm² per point)",
            "share (%)",
            "95 % interval over subjects (%)",
            "modes",
            "left-out residue at 0 / 1 / 3 modes (mm)",
            "specificity (mm)",
        ),
        tuple(rows),
    )


def _phases_tables(evaluation: DynamicEvaluation) -> tuple[Table, ...]:
    phases = evaluation.phases
    if phases is None:
        return ()
    return (
        Table(
            f"Left-out phases ({phases.phases}, each in turn), mean error",
            ("predicted by", "error (mm)", "relative to interpolation"),
            (
                (
                    "the fitted cycle",
                    f"{phases.trajectory:.3f}",
                    f"{phases.trajectory / phases.interpolation:.2f}"
                    if phases.interpolation > 0.0
                    else "undefined",
                ),
                ("straight line between neighbours", f"{phases.interpolation:.3f}", "1.00"),
            ),
        ),
    )
