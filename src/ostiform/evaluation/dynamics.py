"""How well the two levels of a dynamic model, who and when, fit subjects left out of it."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from ostiform.arrays import FloatArray, IntArray, frozen_floats
from ostiform.errors import InputError
from ostiform.evaluation.generalisation import MODE_COUNTS
from ostiform.model import DynamicModel, ShapeModel, fourier_design, phase_weights, project
from ostiform.study import ShapeId
from ostiform.values import Axes, value

LEVELS = ("between", "within", "common", "departure")
"""The levels of a dynamic model, by the names that `DynamicModel` gives them."""


@value
class LevelResidues:
    """Weighted RMS point distances, mm, by number of modes.

    Attributes
    ----------
    subjects : tuple of str
        The s left-out subjects.
    between : (s, M) float64
        What the modes between subjects leave of each subject's mean shape.
    within : (n, M) float64
        What the modes of motion leave of each shape's departure from its subject's mean.
    common : (n, M) float64
        What the modes of the common motion leave of the same.
    departure : (n, M) float64
        What the modes of the departures leave of what the common motion of the training subjects
        leaves of the same.
    """

    subjects: Annotated[tuple[str, ...], Axes("S")]
    between: Annotated[FloatArray, Axes("S", "M")]
    within: Annotated[FloatArray, Axes(None, "M")]
    common: Annotated[FloatArray, Axes(None, "M")]
    departure: Annotated[FloatArray, Axes(None, "M")]


def level_residues(
    model: DynamicModel,
    aligned: FloatArray,
    ids: Sequence[ShapeId],
    mode_counts: Sequence[int] = MODE_COUNTS,
) -> LevelResidues:
    """Return what the levels of a dynamic model leave of subjects it was not built from.

    Parameters
    ----------
    model : DynamicModel
    aligned : (n, P, 3) float64, mm
        Left-out shapes in the model's frame, all phases of each subject.
    ids : (n,) sequence of ShapeId
    mode_counts : sequence of int
        More modes than a level has take all that there are.

    Raises
    ------
    InputError
        If the arrays do not fit each other or the model.
    """
    shapes = frozen_floats(aligned, (len(ids), *model.total.mean.shape), "left-out shapes")
    if not len(ids):
        raise InputError("left-out shapes: expected at least one, found none")
    share = phase_weights(ids)
    labels = np.array([id.subject for id in ids])
    subjects = tuple(dict.fromkeys(id.subject for id in ids))
    means = np.stack(
        [
            np.average(shapes[labels == subject], axis=0, weights=share[labels == subject])
            for subject in subjects
        ]
    )  # (s, P, 3)
    owner = np.array([subjects.index(label) for label in labels])
    motion = shapes - means[owner]
    return LevelResidues(
        subjects,
        _left(model.between, means - model.total.mean, mode_counts),
        _left(model.within, motion, mode_counts),
        _left(model.common, motion, mode_counts),
        _left(model.departure, motion - _common(model, ids, share, owner), mode_counts),
    )


def _common(
    model: DynamicModel, ids: Sequence[ShapeId], share: FloatArray, owner: IntArray
) -> FloatArray:
    """Return the common motion (n, P, 3) at the phases of subjects, about each one's mean."""
    times = np.array([id.time for id in ids])
    curve = fourier_design(times, model.trajectories.harmonics) @ model.trajectories.common
    weight = np.bincount(owner, weights=share)
    means = np.zeros((len(weight), curve.shape[1]))
    np.add.at(means, owner, share[:, None] * curve)
    motion: FloatArray = np.tensordot(
        curve - (means / weight[:, None])[owner], model.total.modes, axes=1
    )
    return motion


def _left(model: ShapeModel, deviations: FloatArray, mode_counts: Sequence[int]) -> FloatArray:
    """Return the weighted RMS (n, M) of deviations (n, P, 3) beyond the first modes of a model."""
    scores = project(model, model.mean + deviations)  # (n, K)
    squared = np.einsum("npi,p->n", deviations**2, model.weights)  # (n,)
    explained = np.concatenate([np.zeros((len(scores), 1)), np.cumsum(scores**2, axis=1)], axis=1)
    used = np.minimum(np.asarray(mode_counts), scores.shape[1])
    left: FloatArray = np.sqrt(np.maximum(squared[:, None] - explained[:, used], 0.0))
    return left
