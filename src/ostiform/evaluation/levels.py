"""The evidence about a dynamic model: its levels, who and when, and its trajectories (design 6)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ostiform import __version__
from ostiform.evaluation.dynamics import LEVELS, LevelResidues, level_residues
from ostiform.evaluation.folds import Division, cross_validation_folds
from ostiform.evaluation.generalisation import MODE_COUNTS
from ostiform.evaluation.specificity import Specificity, model_specificity
from ostiform.model import (
    DynamicModel,
    PhasePrediction,
    ShapeModel,
    TrajectorySettings,
    VarianceShare,
    fit_dynamic_model,
    level_shapes,
    phase_prediction,
    reconstruct,
    variance_shares,
)

QUICK = TrajectorySettings(harmonics=(3,), smoothness=(1e-3,), stiffness=(10.0,), powers=(4,))
"""For models of folds, of which only the levels are used."""

_SPECIFICITY = ("mode_counts", "mean", "standard_error")


@dataclass(frozen=True, slots=True, eq=False)
class DynamicEvaluation:
    """How good a dynamic model is.

    Attributes
    ----------
    model : DynamicModel
    shares : mapping of level to VarianceShare
        Of the total variance.
    residues : LevelResidues or None
        Of all subjects, each left out; None where there are fewer than three.
    division : Division or None
        What was left out together.
    specificity : mapping of level to Specificity
        Levels without variation are absent.
    phases : PhasePrediction or None
        Left-out phases against interpolation; None where no phase can be left out.
    """

    model: DynamicModel
    shares: dict[str, VarianceShare]
    residues: LevelResidues | None
    division: Division | None
    specificity: dict[str, Specificity]
    phases: PhasePrediction | None

    def level(self, name: str) -> ShapeModel:
        """Return the model of one level."""
        level: ShapeModel = getattr(self.model, name)
        return level


def evaluate_dynamic_model(model: DynamicModel, seed: int, samples: int) -> DynamicEvaluation:
    """Measure the levels and the trajectories of a dynamic model.

    Subjects are left out with all their phases, and mean and modes of every level computed
    without them; the correspondence is that of all subjects.

    Parameters
    ----------
    model : DynamicModel
    seed : int
        Of the random shapes of the specificity.
    samples : int
        Random shapes of every level.
    """
    rng = np.random.default_rng(seed)
    training = level_shapes(model)
    specificity = {
        name: model_specificity(getattr(model, name), training[name], rng, samples)
        for name in LEVELS
        if len(getattr(model, name).modes)
    }
    residues, division = _left_out(model)
    errors = model.trajectories.left_out_errors
    return DynamicEvaluation(
        model=model,
        shares=variance_shares(model),
        residues=residues,
        division=division,
        specificity=specificity,
        phases=phase_prediction(model) if np.isfinite(errors).any() else None,
    )


def dynamic_evaluation_facts(evaluation: DynamicEvaluation) -> dict[str, Any]:
    """Return an evaluation as plain values for JSON; mm, and mm^2 per point."""
    model, residues, phases = evaluation.model, evaluation.residues, evaluation.phases
    levels = {}
    for name in ("total", *LEVELS):
        level, share = evaluation.level(name), evaluation.shares.get(name)
        found = evaluation.specificity.get(name)
        levels[name] = {
            "variances_mm2": level.variances.tolist(),
            "cumulative_mm2": np.cumsum(level.variances).tolist(),
            "total_mm2": level.total_variance,
            "share": None if share is None else share.value,
            "share_95_percent": None
            if share is None or share.low is None
            else [share.low, share.high],
            "left_out_residue_mm": None
            if residues is None or name == "total"
            else getattr(residues, name).mean(axis=0).tolist(),
            "left_out_residues_mm": None
            if residues is None or name == "total"
            else getattr(residues, name).tolist(),
            "specificity_mm": None
            if found is None
            else {
                **{key: getattr(found, key).tolist() for key in _SPECIFICITY},
                "n_samples": found.n_samples,
            },
        }
    return {
        "schema": 1,
        "package_version": __version__,
        "units": "mm",
        "subjects": list(model.subjects),
        "effective_phases": model.effective_phases,
        "between_corrected": {
            "variances_mm2": model.between_corrected.variances.tolist(),
            "total_mm2": model.between_corrected.total_variance,
            "clipped_mm2": model.clipped_variance,
        },
        "levels": levels,
        "mode_counts": list(MODE_COUNTS),
        "left_out": None if evaluation.division is None else evaluation.division.value,
        "left_out_subjects": None if residues is None else list(residues.subjects),
        "left_out_phases": None
        if phases is None
        else {
            "trajectory_mm": phases.trajectory,
            "interpolation_mm": phases.interpolation,
            "phases": phases.phases,
        },
    }


def dynamic_evaluation_from_facts(
    facts: Mapping[str, Any], model: DynamicModel
) -> DynamicEvaluation:
    """Return the evaluation of a dynamic model from what `dynamic_evaluation_facts` returned."""
    levels, phases = facts["levels"], facts["left_out_phases"]
    return DynamicEvaluation(
        model=model,
        shares={
            name: VarianceShare(
                levels[name]["share"], *(levels[name]["share_95_percent"] or (None, None))
            )
            for name in LEVELS
        },
        residues=None
        if facts["left_out_subjects"] is None
        else LevelResidues(
            tuple(facts["left_out_subjects"]),
            *(np.array(levels[name]["left_out_residues_mm"]) for name in LEVELS),
        ),
        division=None if facts["left_out"] is None else Division(facts["left_out"]),
        specificity={
            name: Specificity(
                **{key: np.array(found[key]) for key in _SPECIFICITY},
                n_samples=found["n_samples"],
            )
            for name in LEVELS
            if (found := levels[name]["specificity_mm"]) is not None
        },
        phases=None
        if phases is None
        else PhasePrediction(phases["trajectory_mm"], phases["interpolation_mm"], phases["phases"]),
    )


def _left_out(model: DynamicModel) -> tuple[LevelResidues | None, Division | None]:
    if len(model.subjects) < 3:
        return None, None
    shapes = reconstruct(model.total, model.scores)
    folds = cross_validation_folds(model.ids)
    parts = []
    for fold in folds.folds:
        train, test = list(fold.train), list(fold.test)
        fitted = fit_dynamic_model(
            shapes[train],
            [model.ids[index] for index in train],
            model.total.weights,
            model.total.mesh,
            QUICK,
        )
        parts.append(level_residues(fitted, shapes[test], [model.ids[index] for index in test]))
    return (
        LevelResidues(
            tuple(subject for part in parts for subject in part.subjects),
            *(np.concatenate([getattr(part, name) for part in parts]) for name in LEVELS),
        ),
        folds.division,
    )
