"""Whether data have the size of the model that is fitted to them."""

from collections.abc import Sequence

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.errors import InputError
from ostiform.fitting.landmarks import Labelled
from ostiform.fitting.types import LandmarkTarget, Target, all_positions
from ostiform.study import OTHER_UNITS, other_size

SMALLEST_PIECE = 1.0 / 100.0
"""Of the model's size: a smaller piece, of more than a few points, is in other units."""
FEW_POINTS = 10
"""So few points may lie together."""
AS_THICK = 0.5
"""Data at least this share as thick for their length as the model are no piece of its surface."""


def checked_size(model: FloatArray, targets: Sequence[Target]) -> float:
    """Return the size of data over that of a model, in percentiles that outliers do not move.

    A piece of a surface may be much smaller than the model; what is as thick as it is a body, and
    must have about its size.

    Parameters
    ----------
    model : (P, 3) float64, mm
    targets : sequence of Target

    Raises
    ------
    InputError
        If the data are of another size (wrong units).
    """
    positions = all_positions(targets)
    ratio = _extent(positions) / _extent(model)
    is_many = len(positions) > FEW_POINTS and not all(
        isinstance(target, LandmarkTarget) for target in targets
    )
    is_body = is_many and _thickness(positions) > AS_THICK * _thickness(model)
    smallest = 1.0 / OTHER_UNITS if is_body else SMALLEST_PIECE
    if ratio > OTHER_UNITS or (ratio < smallest and len(positions) > FEW_POINTS):
        _refuse(ratio, _extent(model))
    return ratio


def check_landmarks(prior_points: FloatArray, labelled: Labelled) -> None:
    """Refuse landmarks that are spread quite otherwise than the model's.

    Parameters
    ----------
    prior_points : (Q, 3) float64, mm
        Points that the labels mean.
    labelled : Labelled

    Raises
    ------
    InputError
    """
    if len(labelled.points) < 3:
        return
    own = float(np.linalg.norm(prior_points[labelled.points].std(axis=0)))
    there = float(np.linalg.norm(labelled.positions.std(axis=0)))
    if own > 0.0 and other_size(there, own) is not None:
        _refuse(there / own, own)


def _refuse(ratio: float, own: float) -> None:
    factor = 10.0 ** round(float(np.log10(max(ratio, 1e-12))))
    raise InputError(
        f"target: expected data in millimetres of about the model's size ({own:.3g} mm), found "
        f"{ratio * own:.3g} mm, about {factor:g} times that: state the units of the file (--units)"
    )


def _extent(points: FloatArray) -> float:
    low, high = np.percentile(points, [12.0, 88.0], axis=0)
    return float(np.linalg.norm(high - low))


def _thickness(points: FloatArray) -> float:
    """Return the least extent over the largest, in percentiles along the principal axes."""
    centred = points - np.median(points, axis=0)
    _, _, axes = np.linalg.svd(centred, full_matrices=False)
    low, high = np.percentile(centred @ axes.T, [12.0, 88.0], axis=0)
    spread = high - low
    return float(spread.min() / max(spread.max(), 1e-300))
