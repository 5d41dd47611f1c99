"""How well the cycle of an unseen heart is predicted from some of its phases, against baselines."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from scipy.special import ndtri

from ostiform.arrays import FloatArray, frozen_floats
from ostiform.errors import InputError
from ostiform.model import (
    CyclePredictor,
    DynamicModel,
    ObservedPhase,
    mean_cycle,
    pose_to_mean_cycle,
    predict_cycle,
    resampled_cycle,
)
from ostiform.values import Axes, value

QUANTILE = float(ndtri(0.975))
"""Half-width of a 95 % interval in standard deviations."""


@value
class PredictionErrors:
    """Errors of predicted phases of one unseen heart; weighted RMS distances of points, mm.

    Attributes
    ----------
    times : (n,) float64
        Of the phases that were predicted, fractions of the cycle.
    predicted : (n,) float64
        By Gaussian conditioning.
    mean_motion : (n,) float64
        By the given phase nearest in time, moved as the mean cycle moves.
    nearest_subject : (n,) float64
        The same, moved as the training subject moves that looks most like the given phases.
    coverage : (n,) float64
        Share of the points' coordinates, by area, inside their 95 % interval.
    """

    times: Annotated[FloatArray, Axes("T")]
    predicted: Annotated[FloatArray, Axes("T")]
    mean_motion: Annotated[FloatArray, Axes("T")]
    nearest_subject: Annotated[FloatArray, Axes("T")]
    coverage: Annotated[FloatArray, Axes("T")]


def prediction_errors(
    predictor: CyclePredictor, points: FloatArray, times: Sequence[float], given: Sequence[int]
) -> PredictionErrors:
    """Predict the phases of an unseen heart from some of them and compare with what they are.

    The pose in the model's frame is fitted to the given phases alone; distances are the same in
    any frame.

    Parameters
    ----------
    predictor : CyclePredictor
    points : (n, P, 3) float64, mm
        All phases in correspondence, in one frame of their own.
    times : (n,) sequence of float
        Fractions of the cycle.
    given : sequence of int
        Indices of the phases that are given.

    Raises
    ------
    InputError
        If no phase is left to predict.
    """
    model = predictor.model
    moments = np.asarray(times, dtype=np.float64)
    chosen = np.asarray(given, dtype=np.int64)
    other = np.setdiff1d(np.arange(len(moments)), chosen)
    if not len(other):
        raise InputError(
            f"errors of a predicted cycle: expected phases beyond the {len(chosen)} given ones to "
            "compare with, found none"
        )
    shapes = frozen_floats(points, (len(moments), None, 3), "phases of a heart")
    pose = pose_to_mean_cycle(model, shapes[chosen], moments[chosen])
    placed = shapes @ pose[:3, :3].T + pose[:3, 3]
    seen, true = placed[chosen], placed[other]
    certain = np.zeros((0, *model.total.mean.shape))
    phases = [
        ObservedPhase(time, shape, certain)
        for shape, time in zip(seen, moments[chosen], strict=True)
    ]
    found = predict_cycle(predictor, phases, moments[other])
    weights = model.total.weights
    mean_motion, nearest_subject = baseline_cycles(model, seen, moments[chosen], moments[other])
    inside = np.abs(found.shapes - true) <= QUANTILE * found.deviations[..., None]
    return PredictionErrors(
        times=moments[other],
        predicted=_distances(found.shapes, true, weights),
        mean_motion=_distances(mean_motion, true, weights),
        nearest_subject=_distances(nearest_subject, true, weights),
        coverage=inside.mean(axis=2) @ weights,
    )


def baseline_cycles(
    model: DynamicModel, seen: FloatArray, given: FloatArray, times: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return what two simple rules make of the given phases of a heart.

    Parameters
    ----------
    model : DynamicModel
    seen : (J, P, 3) float64, mm
        Given phases, placed by `pose_to_mean_cycle`.
    given : (J,) float64
        Their times, fractions of the cycle.
    times : (T,) float64

    Returns
    -------
    mean_motion, nearest_subject : (T, P, 3) float64, mm
        The given phase nearest in time, moved as the mean cycle moves, or as the training subject
        moves that looks most like the given phases.
    """
    apart = np.abs((times[:, None] - given + 0.5) % 1.0 - 0.5)
    nearest = apart.argmin(axis=1)  # (T,) given phase nearest in time
    at_given = np.stack([resampled_cycle(model, subject, given) for subject in model.subjects])
    unlike = np.einsum("sjpi,p->s", (at_given - seen) ** 2, model.total.weights)
    twin = int(unlike.argmin())
    mean_motion = mean_cycle(model, times) - mean_cycle(model, given)[nearest]
    motion = resampled_cycle(model, model.subjects[twin], times) - at_given[twin][nearest]
    return seen[nearest] + mean_motion, seen[nearest] + motion


def _distances(shapes: FloatArray, true: FloatArray, weights: FloatArray) -> FloatArray:
    squared = ((shapes - true) ** 2).sum(axis=2) @ weights
    distances: FloatArray = np.sqrt(squared)
    return distances
