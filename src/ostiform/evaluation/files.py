"""Evaluations and comparisons as JSON (design 7: ``evaluation.json``)."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from ostiform import __version__
from ostiform.atomic import atomically
from ostiform.errors import ArtifactError, OstiformError
from ostiform.evaluation.classical import ClassicalMeasures
from ostiform.evaluation.compactness import Compactness
from ostiform.evaluation.comparison import Comparison
from ostiform.evaluation.coverage import Coverage
from ostiform.evaluation.folds import Division
from ostiform.evaluation.generalisation import MEASURES, Generalisation
from ostiform.evaluation.specificity import Specificity
from ostiform.evaluation.specificity_to_surface import SurfaceSpecificity
from ostiform.evaluation.truth import TruthDistance
from ostiform.evaluation.types import Evaluation
from ostiform.evaluation.variance import DividedVariance, PopulationSpread
from ostiform.study import ShapeId

SCHEMA = 1

Facts = dict[str, Any]


def evaluation_facts(evaluation: Evaluation) -> Facts:
    """Return an evaluation as plain values for JSON; lengths in mm, variances in mm^2 per point."""
    generalisation, truth = evaluation.generalisation, evaluation.truth
    spread, surface = evaluation.spread, evaluation.surface_specificity
    classical = evaluation.classical
    return {
        **_heading(),
        "kind": evaluation.kind,
        "shapes": [asdict(id) for id in evaluation.ids],
        "compactness": {
            "variances_mm2": evaluation.compactness.variances.tolist(),
            "cumulative_mm2": evaluation.compactness.cumulative.tolist(),
            "total_mm2": evaluation.compactness.total,
        },
        "description_length": {
            "value": evaluation.description_length,
            "l_cut_mm2": evaluation.l_cut,
        },
        "specificity": {
            "mode_counts": evaluation.specificity.mode_counts.tolist(),
            "mean_mm": evaluation.specificity.mean.tolist(),
            "standard_error_mm": evaluation.specificity.standard_error.tolist(),
            "n_samples": evaluation.specificity.n_samples,
        },
        "coverage": [
            {
                "p95_mm": item.p95,
                "maximum_mm": item.maximum,
                "diameter_mm": item.diameter,
                "smallest_share": item.smallest_share,
                "smallest_share_ratio": item.smallest_share_ratio,
            }
            for item in evaluation.coverage
        ],
        "generalisation": None
        if generalisation is None
        else {
            "division": generalisation.division.name.lower(),
            "division_in_words": generalisation.division.value,
            "mode_counts": generalisation.mode_counts.tolist(),
            **{
                f"{name}_mm": {
                    "mean": getattr(generalisation, name).mean(axis=0).tolist(),
                    "shapes": getattr(generalisation, name).tolist(),
                }
                for name in MEASURES
            },
        },
        "truth": None
        if truth is None
        else {
            "mean_mm": truth.mean,
            "p95_mm": truth.p95,
            "parts": {
                part: {"mean_mm": mean, "p95_mm": p95} for part, (mean, p95) in truth.parts.items()
            },
        },
        "spread": None
        if spread is None
        else {
            "normal_variance_mm2": spread.variance.normal,
            "tangential_variance_mm2": spread.variance.tangential,
            "surface_variance_mm2": spread.surface_variance,
            "weight_drift": spread.weight_drift,
        },
        "surface_specificity": None
        if surface is None
        else {
            "mean_mm": surface.mean,
            "standard_error_mm": surface.standard_error,
            "samples_mm": surface.distances.tolist(),
        },
        "classical": None
        if classical is None
        else {
            "mode_counts": classical.mode_counts.tolist(),
            "compactness_mm2": classical.compactness.tolist(),
            "generalisation_mm": classical.generalisation.tolist(),
            "generalisation_error_mm": classical.generalisation_error.tolist(),
            "specificity_mm": classical.specificity.tolist(),
            "specificity_error_mm": classical.specificity_error.tolist(),
            "n_samples": classical.n_samples,
        },
    }


def evaluation_from_facts(facts: Mapping[str, Any]) -> Evaluation:
    """Return the evaluation that `evaluation_facts` made plain values of.

    Raises
    ------
    KeyError, TypeError, ValueError
        If something is missing or of the wrong kind.
    """
    if facts["schema"] != SCHEMA:
        raise ValueError(f"schema {facts['schema']} where {SCHEMA} can be read")
    residues, truth, random = facts["generalisation"], facts["truth"], facts["specificity"]
    spread, surface = facts.get("spread"), facts.get("surface_specificity")
    classical = facts.get("classical")
    return Evaluation(
        kind=facts["kind"],
        ids=tuple(ShapeId(**id) for id in facts["shapes"]),
        compactness=Compactness(
            np.array(facts["compactness"]["variances_mm2"], dtype=np.float64),
            facts["compactness"]["total_mm2"],
        ),
        description_length=facts["description_length"]["value"],
        l_cut=facts["description_length"]["l_cut_mm2"],
        specificity=Specificity(
            np.array(random["mode_counts"]),
            np.array(random["mean_mm"]),
            np.array(random["standard_error_mm"]),
            random["n_samples"],
        ),
        coverage=tuple(
            Coverage(
                item["p95_mm"],
                item["maximum_mm"],
                item["diameter_mm"],
                item["smallest_share"],
                item["smallest_share_ratio"],
            )
            for item in facts["coverage"]
        ),
        generalisation=None
        if residues is None
        else Generalisation(
            Division[residues["division"].upper()],
            np.array(residues["mode_counts"]),
            *(np.array(residues[f"{name}_mm"]["shapes"]) for name in MEASURES),
        ),
        truth=None
        if truth is None
        else TruthDistance(
            truth["mean_mm"],
            truth["p95_mm"],
            {part: (item["mean_mm"], item["p95_mm"]) for part, item in truth["parts"].items()},
        ),
        spread=None
        if spread is None
        else PopulationSpread(
            DividedVariance(spread["normal_variance_mm2"], spread["tangential_variance_mm2"]),
            spread["surface_variance_mm2"],
            spread["weight_drift"],
        ),
        surface_specificity=None
        if surface is None
        else SurfaceSpecificity(np.array(surface["samples_mm"])),
        classical=None if classical is None else _classical_from_facts(classical),
    )


def _classical_from_facts(facts: Mapping[str, Any]) -> ClassicalMeasures:
    return ClassicalMeasures(
        mode_counts=np.array(facts["mode_counts"]),
        compactness=np.array(facts["compactness_mm2"]),
        generalisation=np.array(facts["generalisation_mm"]),
        generalisation_error=np.array(facts["generalisation_error_mm"]),
        specificity=np.array(facts["specificity_mm"]),
        specificity_error=np.array(facts["specificity_error_mm"]),
        n_samples=facts["n_samples"],
    )


def comparison_facts(comparison: Comparison) -> Facts:
    """Return a comparison as plain values for JSON; differences are other - model, in mm."""
    residues = comparison.residues
    return {
        "model": comparison.model,
        "other": comparison.other,
        "variance_gain": comparison.variance_gain,
        "paper_gain": comparison.paper_gain,
        "description_length_difference": comparison.description_length_difference,
        "specificity_difference_mm": comparison.specificity_difference,
        "coverage_ratio": comparison.coverage_ratio,
        "truth_ratio": dict(comparison.truth_ratio),
        "residues_mm": None
        if residues is None
        else {
            "surface": {str(count): asdict(item) for count, item in residues.surface.items()},
            "point": {str(count): asdict(item) for count, item in residues.point.items()},
            "surface_over_modes": asdict(residues.surface_over_modes),
            "worst_ratio": residues.worst_ratio,
        },
    }


def write_evaluation(path: Path, evaluation: Evaluation) -> None:
    """Write an evaluation.

    Raises
    ------
    ArtifactError
        If the file cannot be written.
    """
    _write(path, evaluation_facts(evaluation))


def read_evaluation(path: Path) -> Evaluation:
    """Read what `write_evaluation` wrote.

    Raises
    ------
    ArtifactError
        If the file is missing, damaged or of another kind or schema.
    """
    try:
        return evaluation_from_facts(json.loads(path.read_text(encoding="utf-8")))
    except (
        OSError, ValueError, KeyError, IndexError, TypeError, AttributeError, RecursionError,
        OstiformError,
    ) as error:  # fmt: skip
        raise ArtifactError(
            f"{path}: expected an evaluation of ostiform, found a missing, foreign or damaged "
            f"file ({type(error).__name__}: {error}); run `ostiform evaluate` again"
        ) from error


def write_comparisons(path: Path, comparisons: Sequence[Comparison]) -> None:
    """Write comparisons of a model with others.

    Raises
    ------
    ArtifactError
        If the file cannot be written.
    """
    _write(path, {**_heading(), "comparisons": [comparison_facts(item) for item in comparisons]})


def _heading() -> Facts:
    return {"schema": SCHEMA, "units": "mm", "package_version": __version__}


def _write(path: Path, facts: Facts) -> None:
    with atomically(path) as temporary:
        temporary.write_text(json.dumps(facts, indent=1, allow_nan=False), encoding="utf-8")
