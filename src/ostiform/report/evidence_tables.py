"""The tables of the evidence: models, left-out residues, gains."""

from collections.abc import Mapping, Sequence

from ostiform.evaluation import (
    Comparison,
    Evaluation,
    GainInterval,
)
from ostiform.report.html import Table
from ostiform.report.style import KIND_NAMES, decimal, percent


def model_table(evaluations: Mapping[str, Evaluation]) -> Table:
    """Return what is measured of every model, one row each."""
    rows = []
    for kind, item in evaluations.items():
        truth = [] if item.truth is None else [f"{item.truth.mean:.2f} / {item.truth.p95:.2f}"]
        spread, surface = item.spread, item.surface_specificity
        rows.append(
            (
                KIND_NAMES[kind],
                f"{item.compactness.total:.2f}",
                ""
                if spread is None
                else f"{spread.variance.normal:.2f} / {spread.variance.tangential:.2f}",
                str(item.compactness.modes_for(0.95)),
                f"{item.description_length:.2f}",
                f"{item.specificity.mean[-1]:.2f}",
                "" if surface is None else f"{surface.mean:.2f}",
                f"{max(c.p95 for c in item.coverage):.2f}",
                f"{min(c.smallest_share_ratio for c in item.coverage):.2f}",
                *truth,
            )
        )
    is_known = next(iter(evaluations.values())).truth is not None
    return Table(
        "The three models on one shared metric",
        (
            "model",
            "total variance (mm²)",
            "across / along the surface (mm²)",
            "modes for 95 %",
            "description length",
            "specificity to points (mm)",
            "to the surface (mm)",
            "coverage, worst 95 % (mm)",
            "smallest area share ratio",
            *(["true correspondence, mean / 95 % (mm)"] if is_known else []),
        ),
        tuple(rows),
    )


def residue_table(evaluations: Mapping[str, Evaluation]) -> Table:
    """Return the residues of left-out shapes by number of modes."""
    counts: list[int] = []
    rows = []
    for kind, item in evaluations.items():
        if item.generalisation is None:
            continue
        counts = [int(count) for count in item.generalisation.mode_counts]
        means = item.generalisation.surface_mean.mean(axis=0)
        rows.append((KIND_NAMES[kind], *(f"{value:.3f}" for value in means)))
    return Table(
        "Surface residue of left-out shapes (mm) by the number of modes; 0 is the mean shape",
        ("model", *(str(count) for count in counts)),
        tuple(rows),
    )


def gain_table(comparisons: Sequence[Comparison], intervals: Mapping[str, GainInterval]) -> Table:
    """Return what the optimal model gains over each of the others, with intervals."""
    rows = []
    measured = [item.residues for item in comparisons if item.residues is not None]
    for item in comparisons:
        paper = "" if item.paper_gain is None else f"{100 * item.paper_gain:.0f} %"
        residue: list[str] = ["", ""] if measured else []
        if item.residues is not None:
            paired = item.residues.surface_over_modes
            interval = (
                ""
                if paired.low is None or paired.high is None
                else f" ({_signed(paired.low)} to {_signed(paired.high)})"
            )
            residue = [f"{_signed(paired.mean)}{interval}", f"{item.residues.worst_ratio:.3f}"]
        truth = item.truth_ratio.get("all")
        rows.append(
            (
                KIND_NAMES[item.other],
                f"{percent(item.variance_gain)} %{interval_text(intervals.get(item.other))}",
                paper,
                _signed(item.description_length_difference, 2),
                *residue,
                *([] if truth is None else [f"{truth:.3f}"]),
            )
        )
    return Table(
        "The optimal model against the others (differences: the other minus the optimal)",
        (
            "against",
            "variance gain (95 % interval)",
            "in the paper",
            "description length",
            *(
                [
                    f"residue, 1 to {max(measured[0].surface)} modes (mm, 95 % interval)",
                    "worst residue ratio",
                ]
                if measured
                else []
            ),
            *(["distance to truth, ratio"] if any(c.truth_ratio for c in comparisons) else []),
        ),
        tuple(rows),
    )


def _signed(value: float, digits: int = 3) -> str:
    return decimal(value, digits, "+")


def interval_text(interval: GainInterval | None) -> str:
    """Return an interval of a gain as text in brackets; "" where there is none."""
    if interval is None:
        return ""
    return f" ({percent(interval.low)} to {percent(interval.high)})"
