"""Whether the shapes that a model makes look like the shapes it was built from (design 6)."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.evaluation.generalisation import MODE_COUNTS
from ostiform.model import ShapeModel, project, sample_scores
from ostiform.values import Axes, value

N_SAMPLES = 1000
SAMPLE_LIMIT = 3.0
"""Standard deviations at which random scores are truncated."""


@value
class Specificity:
    """Mean distance of random shapes of a model from the nearest training shape, mm.

    Attributes
    ----------
    mode_counts : (M,) int64
        Numbers of modes drawn from; the last is the whole model.
    mean : (M,) float64
        Mean over the samples of the least weighted RMS point distance to a training shape.
    standard_error : (M,) float64
        Of that mean, from the number of samples.
    n_samples : int
    """

    mode_counts: Annotated[IntArray, Axes("M")]
    mean: Annotated[FloatArray, Axes("M")]
    standard_error: Annotated[FloatArray, Axes("M")]
    n_samples: int


def model_specificity(
    model: ShapeModel,
    aligned: FloatArray,
    rng: np.random.Generator,
    n_samples: int = N_SAMPLES,
    mode_counts: Sequence[int] = MODE_COUNTS,
) -> Specificity:
    """Measure how near random shapes of a model lie to its training shapes.

    Scores are ``b_k ~ N(0, l_k)`` truncated at 3 standard deviations, the same draws for every
    number of modes. Distances need no points: as the modes are orthonormal under the weights,
    the squared distance is that of the scores plus what the modes leave of the training shape.

    Parameters
    ----------
    model : ShapeModel
    aligned : (N, P, 3) float64, mm
        The training shapes.
    rng : numpy.random.Generator
    n_samples : int
    mode_counts : sequence of int
        Cut to the model's modes, all of which are added at the end.
    """
    drawn = sample_scores(model, n_samples, rng, limit=SAMPLE_LIMIT)  # (S, K)
    training = project(model, aligned)  # (N, K)
    # Of the mean shape: what a sample's scores change in it is |b|^2 - 2 b . c.
    from_mean = np.array(
        [((shape - model.mean) ** 2).sum(axis=1) @ model.weights for shape in aligned]
    )  # (N,)
    n_modes = len(model.modes)
    counts = np.unique([min(count, n_modes) for count in (*mode_counts, n_modes)])
    means, errors = [], []
    for count in counts:
        samples = drawn[:, :count]
        squared = from_mean - 2.0 * (samples @ training[:, :count].T)  # (S, N)
        least = squared.min(axis=1) + (samples**2).sum(axis=1)  # (S,)
        nearest = np.sqrt(np.maximum(least, 0.0))
        means.append(nearest.mean())
        errors.append(nearest.std(ddof=1) / np.sqrt(n_samples))
    return Specificity(counts, np.array(means), np.array(errors), n_samples)
