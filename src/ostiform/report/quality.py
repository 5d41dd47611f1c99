"""What a report says about every single shape: the worst first, with a picture of those flagged."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ostiform.arrays import BoolArray, FloatArray
from ostiform.evaluation import Evaluation, MapRecord, PointResidues
from ostiform.model import StoredModel, reconstruct
from ostiform.report.html import Picture, Section, Table
from ostiform.report.point_pictures import shapes_figure, surfaces_figure
from ostiform.surface import Surface

FLAGGED_ABOVE = 3.5
"""Modified z-score of an outlier (Iglewicz and Hoaglin 1993)."""

FEWEST_SUBJECTS = 5
"""Among fewer, the one that differs most is no outlier."""

LEAST_SPREAD = 0.05
"""Of the median: a population more alike than this has no outliers worth a flag."""

MAD_TO_SD = 1.4826
LEAST_AREA_SHARE = 0.2
MOST_PICTURES = 12
PER_PICTURE = 6
SCALE_QUANTILE = 0.99


@dataclass(frozen=True, slots=True, eq=False)
class FailedShape:
    """A shape that was left out.

    Attributes
    ----------
    label : str
    stage : str
        Where it failed.
    parts : mapping of str to Surface
        Its surfaces as read; empty where it could not be read.
    """

    label: str
    stage: str
    parts: Mapping[str, Surface]


@dataclass(frozen=True, slots=True)
class ReadShape:
    """What was done to a shape before its map.

    Attributes
    ----------
    repairs : int
        How many there were.
    turned : float, degrees
        From the frame of its file to the population's.
    """

    repairs: int
    turned: float


@dataclass(frozen=True, slots=True, eq=False)
class _Measure:
    """One number per shape: the larger, the worse."""

    title: str
    short: str
    leads: str
    """What is said of the largest value where none is flagged."""
    values: FloatArray
    digits: int
    factor: float = 1.0


def quality_section(
    stored: StoredModel,
    evaluation: Evaluation,
    maps: Sequence[MapRecord],
    residues: PointResidues | None,
    read: Mapping[str, ReadShape],
    failed: Sequence[FailedShape],
) -> Section:
    """Return every shape's quality, the worst first, and what to look at.

    Parameters
    ----------
    stored : StoredModel
    evaluation : Evaluation
        Of the same model.
    maps : sequence of MapRecord
        Of the same shapes.
    residues : PointResidues or None
        Of the same shapes, where some could be left out.
    read : mapping of str to ReadShape
        By shape; empty where the shapes came in correspondence.
    failed : sequence of FailedShape
    """
    measures = _measures(stored, evaluation, maps)
    subjects = [shape.subject for shape in stored.ids]
    scores = np.stack([modified_scores(measure.values) for measure in measures], axis=1)  # (N, M)
    flags = flagged_measures(scores, subjects)
    smallest = np.array([item.smallest_share_ratio for item in evaluation.coverage])
    reasons = [
        [measures[m].short for m in np.flatnonzero(flags[i])]
        + (["points have left a region"] if smallest[i] < LEAST_AREA_SHARE else [])
        for i in range(len(flags))
    ]
    order = np.lexsort([-scores.max(axis=1), [-len(reason) for reason in reasons]])
    flagged = [int(i) for i in order if reasons[i]]
    labels = [str(shape) for shape in stored.ids]
    rows = [
        (
            labels[i],
            ", ".join(reasons[i]) or "none",
            *(f"{m.factor * m.values[i]:.{m.digits}f}" for m in measures),
            f"{smallest[i]:.2f}",
            *_read_cells(read.get(labels[i])),
        )
        for i in order
    ]
    table = Table(
        "Every shape in the model, the worst first",
        (
            "shape",
            "stands out by",
            *(measure.title for measure in measures),
            "smallest area share ratio",
            "turned from its file (deg)",
            "repairs",
        ),
        tuple(rows),
        texts=(1,),
    )
    text = (
        f"{len(flagged)} of {len(labels)} shapes stand out. A shape is flagged where a number lies "
        f"more than {FLAGGED_ABOVE} robust standard deviations above the median of all, or where "
        f"its smallest area share ratio is below {LEAST_AREA_SHARE}; of a subject of which most "
        f"phases are, the worst, among at least {FEWEST_SUBJECTS} subjects. A flag asks for a "
        "look, not for removal: the hearts that differ most are flagged too. Twist is the angle by "
        "which a tube (a vein, an outflow tract) is turned on its way to its circle."
    )
    return Section(
        "shapes",
        "Shape by shape",
        (text,),
        (
            *_pictures(stored, flagged, reasons, measures, residues),
            *_failed_pictures(failed),
        ),
        (table,),
    )


def _read_cells(read: ReadShape | None) -> tuple[str, str]:
    return ("", "") if read is None else (f"{read.turned:.0f}", str(read.repairs))


def modified_scores(values: FloatArray) -> FloatArray:
    """Return how many robust standard deviations (N,) values lie above their median.

    The spread is the median absolute deviation, at least `LEAST_SPREAD` of the median (Iglewicz
    and Hoaglin 1993).

    Parameters
    ----------
    values : (N,) float64
        Not negative.
    """
    middle = float(np.median(values))
    spread = MAD_TO_SD * float(np.median(np.abs(values - middle)))
    floor = max(LEAST_SPREAD * abs(middle), np.finfo(np.float64).tiny)
    scores: FloatArray = (values - middle) / max(spread, floor)
    return scores


def flagged_measures(scores: FloatArray, subjects: Sequence[str]) -> BoolArray:
    """Return which modified scores (N, M) are those of outliers.

    Where most phases of a subject are, it is the subject that stands out: its worst phase alone is
    flagged, among at least `FEWEST_SUBJECTS`.

    Parameters
    ----------
    scores : (N, M) float64
    subjects : (N,) sequence of str
    """
    found: BoolArray = scores > FLAGGED_ABOVE
    names, owner = np.unique(np.asarray(subjects), return_inverse=True)
    for subject in range(len(names)):
        own = np.flatnonzero(owner == subject)
        for m in np.flatnonzero(2 * found[own].sum(axis=0) > len(own)):
            found[own, m] = False
            found[own[scores[own, m].argmax()], m] = len(names) >= FEWEST_SUBJECTS
    return found


def _measures(
    stored: StoredModel, evaluation: Evaluation, maps: Sequence[MapRecord]
) -> list[_Measure]:
    deviations = np.sqrt(np.maximum(stored.model.variances, np.finfo(np.float64).tiny))
    carried = evaluation.compactness.modes_for(0.95)
    unusual = np.sqrt(((stored.scores / deviations)[:, :carried] ** 2).mean(axis=1))
    found = [
        _Measure(
            "map: angle distortion, mean",
            "distorted map",
            "largest angle distortion",
            np.array([max(c.distortion.angle_mean for c in item.components) for item in maps]),
            2,
        ),
        _Measure(
            "map: largest twist (deg)",
            "twisted tube",
            "largest twist",
            np.array(
                [
                    max(
                        (abs(t) for c in item.components for t in c.certificate.twist.values()),
                        default=0.0,
                    )
                    for item in maps
                ]
            ),
            0,
            float(np.degrees(1.0)),
        ),
        _Measure(
            "surface missed by the points, at most (% of the diameter)",
            "badly covered",
            "largest distance from the points",
            np.array([item.relative_maximum for item in evaluation.coverage]),
            2,
            100.0,
        ),
        _Measure(
            "distance from the mean (mm, RMS)",
            "far from the mean",
            "farthest from the mean",
            np.sqrt((stored.scores**2).sum(axis=1)),
            2,
        ),
        _Measure(
            "scores (sd, RMS over 95 % of the variance)",
            "unusual scores",
            "largest scores",
            unusual,
            2,
        ),
    ]
    if evaluation.generalisation is not None:
        some = evaluation.generalisation.mode_counts > 0
        found.insert(
            3,
            _Measure(
                "surface residue, left out (mm)",
                "large left-out residue",
                "largest left-out residue",
                evaluation.generalisation.surface_mean[:, some].mean(axis=1),
                2,
            ),
        )
    return found


def _pictures(
    stored: StoredModel,
    flagged: Sequence[int],
    reasons: Sequence[Sequence[str]],
    measures: Sequence[_Measure],
    residues: PointResidues | None,
) -> list[Picture]:
    labels = [str(shape) for shape in stored.ids]
    said = {i: "\n".join([labels[i], *reasons[i]]) for i in flagged[:MOST_PICTURES]}
    if not said:
        leaders: dict[int, list[str]] = {}
        for measure in measures:
            leaders.setdefault(int(np.argmax(measure.values)), []).append(measure.leads)
        said = {i: "\n".join([labels[i], *names]) for i, names in leaders.items()}
    shown = list(said)
    largest = 0.0
    if residues is not None:
        largest = float(np.quantile(residues.residues[shown], SCALE_QUANTILE))
    beyond = len(flagged) - MOST_PICTURES
    caption = (
        "The flagged shapes" if flagged else "No shape is flagged; these lead in one number each"
    ) + (f" (the first {MOST_PICTURES}; {beyond} more are in the table)." if beyond > 0 else ".")
    if residues is not None:
        caption += (
            f" Below: distance of every point from its reconstruction with up to {residues.modes} "
            "modes of a model built without the shape, its correspondence kept."
        )
    pictures = []
    for start in range(0, len(shown), PER_PICTURE):
        own = shown[start : start + PER_PICTURE]
        pictures.append(
            Picture(
                f"flagged{start // PER_PICTURE + 1}",
                shapes_figure(
                    stored.model,
                    reconstruct(stored.model, stored.scores[own]),
                    [said[i] for i in own],
                    None if residues is None else residues.residues[own],
                    largest,
                ),
                caption if start == 0 else "More flagged shapes.",
                "Shaded surfaces of single shapes, each with what it stands out by.",
                is_vector=False,
            )
        )
    return pictures


def _failed_pictures(failed: Sequence[FailedShape]) -> list[Picture]:
    read = [shape for shape in failed if shape.parts]
    if not read:
        return []
    shown = read[:PER_PICTURE]
    more = f" (the first {PER_PICTURE} of {len(read)})" if len(read) > PER_PICTURE else ""
    return [
        Picture(
            "left-out",
            surfaces_figure([(f"{s.label}\nleft out: {s.stage}", s.parts) for s in shown]),
            f"Shapes that were left out{more}, as they were read; the warnings say why.",
            "Shaded surfaces of the shapes that are not in the model.",
            is_vector=False,
        )
    ]
