"""The whole cycle of an unseen heart, from files of some of its phases to files of all of it.

Artifacts in the output folder: ``phase_FFFF.vtp`` (the shape at F / 10,000 of the cycle, with the
standard deviation of its points), ``clinical.csv`` and ``prediction.json``.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ostiform import __version__
from ostiform.arrays import FloatArray
from ostiform.atomic import atomically
from ostiform.errors import InputError
from ostiform.evaluation import clinical_measures, long_axes
from ostiform.exchange import write_shape_values_csv
from ostiform.fitting import (
    CloudTarget,
    FileRules,
    FitPrior,
    FitSettings,
    ShapeFit,
    checked_size,
    fit_prior,
    fit_shape,
    read_targets,
    shape_deviations,
)
from ostiform.model import (
    ENOUGH_SUBJECTS,
    CyclePredictor,
    ObservedPhase,
    PredictedCycle,
    StoredModel,
    dynamic_model_of,
    fit_cycle_predictor,
    predict_cycle,
    read_model,
    reconstruct,
)
from ostiform.study import ShapeId
from ostiform.surface import placed_vertices, read_mesh, write_surface

ENOUGH_PHASES = 4
"""Times of the cycle that say how a motion runs between its extremes."""


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """A predicted cycle, and what it was predicted with.

    Attributes
    ----------
    stored : StoredModel
    predictor : CyclePredictor
    cycle : PredictedCycle
    sources : tuple of str
        How each given phase became a shape in correspondence.
    """

    stored: StoredModel
    predictor: CyclePredictor
    cycle: PredictedCycle
    sources: tuple[str, ...]


def predicted_cycle(
    model: Path, shapes: Sequence[str], given: Sequence[float], times: FloatArray, rules: FileRules
) -> Prediction:
    """Predict the cycle of a heart from files of some of its phases.

    Parameters
    ----------
    model : Path
        A model file of a population with several phases.
    shapes : sequence of str
        One per phase, in one frame: a file, or several joined by commas, each ``FILE`` or
        ``PART=FILE``. A mesh with the model's own points and triangles is taken as it is; to
        anything else the model is fitted.
    given : sequence of float
        Fraction of the cycle of every shape.
    times : (T,) float64
        Fractions of the cycle to predict.
    rules : FileRules

    Raises
    ------
    OstiformError
        If a file cannot be read, or the model knows too little of cycles.
    """
    if len(shapes) != len(given) or not shapes:
        raise InputError(
            f"given phases: expected a time for each of at least one shape, found {len(shapes)} "
            f"shapes and {len(given)} times; give --times once per shape, as 0,0.35"
        )
    stored = read_model(model)
    dynamic = dynamic_model_of(stored)
    predictor = fit_cycle_predictor(dynamic, given)
    prior: FitPrior | None = None
    phases, sources = [], []
    for shape, time in zip(shapes, given, strict=True):
        points = _corresponded(shape, stored, rules)
        if points is not None:
            nothing = np.zeros((0, *points.shape))
            phases.append(ObservedPhase(float(time), points, nothing))
            sources.append("points in correspondence")
            continue
        prior = fit_prior(stored) if prior is None else prior
        targets = read_targets(shape.split(","), stored.model.mesh.parts, rules, {})
        fit = fit_shape(prior, targets, FitSettings())
        phases.append(phase_of_fit(prior, fit, float(time)))
        sources.append(f"fitted, residue {fit.residues.to_model.mean:.2f} mm")
    return Prediction(stored, predictor, predict_cycle(predictor, phases, times), tuple(sources))


def phase_of_fit(prior: FitPrior, fit: ShapeFit, time: float) -> ObservedPhase:
    """Return the phase that a model was fitted to, in the frame of its data."""
    return ObservedPhase(time, fit.points, shape_deviations(prior, fit))


def weak_prior_warning(predictor: CyclePredictor) -> str | None:
    """Return the sentence that says that there are too few training subjects, if so."""
    if not predictor.is_weak:
        return None
    return (
        f"the prior is weak: expected at least {ENOUGH_SUBJECTS} training subjects, found "
        f"{len(predictor.model.subjects)}; the prediction is hardly more than the mean motion, and "
        "its intervals are rough"
    )


def few_phases_warning(stored: StoredModel, times: FloatArray) -> str | None:
    """Return the sentence that says that a cycle is made of few phases, if so."""
    known = np.unique(np.round([id.time for id in stored.ids], 3))
    if len(known) >= ENOUGH_PHASES:
        return None
    between = int((np.abs(np.asarray(times)[:, None] - known).min(axis=1) > 1e-3).sum())
    if not between:
        return None
    return (
        f"the model knows {len(known)} times of the cycle ({', '.join(f'{t:g}' for t in known)}): "
        f"{between} of the {len(times)} shapes lie between them and are no more than interpolated"
    )


def write_prediction(folder: Path, prediction: Prediction) -> dict[str, Any]:
    """Write a predicted cycle and return what ``prediction.json`` holds."""
    model, cycle = prediction.stored.model, prediction.cycle
    folder.mkdir(parents=True, exist_ok=True)
    for time, shape, deviation in zip(cycle.times, cycle.shapes, cycle.deviations, strict=True):
        write_surface(
            folder / f"phase_{round(1e4 * float(time)):04d}.vtp",
            shape,
            model.mesh.faces,
            point_data={"sd_mm": deviation},
            cell_data={"part": model.mesh.face_part},
        )
    training = reconstruct(model, prediction.stored.scores)
    found = clinical_measures(cycle.shapes, model.mesh, long_axes(training, model.mesh))
    ids = [ShapeId("predicted", f"{time:.4f}", float(time)) for time in cycle.times]
    values = np.stack(list(found.values()), axis=1)
    write_shape_values_csv(folder / "clinical.csv", ids, list(found), values)
    predictor = prediction.predictor
    warnings = (weak_prior_warning(predictor), few_phases_warning(prediction.stored, cycle.times))
    facts: dict[str, Any] = {
        "schema": 1,
        "package_version": __version__,
        "given_times": predictor.times.tolist(),
        "given_shapes": list(prediction.sources),
        "times": cycle.times.tolist(),
        "training_subjects": len(predictor.model.subjects),
        "warning": "; ".join(warning for warning in warnings if warning) or None,
        "left_out_error_mm": float(np.nanmean(predictor.left_out_errors)),
        "left_out_mean_motion_mm": float(np.nanmean(predictor.mean_motion_errors)),
        "left_out_nearest_subject_mm": float(np.nanmean(predictor.nearest_subject_errors)),
        "mean_sd_mm": (np.sqrt(cycle.deviations**2 @ model.weights)).tolist(),
    }
    with atomically(folder / "prediction.json") as temporary:
        temporary.write_text(json.dumps(facts, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    return facts


def _corresponded(shape: str, stored: StoredModel, rules: FileRules) -> FloatArray | None:
    """Return the points (P, 3) of a mesh that is the model's own; None for any other."""
    path = Path(shape)
    if "," in shape or not path.is_file() or path.suffix.lower() not in (".vtp", ".vtk", ".ply"):
        return None
    mesh = read_mesh(path)
    faces = stored.model.mesh.faces
    if mesh.faces.shape != faces.shape or (mesh.faces != faces).any():
        return None
    try:
        points = placed_vertices(mesh, rules.units, rules.frame)
        checked_size(stored.model.mean, [CloudTarget(points)])
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return points
