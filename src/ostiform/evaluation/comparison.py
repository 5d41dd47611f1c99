"""The three models of the paper side by side (HY Fig. 4): gains and paired differences."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.errors import InputError
from ostiform.evaluation.coverage import Coverage
from ostiform.evaluation.folds import Division
from ostiform.evaluation.types import Evaluation
from ostiform.model import mean_half_width
from ostiform.values import value

PAPER_GAINS = {"conformal": 0.67, "euclidean": 0.25}
"""How much more compact the optimal model was in HY section 3."""

COVERAGE_ROUNDING = 1e-12
"""Of the diameter: added to both distances, so that two exact samplings compare as equal."""


@dataclass(frozen=True, slots=True)
class PairedDifference:
    """Mean over subjects of a difference between two models of the same shapes.

    Attributes
    ----------
    mean : float
    low, high : float or None
        Ends of the 95 % t interval over the subjects' means; None where no interval can be given.
    subjects : int
    """

    mean: float
    low: float | None
    high: float | None
    subjects: int


@value
class ResidueComparison:
    """Residues of left-out shapes, other - model, mm.

    Attributes
    ----------
    surface, point : mapping of int to PairedDifference
        Of the mean surface residue and of the point residue, by number of modes.
    surface_over_modes : PairedDifference
        Of the mean surface residue averaged over all numbers of modes but 0.
    worst_ratio : float
        Largest ratio of the mean surface residues over the shapes, model / other, at any number
        of modes but 0.
    """

    surface: Mapping[int, PairedDifference]
    point: Mapping[int, PairedDifference]
    surface_over_modes: PairedDifference
    worst_ratio: float


@value
class Comparison:
    """One model against another of the same shapes, on the same shared metric.

    Attributes
    ----------
    model, other : str
        Kinds of model.
    variance_gain : float
        ``1 - V_model / V_other``, V the total variance.
    paper_gain : float or None
        The gain that HY report for this pair.
    description_length_difference : float
        Other - model.
    specificity_difference : float, mm
        Other - model, with all modes.
    coverage_ratio : float
        Largest ratio over the shapes of the 95 % distance to the sampled surface, model / other.
    residues : ResidueComparison or None
        None where no shape was left out.
    truth_ratio : mapping of str to float
        Mean distance to the true correspondence, model / other, by part; ``"all"`` for all points.
        Empty where the truth is not known.
    """

    model: str
    other: str
    variance_gain: float
    paper_gain: float | None
    description_length_difference: float
    specificity_difference: float
    coverage_ratio: float
    residues: ResidueComparison | None
    truth_ratio: Mapping[str, float]


def paired_difference(
    differences: FloatArray, subjects: Sequence[str], with_interval: bool = True
) -> PairedDifference:
    """Return the mean over subjects of the shapes' differences (N,), with its t interval.

    Parameters
    ----------
    differences : (N,) float64
    subjects : (N,) sequence of str
    with_interval : bool
        False where the subjects were not left out as a whole: then no interval is stated.

    Raises
    ------
    InputError
        If the lengths differ or there is nothing to compare.
    """
    if not len(differences) == len(subjects) > 0:
        raise InputError(
            f"paired differences: expected one subject for each of {len(differences)} "
            f"differences, found {len(subjects)}"
        )
    _, index, counts = np.unique(np.asarray(subjects), return_inverse=True, return_counts=True)
    means = np.bincount(index, weights=differences) / counts  # (S,)
    mean, half = float(means.mean()), mean_half_width(means)
    if not with_interval or half is None:
        return PairedDifference(mean, None, None, len(means))
    return PairedDifference(mean, mean - float(half), mean + float(half), len(means))


def compare(model: Evaluation, other: Evaluation) -> Comparison:
    """Compare a model with another one of the same shapes.

    Raises
    ------
    InputError
        If the two were not evaluated on the same shapes, folds and shared metric.
    """
    if model.ids != other.ids or model.l_cut != other.l_cut:
        raise InputError(
            f"comparison of the {model.kind} and the {other.kind} model: expected the same shapes "
            f"and the same l_cut, found {len(model.ids)} and {len(other.ids)} shapes, l_cut "
            f"{model.l_cut:g} and {other.l_cut:g} mm^2"
        )
    return Comparison(
        model=model.kind,
        other=other.kind,
        variance_gain=1.0 - model.compactness.total / other.compactness.total,
        paper_gain=PAPER_GAINS.get(other.kind) if model.kind == "optimal" else None,
        description_length_difference=other.description_length - model.description_length,
        specificity_difference=float(other.specificity.mean[-1] - model.specificity.mean[-1]),
        coverage_ratio=max(map(_coverage_ratio, model.coverage, other.coverage)),
        residues=_compared_residues(model, other),
        truth_ratio=_truth_ratios(model, other),
    )


def _coverage_ratio(mine: Coverage, theirs: Coverage) -> float:
    rounding = COVERAGE_ROUNDING * mine.diameter
    return (mine.p95 + rounding) / (theirs.p95 + rounding)


def _compared_residues(model: Evaluation, other: Evaluation) -> ResidueComparison | None:
    mine, theirs = model.generalisation, other.generalisation
    if mine is None or theirs is None:
        return None
    counts = tuple(int(count) for count in mine.mode_counts)
    if counts != tuple(theirs.mode_counts) or mine.division is not theirs.division:
        raise InputError(
            f"comparison of the {model.kind} and the {other.kind} model: expected residues of the "
            "same folds at the same numbers of modes, found others"
        )
    subjects = [id.subject for id in model.ids]
    with_interval = mine.division is not Division.PHASE_BLOCKS
    surface = theirs.surface_mean - mine.surface_mean  # (N, M)
    point = theirs.point - mine.point
    some = np.array(counts) > 0
    ratios = mine.surface_mean.mean(axis=0)[some] / theirs.surface_mean.mean(axis=0)[some]
    return ResidueComparison(
        surface={
            count: paired_difference(surface[:, column], subjects, with_interval)
            for column, count in enumerate(counts)
        },
        point={
            count: paired_difference(point[:, column], subjects, with_interval)
            for column, count in enumerate(counts)
        },
        surface_over_modes=paired_difference(
            surface[:, some].mean(axis=1), subjects, with_interval
        ),
        worst_ratio=float(ratios.max()),
    )


def _truth_ratios(model: Evaluation, other: Evaluation) -> dict[str, float]:
    mine, theirs = model.truth, other.truth
    if mine is None or theirs is None:
        return {}
    return {"all": mine.mean / theirs.mean} | {
        part: mine.parts[part][0] / theirs.parts[part][0] for part in mine.parts
    }
