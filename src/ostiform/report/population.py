"""What a report says about the shapes: modes, scores, template, correspondence (HY Fig. 3)."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ostiform.correspondence import Correspondence
from ostiform.domain import triangle_quality
from ostiform.evaluation import DynamicEvaluation, Evaluation
from ostiform.model import (
    DynamicModel,
    ShapeModel,
    StoredModel,
)
from ostiform.report.curves import convergence_figure, scores_figure
from ostiform.report.html import Picture, Section, Table
from ostiform.report.modes import modes_figure
from ostiform.report.style import percent

MODES_SHOWN = 3


def modes_section(model: ShapeModel, dynamic: DynamicModel | None = None) -> Section:
    """Return the mean shape and its first modes (HY Fig. 3).

    Parameters
    ----------
    model : ShapeModel
    dynamic : DynamicModel or None
        Of the same shapes: its first mode between subjects and its first of the motion are drawn
        too.
    """
    pictures = [
        _mode_picture(model, mode, f"mode{mode + 1}", f"Mode {mode + 1}", "the variance")
        for mode in range(min(MODES_SHOWN, len(model.variances)))
    ]
    text = (
        "The mean displaced by \N{MINUS SIGN}3 to +3 standard deviations along each mode, from two "
        "sides (compare Fig. 3 of the paper). Dark lines are the openings and seams."
    )
    if dynamic is not None:
        levels = [
            (
                dynamic.between,
                "between1",
                "First mode between subjects",
                "the variance between subjects",
            ),
            (dynamic.within, "motion1", "First mode of the motion", "the variance of the motion"),
        ]
        levels = [level for level in levels if len(level[0].variances)]
        pictures += [_mode_picture(part, 0, *names) for part, *names in levels]
        text += (
            " These modes mix how subjects differ with how they move; the last pictures show the "
            "one without the other."
        )
    return Section("modes", "Modes of variation", (text,), tuple(pictures))


def _mode_picture(model: ShapeModel, mode: int, name: str, title: str, whole: str) -> Picture:
    share = model.variances[mode] / model.total_variance
    return Picture(
        name,
        modes_figure(model, mode),
        f"{title}: {100 * share:.1f} % of {whole}, standard deviation "
        f"{np.sqrt(model.variances[mode]):.2f} mm per point.",
        f"Five shaded surfaces in two rows: the mean shape and its displacement. {title}.",
        is_vector=False,
    )


def scores_section(stored: StoredModel, dynamic: DynamicEvaluation | None) -> Section:
    """Return where the shapes lie in the space of the first modes, and who varies how much.

    Parameters
    ----------
    stored : StoredModel
    dynamic : DynamicEvaluation or None
        Of the same shapes; None where no subject has several phases.
    """
    model = stored.model
    subjects = [shape.subject for shape in stored.ids]
    times = np.array([shape.time for shape in stored.ids])
    standard = stored.scores / np.sqrt(np.maximum(model.variances, np.finfo(float).tiny))
    share = model.variances / model.total_variance
    return Section(
        "scores",
        "Scores of the shapes",
        () if dynamic is None else _sources(dynamic),
        (
            Picture(
                "scores",
                scores_figure(standard, subjects, times, share),
                ("Scores of the first two modes" if len(share) > 1 else "Scores of the mode")
                + (
                    "."
                    if dynamic is None
                    else "; the phases of a subject are joined in order of time, so that each "
                    "loop is a cycle."
                ),
                "Scatter of the shapes, one closed line per subject with several phases.",
            ),
        ),
    )


def _sources(dynamic: DynamicEvaluation) -> tuple[str, ...]:
    between, phases = dynamic.shares["between"], dynamic.phases
    interval = (
        ""
        if between.low is None or between.high is None
        else f" (95 % interval {percent(between.low)} to {percent(between.high)} %)"
    )
    text = (
        f"{percent(between.value)} % of the variance lies between subjects{interval}, the rest is "
        "motion."
    )
    if phases is not None:
        text += (
            f" A left-out phase is predicted from the subject's other phases to "
            f"{phases.trajectory:.2f} mm by the fitted cycle and to {phases.interpolation:.2f} mm "
            f"by interpolation ({phases.phases} phases left out in turn)."
        )
    return (text,)


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
            f"The points of the model: {len(template.points)} points and {len(template.faces)} "
            f"triangles, with {len(template.levels)} coarser levels that the optimisation starts "
            f"on. The surface of shape {evaluation.ids[worst]} is covered worst: the vertex of its "
            "mesh that the points come least near to lies "
            f"{item.maximum:.2f} mm from the sampled surface, "
            f"{100 * item.relative_maximum:.2f} % of its diameter.",
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


def _repeated(repeats: int, is_weaker: bool) -> tuple[str, ...]:
    if repeats == 0:
        return ()
    if not is_weaker:
        return (
            "The finest level was done again with its control points placed anew, because the "
            "conformal start was poor: the shapes were described far shorter than by it.",
        )
    times = "once" if repeats == 1 else f"{repeats} times"
    return (
        f"The finest level was done again {times}, each time with weaker coherence, because the "
        "shapes were described at greater length than by the conformal start.",
    )


def correspondence_section(facts: Mapping[str, Any]) -> Section:
    """Return how the optimisation went.

    Parameters
    ----------
    facts : mapping
        Of the correspondence stage: history (`SweepRecord` as plain values), statuses (how each
        level ended), control points of the finest level, coherence, settings.
    """
    history, statuses, settings = facts["history"], facts["statuses"], facts["settings"]
    n_interior, n_boundary = (
        len(facts["control_points"][group]["directions"]) for group in ("interior", "boundary")
    )
    repeats = max(len(statuses) - settings["levels"], 0)
    finer = [record for record in history if record["level"] > 1]
    pictures = []
    if finer:
        pictures.append(
            Picture(
                "convergence",
                convergence_figure(finer),
                "Left: the objective after every sweep over all shapes, against time. Compare it "
                "within a level only: each level has its own points. Right: what every term of "
                "it has changed by since its level began; the lines add up to the change of the "
                "objective. Level 1 minimises another objective and is not drawn.",
                "Falling curves, one per level; beside them one line per term of the objective.",
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
            *_repeated(repeats, facts["coherence"] < settings["coherence"]),
        ),
        tuple(pictures),
        (Table("How each level ended", ("level", "sweeps", "ended because"), rows, texts=(2,)),),
    )
