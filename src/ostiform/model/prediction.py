"""The whole cycle of a heart from one or a few of its phases: Gaussian conditioning.

The joint model of cycles, as functions of time, is

``x(t) = m(t) + sum_s b_s d_s(t) / sqrt(S - 1) + u + e(t)``,   b ~ N(0, I),

m the mean cycle and d_s the training subjects' departures from it, so that the second term has the
covariance of the subjects' cycles. What they do not explain of a new heart is the rest: its own
anatomy u, which the given phases show and which is carried through the cycle, and its own motion
e, a stationary process with the covariance ``sum_h E_h cos(2 pi h (t - t'))``. The given phases
determine the posterior in closed form (Rasmussen & Williams 2006, sections 2.2 and 2.7).
"""

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from scipy.linalg import eigh

from ostiform.arrays import FloatArray, frozen_floats
from ostiform.model.conditioning import CyclePrior, cycle_posterior
from ostiform.model.learning import (
    CyclePredictor,
    distinct_times,
    pose_to_mean_cycle,
    posed_cycles,
)
from ostiform.model.types import ShapeModel
from ostiform.values import Axes, value

KEPT_VARIANCE = 1e-4
"""Directions of the scores' uncertainty below this share of the largest are dropped."""


@value
class ObservedPhase:
    """One phase of a heart, whole or as far as it is known.

    Attributes
    ----------
    time : float
        Fraction of the cycle.
    points : (P, 3) float64, mm
        In correspondence with the model, in any rigid frame that all given phases share.
    rows : (Q, P, 3) float64, mm
        Their outer products sum to the covariance of the points; Q is 0 for a shape seen whole.
    """

    time: float
    points: Annotated[FloatArray, Axes("P", 3)]
    rows: Annotated[FloatArray, Axes(None, "P", 3)]


@value
class PredictedCycle:
    """A heart through its cycle.

    Attributes
    ----------
    times : (T,) float64
        Fractions of the cycle.
    shapes : (T, P, 3) float64, mm
        Expected shapes, in the frame of the given phases.
    deviations : (T, P) float64, mm
        Standard deviation of a coordinate of each point.
    """

    times: Annotated[FloatArray, Axes("T")]
    shapes: Annotated[FloatArray, Axes("T", "P", 3)]
    deviations: Annotated[FloatArray, Axes("T", "P")]


def fitted_phase(
    model: ShapeModel, scores: FloatArray, covariance: FloatArray, time: float
) -> ObservedPhase:
    """Return a phase known by the posterior of its scores (of a fit to part of a surface, say).

    Parameters
    ----------
    model : ShapeModel
        In whose modes the scores are.
    scores : (K,) float64, mm
    covariance : (K, K) float64, mm^2
    time : float
        Fraction of the cycle.
    """
    count = len(model.modes)
    given = frozen_floats(scores, (count,), "scores of a phase")
    values, vectors = eigh(frozen_floats(covariance, (count, count), "covariance of scores"))
    kept = values > KEPT_VARIANCE * max(float(values.max(initial=0.0)), 0.0)
    rows = (vectors[:, kept] * np.sqrt(values[kept])).T  # (Q, K)
    return ObservedPhase(time, model.reconstruct(given), np.tensordot(rows, model.modes, axes=1))


def predict_cycle(
    predictor: CyclePredictor, phases: Sequence[ObservedPhase], times: FloatArray
) -> PredictedCycle:
    """Predict the whole cycle of a heart from some of its phases, with its uncertainty.

    At the time of a phase that was seen whole the prediction is that phase.

    Parameters
    ----------
    predictor : CyclePredictor
        Best learnt for about the times of the phases.
    phases : sequence of ObservedPhase
        At least one, at different times.
    times : (T,) float64
        Fractions of the cycle.

    Raises
    ------
    InputError
        If no phase is given, two have the same time, or one has other points than the model.
    """
    model, given = predictor.model, distinct_times([phase.time for phase in phases])
    for phase in phases:
        frozen_floats(phase.points, model.total.mean.shape, "points of a given phase")
    roots = np.sqrt(model.total.weights)[:, None]  # (P, 1)
    points = np.stack([phase.points for phase in phases])  # (J, P, 3)
    pose = pose_to_mean_cycle(model, points, given)
    rotation, shift = pose[:3, :3], pose[:3, 3]
    placed = ((points @ rotation.T + shift) * roots).reshape(len(points), -1)  # (J, D)
    rows = np.zeros((sum(len(phase.rows) for phase in phases), *placed.shape))  # (Q, J, D)
    start = 0
    for index, phase in enumerate(phases):
        turned = (phase.rows @ rotation.T * roots).reshape(len(phase.rows), placed.shape[1])
        rows[start : start + len(turned), index] = turned
        start += len(turned)
    instants = np.asarray(times, dtype=np.float64)
    prior = CyclePrior(posed_cycles(model, given), predictor.energies, predictor.directions)
    found = cycle_posterior(prior, given, placed, rows, instants)
    shapes = found.mean.reshape(len(instants), -1, 3) / roots
    per_point = 3.0 * model.total.weights
    variance = found.rest_variance[:, None] * predictor.spread / 3.0  # (T, P)
    variance = variance + _squared(found.shares) / per_point
    variance = predictor.variance_factor * variance + _squared(found.seen) / per_point
    return PredictedCycle(instants, (shapes - shift) @ rotation, np.sqrt(variance))


def _squared(rows: FloatArray) -> FloatArray:
    """Return the sums of squares (T, P) of rows (T, Q, D) over Q and coordinates."""
    summed: FloatArray = (rows**2).sum(axis=1).reshape(len(rows), -1, 3).sum(axis=2)
    return summed
