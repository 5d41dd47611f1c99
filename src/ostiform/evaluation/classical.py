"""The classical measures of a shape model, as published tables have them.

Point to point, every point counting alike, every shape left out alone, its correspondence and
its pose those of the whole population. They reward points that pile up and take a consistent
mistake of the correspondence for shape: for a judgement see `generalisation` and `specificity`.

Davies, "Learning shape: optimal models for analysing natural variability", PhD thesis,
University of Manchester 2002; Styner et al., "Evaluation of 3D correspondence methods for model
building", IPMI 2003. Where authors differ (sum or mean over the points, squared or not), here
the distance of two shapes is the mean over the points of the distance in mm.
"""

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from scipy.spatial.distance import cdist

from ostiform.arrays import FloatArray, IntArray
from ostiform.compiled import kernel
from ostiform.errors import InputError
from ostiform.values import Axes, value

FEWEST_SHAPES = 3
MODE_COUNTS = (1, 2, 3, 5, 10)
N_SAMPLES = 1000

MOST_SHAPES = 500
"""Shapes that the measures are of; of more, so many at equal intervals stand for all."""

MOST_LEFT_OUT = 100
"""Shapes left out in turn; of more, so many are taken at equal intervals."""

BLOCK = 64
"""Random shapes that are held at a time."""

CANDIDATES = 8
"""Training shapes, nearest by the root mean square, among which the nearest one is searched."""


@value
class ClassicalMeasures:
    """Compactness, generalisation ability and specificity with M modes.

    Attributes
    ----------
    mode_counts : (K,) int64
        The values of M; the last is the most that a model without one shape has.
    compactness : (K,) float64, mm^2 per point
        ``C(M)``: sum of the first M variances.
    generalisation, generalisation_error : (K,) float64, mm
        ``G(M)``: mean over the shapes of the distance of a shape from its reconstruction with M
        modes of the others, and its standard error.
    specificity, specificity_error : (K,) float64, mm
        ``S(M)``: mean over random shapes with M modes, ``b_m ~ N(0, l_m)``, of the distance to
        the nearest training shape, and its standard error.
    n_samples : int
    """

    mode_counts: Annotated[IntArray, Axes("M")]
    compactness: Annotated[FloatArray, Axes("M")]
    generalisation: Annotated[FloatArray, Axes("M")]
    generalisation_error: Annotated[FloatArray, Axes("M")]
    specificity: Annotated[FloatArray, Axes("M")]
    specificity_error: Annotated[FloatArray, Axes("M")]
    n_samples: int


def classical_measures(
    aligned: FloatArray,
    rng: np.random.Generator,
    n_samples: int = N_SAMPLES,
    mode_counts: Sequence[int] = MODE_COUNTS,
) -> ClassicalMeasures:
    """Return the classical measures of aligned shapes in correspondence.

    Parameters
    ----------
    aligned : (N, P, 3) float64, mm
    rng : numpy.random.Generator
    n_samples : int
    mode_counts : sequence of int
        Cut to N - 2 modes, which are added at the end.

    Raises
    ------
    InputError
        If there are fewer than three shapes.
    """
    if len(aligned) > MOST_SHAPES:
        aligned = aligned[np.linspace(0, len(aligned) - 1, MOST_SHAPES).round().astype(int)]
    count, n_points = aligned.shape[:2]
    if count < FEWEST_SHAPES:
        raise InputError(
            f"classical measures: expected at least {FEWEST_SHAPES} shapes, so that two are left "
            f"where one is left out, found {count}"
        )
    levels = np.unique([min(max(level, 1), count - 2) for level in (*mode_counts, count - 2)])
    flat = aligned.reshape(count, -1)
    products = flat @ flat.T  # (N, N), mm^2
    chosen = np.unique(np.linspace(0, count - 1, min(count, MOST_LEFT_OUT)).round().astype(int))
    left = np.stack([_left_out(flat, products, int(index), levels) for index in chosen])
    mean = flat.mean(axis=0)
    values, vectors = _eigen(products - products.mean(axis=0))
    modes = (vectors.T @ (flat - mean)) / np.sqrt(values)[:, None]  # (K, 3P), orthonormal
    training = np.sqrt(values) * vectors  # (N, K) scores
    values = values / (count - 1.0)  # summed squares over all points, mm^2
    drawn = rng.standard_normal((n_samples, len(values))) * np.sqrt(values)
    near = np.stack(
        [_nearest(mean, modes, drawn * (np.arange(len(values)) < n), training, flat)
         for n in levels],
        axis=1,
    )  # fmt: skip
    cumulative = np.cumsum(values)
    return ClassicalMeasures(
        levels,
        cumulative[np.minimum(levels, len(values)) - 1] / n_points,
        left.mean(axis=0),
        left.std(axis=0, ddof=1) / np.sqrt(len(left)),
        near.mean(axis=0),
        near.std(axis=0, ddof=1) / np.sqrt(n_samples),
        n_samples,
    )


def _eigen(products: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the summed squares along the modes, largest first, and the vectors (N, K) of shapes.

    Of products of deviations, of which one side may still have to be centred.
    """
    centred = products - products.mean(axis=1)[:, None]
    values, vectors = np.linalg.eigh(0.5 * (centred + centred.T))  # ascending
    kept = values > values[-1] * len(values) * np.finfo(np.float64).eps
    return values[kept][::-1], vectors[:, kept][:, ::-1]


def _left_out(flat: FloatArray, products: FloatArray, index: int, levels: IntArray) -> FloatArray:
    """Return the distance (L,) of a shape from its reconstruction with the others' modes.

    The reconstruction is a combination of the other shapes: no mode is formed (Sirovich 1987).
    """
    others = np.delete(np.arange(len(flat)), index)
    inner = products[np.ix_(others, others)]
    values, vectors = _eigen(inner - inner.mean(axis=0))
    across = products[index, others] - inner.mean(axis=0)
    scores = (across - across.mean()) @ vectors / values  # over the mode's summed squares
    distances = np.empty(len(levels))
    for column, level in enumerate(levels):
        weights = vectors[:, :level] @ scores[:level]
        found = (weights - weights.mean() + 1.0 / len(others)) @ flat[others]
        distances[column] = np.linalg.norm((flat[index] - found).reshape(-1, 3), axis=1).mean()
    return distances


def _nearest(
    mean: FloatArray,
    modes: FloatArray,
    scores: FloatArray,
    training: FloatArray,
    flat: FloatArray,
) -> FloatArray:
    """Return the distance (S,) of random shapes with given scores to the nearest training shape."""
    squared = cdist(scores, training, "sqeuclidean")
    candidates = np.argsort(squared, axis=1, kind="stable")[:, :CANDIDATES]
    used = int(np.max(np.flatnonzero(scores.any(axis=0)), initial=-1)) + 1
    least = [
        _least_distances(mean + scores[rows, :used] @ modes[:used], flat, candidates[rows])
        for rows in np.array_split(np.arange(len(scores)), -(-len(scores) // BLOCK))
    ]
    return np.concatenate(least)


@kernel
def _least_distances(shapes: FloatArray, flat: FloatArray, candidates: IntArray) -> FloatArray:
    """Return the mean distance (S,) over the points from the nearest of each shape's candidates."""
    count = shapes.shape[1] // 3
    least = np.full(len(shapes), np.inf)
    for row in range(len(shapes)):
        for candidate in candidates[row]:
            total, most = 0.0, least[row] * count
            for k in range(0, 3 * count, 3):
                x = shapes[row, k] - flat[candidate, k]
                y = shapes[row, k + 1] - flat[candidate, k + 1]
                z = shapes[row, k + 2] - flat[candidate, k + 2]
                total += np.sqrt(x * x + y * y + z * z)
                if total > most:
                    break
            least[row] = min(least[row], total / count)
    return least
