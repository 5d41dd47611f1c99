"""What a report says about a model, as sections of text, tables and figures (HY Figs 2 to 4)."""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.special import stdtrit

from ostiform.arrays import FloatArray
from ostiform.correspondence import Correspondence
from ostiform.domain import triangle_quality
from ostiform.evaluation import Comparison, Evaluation, Generalisation
from ostiform.model import ShapeModel
from ostiform.report.curves import Band, convergence_figure, evidence_figure, scores_figure
from ostiform.report.html import Fact, Picture, Section, Table
from ostiform.report.modes import modes_figure
from ostiform.report.style import KIND_NAMES

__all__ = [
    "correspondence_section",
    "evidence_section",
    "headline",
    "modes_section",
    "scores_section",
    "template_section",
]

MODES_SHOWN = 3
CONFIDENCE = 0.95


def headline(
    evaluations: Mapping[str, Evaluation],
    comparisons: Sequence[Comparison],
    n_certified: int,
    n_shapes: int,
) -> tuple[Fact, ...]:
    """Return the numbers at the top of a report.

    Parameters
    ----------
    evaluations : mapping of kind to Evaluation
    comparisons : sequence of Comparison
        Of the optimal model with each of the others.
    n_certified, n_shapes : int
        Shapes whose maps are certified, and shapes of the study.
    """
    optimal = evaluations["optimal"]
    subjects = len({shape.subject for shape in optimal.ids})
    facts = [
        Fact("shapes in the model", f"{len(optimal.ids)} of {subjects} subjects"),
        Fact(
            "maps certified free of folds",
            f"{n_certified} of {n_shapes} shapes",
            n_certified == n_shapes,
        ),
    ]
    for comparison in comparisons:
        paper = "" if comparison.paper_gain is None else f" (paper: {comparison.paper_gain:.0%})"
        facts.append(
            Fact(
                f"more compact than {KIND_NAMES[comparison.other]}",
                f"{comparison.variance_gain:.0%}{paper}",
            )
        )
    if optimal.generalisation is not None:
        residue = optimal.generalisation.surface_mean[:, 1:].mean()
        facts.append(Fact("left-out surface residue, mean over modes", f"{residue:.2f} mm"))
    furthest = max(item.maximum / item.diameter for item in optimal.coverage)
    facts.append(Fact("largest distance to the sampled surface", f"{furthest:.2%} of the diameter"))
    if optimal.truth is not None:
        facts.append(Fact("distance to the true correspondence", f"{optimal.truth.mean:.2f} mm"))
    return tuple(facts)


def evidence_section(
    evaluations: Mapping[str, Evaluation], comparisons: Sequence[Comparison]
) -> Section:
    """Return the comparison of the three models (HY Fig. 4)."""
    pictures = [
        Picture(
            "evidence",
            evidence_figure(
                {kind: item.compactness.cumulative for kind, item in evaluations.items()},
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
            "Analysis of variance, leave-one-subject-out residue (mean surface distance, both "
            "ways) and specificity of the three models (compare Fig. 4 of the paper). Bands: 95 % "
            "t interval over subjects for the residue, sampling error for the specificity.",
            "Curves over the number of modes for the conformal, minimum Euclidean and optimal "
            "model; the same numbers are in the tables below.",
        )
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
            _model_table(evaluations),
            *([_residue_table(evaluations)] if some is not None else []),
            _gain_table(comparisons),
        ),
    )


def modes_section(model: ShapeModel) -> Section:
    """Return the mean shape and its first modes (HY Fig. 3)."""
    share = model.variances / model.total_variance
    shown = range(min(MODES_SHOWN, len(model.variances)))
    return Section(
        "modes",
        "Modes of variation",
        (
            "The mean displaced by -3 to +3 standard deviations along each mode, from two sides "
            "(compare Fig. 3 of the paper). Dark lines are the openings.",
        ),
        tuple(
            Picture(
                f"mode{mode + 1}",
                modes_figure(model, mode),
                f"Mode {mode + 1}: {share[mode]:.1%} of the variance, standard deviation "
                f"{np.sqrt(model.variances[mode]):.2f} mm per point.",
                f"Five shaded surfaces in two rows: the mean shape and its displacement along "
                f"mode {mode + 1}.",
                is_vector=False,
            )
            for mode in shown
        ),
    )


def scores_section(model: ShapeModel, scores: FloatArray, evaluation: Evaluation) -> Section:
    """Return where the shapes lie in the space of the first modes."""
    subjects = [shape.subject for shape in evaluation.ids]
    times = np.array([shape.time for shape in evaluation.ids])
    standard = scores / np.sqrt(np.maximum(model.variances, np.finfo(float).tiny))
    share = model.variances / model.total_variance
    return Section(
        "scores",
        "The shapes in the model",
        (),
        (
            Picture(
                "scores",
                scores_figure(standard, subjects, times, share),
                "Scores of the first two modes; the phases of a subject are joined in order of "
                "time, so that each loop is a cycle.",
                "Scatter of the shapes, one closed line per subject.",
            ),
        ),
    )


def template_section(correspondence: Correspondence, evaluation: Evaluation) -> Section:
    """Return how even the template is and how it covers the shapes."""
    template = correspondence.template
    domain = triangle_quality(template.points, template.faces)
    mean = triangle_quality(correspondence.aligned.mean(axis=0), template.faces)
    rows = [
        (
            name,
            f"{quality.worst:.2f}",
            f"{quality.mean:.2f}",
            f"{quality.min_angle:.1f}",
        )
        for name, quality in (("on the base domain", domain), ("on the mean shape", mean))
    ]
    worst = max(range(len(evaluation.ids)), key=lambda i: evaluation.coverage[i].maximum)
    item = evaluation.coverage[worst]
    return Section(
        "template",
        "Template",
        (
            f"{len(template.points)} points and {len(template.faces)} triangles, "
            f"{len(template.levels)} coarser levels. The surface of shape "
            f"{evaluation.ids[worst]} is covered worst: its furthest vertex lies "
            f"{item.maximum:.2f} mm from the sampled surface, {item.maximum / item.diameter:.2%} "
            "of its diameter.",
        ),
        (),
        (
            Table(
                "Triangle quality (eq. 2 of the paper, 1 for an equilateral triangle)",
                ("triangles", "worst", "mean", "smallest angle (deg)"),
                tuple(rows),
            ),
        ),
    )


def correspondence_section(
    history: Sequence[Mapping[str, float]],
    statuses: Sequence[str],
    n_interior: int,
    n_boundary: int,
) -> Section:
    """Return how the optimisation went.

    Parameters
    ----------
    history : sequence of mapping
        `SweepRecord` as plain values.
    statuses : sequence of str
        How each level ended.
    n_interior, n_boundary : int
        Control points of the finest level.
    """
    seconds = np.cumsum([record["seconds"] for record in history])
    levels = np.array([record["level"] for record in history], dtype=float)
    objective = np.array([record["objective"] for record in history])
    finer = levels > 1
    pictures = []
    if finer.any():
        pictures.append(
            Picture(
                "convergence",
                convergence_figure(
                    seconds[finer],
                    objective[finer],
                    levels[finer],
                    "description length + penalty",
                ),
                "Objective after every sweep over all shapes, against processor time; level 1 "
                "minimises another objective and is not drawn.",
                "Falling curves, one per level.",
            )
        )
    rows = tuple(
        (
            str(level),
            str(sum(record["level"] == level for record in history) - 1),
            status,
        )
        for level, status in enumerate(statuses, start=1)
    )
    return Section(
        "correspondence",
        "Correspondence",
        (
            f"{n_interior} control points in the interior and {n_boundary} on the boundaries "
            "(the paper ends with 10, those on the boundaries not counted).",
        ),
        tuple(pictures),
        (Table("How each level ended", ("level", "sweeps", "ended because"), rows),),
    )


def _residue_band(generalisation: Generalisation, subjects: Sequence[str]) -> Band:
    _, index, counts = np.unique(subjects, return_inverse=True, return_counts=True)
    sums = np.zeros((len(counts), generalisation.surface_mean.shape[1]))
    np.add.at(sums, index, generalisation.surface_mean)
    means = sums / counts[:, None]  # (S, M)
    half = np.zeros(means.shape[1])
    if len(means) > 2:
        quantile = stdtrit(len(means) - 1, 0.5 * (1.0 + CONFIDENCE))
        half = quantile * means.std(axis=0, ddof=1) / np.sqrt(len(means))
    return Band(generalisation.mode_counts.astype(float), means.mean(axis=0), half)


def _model_table(evaluations: Mapping[str, Evaluation]) -> Table:
    rows = []
    for kind, item in evaluations.items():
        truth = "" if item.truth is None else f"{item.truth.mean:.2f} / {item.truth.p95:.2f}"
        rows.append(
            (
                KIND_NAMES[kind],
                f"{item.compactness.total:.2f}",
                str(item.compactness.modes_for(0.95)),
                f"{item.description_length:.2f}",
                f"{item.specificity.mean[-1]:.2f}",
                f"{max(c.p95 for c in item.coverage):.2f}",
                f"{min(c.smallest_share_ratio for c in item.coverage):.2f}",
                truth,
            )
        )
    return Table(
        "The three models on one yardstick",
        (
            "model",
            "total variance (mm²)",
            "modes for 95 %",
            "description length",
            "specificity (mm)",
            "coverage, worst 95 % (mm)",
            "smallest area share ratio",
            "true correspondence, mean / 95 % (mm)",
        ),
        tuple(rows),
    )


def _residue_table(evaluations: Mapping[str, Evaluation]) -> Table:
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


def _gain_table(comparisons: Sequence[Comparison]) -> Table:
    rows = []
    for item in comparisons:
        paper = "" if item.paper_gain is None else f"{item.paper_gain:.0%}"
        difference, worst = "", ""
        if item.residues is not None:
            paired = item.residues.surface_over_modes
            interval = "" if paired.low is None else f" ({paired.low:+.3f} to {paired.high:+.3f})"
            difference = f"{paired.mean:+.3f}{interval}"
            worst = f"{item.residues.worst_ratio:.3f}"
        truth = item.truth_ratio.get("all")
        rows.append(
            (
                KIND_NAMES[item.other],
                f"{item.variance_gain:.1%}",
                paper,
                f"{item.description_length_difference:+.2f}",
                difference,
                worst,
                "" if truth is None else f"{truth:.3f}",
            )
        )
    return Table(
        "The optimal model against the others (differences: other - optimal)",
        (
            "against",
            "variance gain",
            "in the paper",
            "description length",
            "residue, 1 to 10 modes (mm, 95 % interval)",
            "worst residue ratio",
            "distance to truth, ratio",
        ),
        tuple(rows),
    )
