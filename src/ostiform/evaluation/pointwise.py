"""Where on the surface a model errs: residues of left-out shapes, point by point."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.errors import InputError
from ostiform.evaluation.folds import Division, cross_validation_folds
from ostiform.study import ShapeId
from ostiform.values import Axes, value

FEWEST_SHAPES = 4
"""As for the generalisation: with fewer, a model without one of them has too little left."""


@value
class PointResidues:
    """What a model built without a shape leaves of each of its points.

    Attributes
    ----------
    division : Division
        What was left out together.
    modes : int
        Largest number of modes used.
    residues : (N, P) float64, mm
        Distance of every point of every shape from its reconstruction.
    """

    division: Division
    modes: int
    residues: Annotated[FloatArray, Axes("N", "P")]

    @property
    def rms(self) -> FloatArray:
        """Root mean square over the shapes, (P,) mm."""
        mean: FloatArray = np.sqrt((self.residues**2).mean(axis=0))
        return mean


def left_out_point_residues(
    aligned: FloatArray, weights: FloatArray, ids: Sequence[ShapeId], modes: int
) -> PointResidues | None:
    """Return how far the reconstruction of every left-out shape is from it, at every point.

    The folds are those of the generalisation. Unlike there the correspondence of the left-out
    shapes is kept as it is; only the mean and the modes are those of the others. All mean shapes
    and modes follow from the one matrix of inner products of the shapes (the snapshot method of
    Sirovich, 1987).

    Parameters
    ----------
    aligned : (N, P, 3) float64, mm
        The shapes in correspondence.
    weights : (P,) float64
        Area shares, sum 1.
    ids : (N,) sequence of ShapeId
    modes : int
        Modes to reconstruct with, at least 1; a model with fewer takes all it has.

    Returns
    -------
    PointResidues or None
        None where there are too few shapes to leave some out.

    Raises
    ------
    InputError
        If the numbers of shapes or points differ, or no mode is asked for.
    """
    count = len(aligned)
    if count != len(ids) or aligned.shape[1] != len(weights) or modes < 1:
        raise InputError(
            f"residues of points: expected one identity per shape, one weight per point and at "
            f"least 1 mode, found {count} shapes, {len(ids)} identities, {aligned.shape[1]} "
            f"points, {len(weights)} weights and {modes} modes"
        )
    if count < FEWEST_SHAPES:
        return None
    folds = cross_validation_folds(ids)
    flat = aligned.reshape(count, -1)
    scaled = flat * np.repeat(np.sqrt(weights), 3)
    products = scaled @ scaled.T  # (N, N), mm^2
    residues = np.empty(aligned.shape[:2])
    for fold in folds.folds:
        train, test = np.array(fold.train), np.array(fold.test)
        coefficients = _reconstruction(products, train, test, modes)  # (n, N)
        left = flat[test] - coefficients @ flat
        residues[test] = np.linalg.norm(left.reshape(len(test), -1, 3), axis=2)
    return PointResidues(folds.division, modes, residues)


def _reconstruction(
    products: FloatArray, train: np.ndarray, test: np.ndarray, modes: int
) -> FloatArray:
    """Return the combinations (n, N) of the shapes that reconstruct the test shapes."""
    centring = np.eye(len(train)) - 1.0 / len(train)
    inner = centring @ products[np.ix_(train, train)] @ centring
    values, vectors = np.linalg.eigh(inner)  # ascending
    kept = values > values[-1] * len(train) * np.finfo(np.float64).eps
    values, vectors = values[kept][::-1][:modes], vectors[:, kept][:, ::-1][:, :modes]
    across = products[np.ix_(test, train)]  # (n, T)
    centred = (across - products[np.ix_(train, train)].mean(axis=0)) @ centring
    scores = centred @ vectors / values  # (n, K), over the mode's squared length
    coefficients = np.zeros((len(test), len(products)))
    coefficients[:, train] = scores @ vectors.T @ centring + 1.0 / len(train)
    return coefficients
