"""What a report says about a model, as sections of text, tables and figures (HY Figs 2 to 4)."""

from collections.abc import Mapping, Sequence

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.evaluation import (
    Comparison,
    Evaluation,
    GainInterval,
    Generalisation,
    paired_difference,
)
from ostiform.model import mean_half_width
from ostiform.report.curves import Band, GainPoint, evidence_figure, gains_figure
from ostiform.report.evidence_tables import gain_table, interval_text, model_table, residue_table
from ostiform.report.html import Fact, Picture, Section, Table
from ostiform.report.style import KIND_NAMES, percent

TOO_FEW = "Fewer than three subjects: there are no intervals over subjects."


def headline(
    evaluations: Mapping[str, Evaluation], n_certified: int, n_shapes: int, seconds: float
) -> tuple[Fact, ...]:
    """Return the numbers at the top of a report.

    Parameters
    ----------
    evaluations : mapping of kind to Evaluation
    n_certified, n_shapes : int
        Shapes whose maps are certified, and shapes of the study.
    seconds : float
        Wall time of the stages before the report.
    """
    optimal = evaluations["optimal"]
    subjects = len({shape.subject for shape in optimal.ids})
    facts = [
        Fact(
            "shapes in the model",
            str(len(optimal.ids)),
            None if len(optimal.ids) == n_shapes else False,
            f"of {_counted(subjects)}"
            + ("" if len(optimal.ids) == n_shapes else f"; the study has {n_shapes} shapes"),
        ),
        Fact(
            "maps certified free of folds",
            "all" if n_certified == n_shapes else f"{n_certified} of {n_shapes}",
            n_certified == n_shapes,
            f"every triangle of {n_certified} shapes, in exact arithmetic",
        ),
    ]
    if optimal.generalisation is not None:
        counts = optimal.generalisation.mode_counts
        facts.append(
            Fact(
                "surface residue of left-out shapes",
                f"{_left_out_residue(optimal):.3f} mm",
                note=f"mean over {int(counts[counts > 0].min())} to {int(counts.max())} modes",
            )
        )
    worst = max(range(len(optimal.ids)), key=lambda i: optimal.coverage[i].relative_maximum)
    facts.append(
        Fact(
            "surface missed by the points, at most",
            f"{100 * optimal.coverage[worst].relative_maximum:.2f} %",
            note=f"of the diameter of shape {optimal.ids[worst]}",
        )
    )
    if optimal.truth is not None:
        facts.append(
            Fact(
                "distance to the true correspondence",
                f"{optimal.truth.mean:.2f} mm",
                note=f"mean; 95 % below {optimal.truth.p95:.2f} mm (known, as the shapes are made)",
            )
        )
    facts.append(Fact("time", _duration(seconds), note="all stages before this report"))
    return tuple(facts)


def _duration(seconds: float) -> str:
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60.0)
    return f"{minutes} min" if minutes < 120 else f"{minutes / 60.0:.1f} h"


def headline_table(
    evaluations: Mapping[str, Evaluation],
    comparisons: Sequence[Comparison],
    intervals: Mapping[str, GainInterval],
) -> Table:
    """Return compactness and generalisation of the three models, with the optimal one's gains.

    Parameters
    ----------
    evaluations : mapping of kind to Evaluation
    comparisons : sequence of Comparison
        Of the optimal model with each of the others.
    intervals : mapping of kind to GainInterval
        Of the gains over the other models, where there are enough subjects.
    """
    against = {item.other: item for item in comparisons}
    rows = []
    for kind, item in evaluations.items():
        found = against.get(kind)
        residue = _left_out_residue(item)
        rows.append(
            (
                KIND_NAMES[kind],
                f"{item.compactness.total:.2f}",
                ""
                if found is None
                else f"{percent(found.variance_gain)} %{interval_text(intervals.get(kind))}",
                ""
                if found is None or found.paper_gain is None
                else f"{100 * found.paper_gain:.0f} %",
                "not measured" if residue is None else f"{residue:.3f}",
                "" if found is None else _residue_gain(found, residue),
            )
        )
    return Table(
        "The three models of the paper. Gain: how much less variance or residue the optimal model "
        "has than this one, with its 95 % interval over subjects where there are at least three.",
        (
            "model",
            "compactness: total variance (mm²)",
            "gain of the optimal model",
            "in the paper",
            "generalisation: left-out residue (mm)",
            "gain of the optimal model",
        ),
        tuple(rows),
    )


def _left_out_residue(item: Evaluation) -> float | None:
    """Surface residue over the numbers of modes from 1, the subjects' mean."""
    if item.generalisation is None:
        return None
    some = item.generalisation.mode_counts > 0
    residues = item.generalisation.surface_mean[:, some].mean(axis=1)
    return paired_difference(residues, [shape.subject for shape in item.ids], False).mean


def _residue_gain(comparison: Comparison, residue: float | None) -> str:
    if comparison.residues is None or not residue:
        return ""
    paired = comparison.residues.surface_over_modes
    value = f"{percent(paired.mean / residue)} %"
    if paired.low is None or paired.high is None:
        return value
    return f"{value} ({percent(paired.low / residue)} to {percent(paired.high / residue)})"


def _counted(subjects: int) -> str:
    return "1 subject" if subjects == 1 else f"{subjects} subjects"


def evidence_section(
    evaluations: Mapping[str, Evaluation],
    comparisons: Sequence[Comparison],
    intervals: Mapping[str, GainInterval],
    variance_errors: Mapping[str, FloatArray],
) -> Section:
    """Return the comparison of the three models (HY Fig. 4).

    Parameters
    ----------
    evaluations : mapping of kind to Evaluation
    comparisons : sequence of Comparison
        Of the optimal model with each of the others.
    intervals : mapping of kind to GainInterval
        Of the gains over the other models, where there are enough subjects.
    variance_errors : mapping of kind to (K,) float64, mm^2
        Half-width of the interval of each cumulative variance.
    """
    has_intervals = len({shape.subject for shape in evaluations["optimal"].ids}) > 2
    pictures = [
        Picture(
            "evidence",
            evidence_figure(
                {
                    kind: Band(
                        np.arange(1.0, len(item.compactness.variances) + 1.0),
                        item.compactness.cumulative,
                        variance_errors[kind],
                    )
                    for kind, item in evaluations.items()
                },
                {
                    kind: _residue_band(item.generalisation, [s.subject for s in item.ids])
                    for kind, item in evaluations.items()
                    if item.generalisation is not None
                },
                {
                    kind: Band(
                        item.specificity.mode_counts.astype(float),
                        item.specificity.mean,
                        1.96 * item.specificity.standard_error,
                    )
                    for kind, item in evaluations.items()
                },
            ),
            "Analysis of variance, residue of left-out shapes (mean surface distance, both ways) "
            "and specificity of the three models (compare Fig. 4 of the paper). "
            + (
                "Bands: 95 % intervals over subjects, by the jackknife for the variance and t for "
                "the residue; sampling error for the specificity."
                if has_intervals
                else f"{TOO_FEW} The bands of the specificity are its sampling error."
            ),
            "Curves over the number of modes for the conformal, minimum Euclidean and optimal "
            "model; the same numbers are in the tables below.",
        ),
        _gains_picture(comparisons, intervals),
    ]
    paragraphs = [
        "Conformal: points sampled where the map puts them. Minimum Euclidean: warped by level 1 "
        "only. Optimal: warped to minimise the description length. The three share template, "
        "weights, alignment and cut-off, fixed from the conformal mean.",
    ]
    some = next(iter(evaluations.values())).generalisation
    if some is not None:
        paragraphs.append(f"Generalisation: {some.division.value}.")
    return Section(
        "evidence",
        "Is the model good?",
        tuple(paragraphs),
        tuple(pictures),
        (
            model_table(evaluations),
            *([residue_table(evaluations)] if some is not None else []),
            gain_table(comparisons, intervals),
        ),
        notes=(_definitions(evaluations, comparisons),),
    )


def _definitions(evaluations: Mapping[str, Evaluation], comparisons: Sequence[Comparison]) -> str:
    """What the columns of the tables are."""
    said = [
        "Coverage is the distance from a shape's own mesh to its sampled surface "
        "that 95 % of the mesh stay below, for the worst shape; the smallest area share ratio is "
        "the least area that a point still stands for, against what it stood for before the "
        "warps (well below 0.2: points have left a region)"
    ]
    if any(item.residues is not None for item in comparisons):
        said.append(
            "the worst residue ratio is the largest quotient of residues, optimal over other, at "
            "any number of modes (above 1: somewhere the optimal model is worse)"
        )
    if any(item.truth is not None for item in evaluations.values()):
        said.append(
            "the true correspondence is known for generated shapes, and the last columns say how "
            "far points lie from where they belong"
        )
    return "; ".join(said) + "."


def _gains_picture(
    comparisons: Sequence[Comparison], intervals: Mapping[str, GainInterval]
) -> Picture:
    gains = {}
    differences = {}
    for item in comparisons:
        interval = intervals.get(item.other)
        gains[item.other] = GainPoint(
            item.variance_gain,
            None if interval is None else (interval.low, interval.high),
            item.paper_gain,
        )
        if item.residues is None:
            continue
        paired = item.residues.surface
        differences[item.other] = Band(
            np.array(list(paired), dtype=float),
            np.array([value.mean for value in paired.values()]),
            np.array(
                [0.0 if v.high is None else v.high - v.mean for v in paired.values()], dtype=float
            ),
        )
    return Picture(
        "gains",
        gains_figure(gains, differences),
        "What the optimal model gains over the other two, shape by shape on the same subjects. "
        + (
            "Bars and bands: 95 % intervals over subjects; where they stay above zero the gain is "
            "more than chance."
            if intervals
            else TOO_FEW
        )
        + " Crosses: what the paper reports for its data.",
        "Gains in variance with intervals, and the difference of the left-out residues over the "
        "number of modes; the same numbers are in the tables.",
    )


def _residue_band(generalisation: Generalisation, subjects: Sequence[str]) -> Band:
    _, index, counts = np.unique(subjects, return_inverse=True, return_counts=True)
    sums = np.zeros((len(counts), generalisation.surface_mean.shape[1]))
    np.add.at(sums, index, generalisation.surface_mean)
    means = sums / counts[:, None]  # (S, M)
    half = mean_half_width(means)
    return Band(
        generalisation.mode_counts.astype(float),
        means.mean(axis=0),
        np.zeros(means.shape[1]) if half is None else half,
    )
