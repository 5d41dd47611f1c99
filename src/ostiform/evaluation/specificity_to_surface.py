"""Whether the surfaces that a model makes look like the surfaces it was built from.

Unlike distances between points, distances between surfaces do not take a consistent mistake of
the correspondence for shape.
"""

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from scipy.spatial import cKDTree

from ostiform.arrays import BoolArray, FloatArray, IntArray
from ostiform.errors import InputError
from ostiform.evaluation.distances import surface_distances
from ostiform.evaluation.generalisation import OriginalMesh
from ostiform.evaluation.specificity import SAMPLE_LIMIT
from ostiform.model import ShapeModel, reconstruct, sample_scores
from ostiform.values import Axes, value

N_SAMPLES = 50
CANDIDATES = 5
"""Training shapes, nearest by some points, to whose surfaces a random shape is compared."""

PRESELECTED = 100
"""Training shapes, nearest by the root mean square over the points, among which those are found."""

COMPARED_POINTS = 200
"""Points of a random shape whose distance to the nearest point of a training shape finds those."""


@value
class SurfaceSpecificity:
    """Distance of random shapes of a model from the nearest training surface, mm.

    Attributes
    ----------
    distances : (S,) float64, mm
        Of each random shape: the mean of the two area-weighted mean distances between its
        surface and an original surface, least over the training shapes.
    """

    distances: Annotated[FloatArray, Axes(None)]

    @property
    def mean(self) -> float:
        """Mean over the random shapes."""
        return float(self.distances.mean())

    @property
    def standard_error(self) -> float:
        """Of that mean, from the number of random shapes."""
        return float(self.distances.std(ddof=1) / np.sqrt(len(self.distances)))


def surface_specificity(
    model: ShapeModel,
    aligned: FloatArray,
    transforms: FloatArray,
    originals: Sequence[OriginalMesh],
    rng: np.random.Generator,
    n_samples: int = N_SAMPLES,
) -> SurfaceSpecificity:
    """Measure how near the surfaces of random shapes of a model lie to its training surfaces.

    Scores are ``b_k ~ N(0, l_k)`` of all modes, truncated at 3 standard deviations. The nearest
    training surface is searched among the five whose sampled points are nearest to 200 points
    of the random shape, of more than 100 shapes among the 100 whose points are.

    Parameters
    ----------
    model : ShapeModel
    aligned : (N, P, 3) float64, mm
        The training shapes.
    transforms : (N, 4, 4) float64
        From the originals' coordinates to the model's frame (column vectors).
    originals : sequence of OriginalMesh
        The surfaces of the training shapes; each is asked for once.
    rng : numpy.random.Generator
    n_samples : int
        At least 2.

    Raises
    ------
    InputError
        If the numbers of shapes, transforms and originals differ, or a sample is not enough.
    """
    count = len(aligned)
    if not count == len(transforms) == len(originals) or n_samples < 2:
        raise InputError(
            "specificity to the surface: expected as many transforms and originals as shapes and "
            f"at least 2 random shapes, found {count} shapes, {len(transforms)} transforms, "
            f"{len(originals)} originals and {n_samples} random shapes"
        )
    scores = sample_scores(model, n_samples, rng, limit=SAMPLE_LIMIT)  # (S, K)
    samples = reconstruct(model, scores)  # (S, P, 3)
    candidates = _candidates(aligned, samples, model.weights)  # (S, C)
    least = np.full(n_samples, np.inf)
    for index in np.unique(candidates):
        chosen = np.flatnonzero((candidates == index).any(axis=1))
        linear, translation = transforms[index, :3, :3], transforms[index, :3, 3]
        original = originals[index]
        found = surface_distances(
            samples[chosen],
            model.mesh.faces,
            original.vertices @ linear.T + translation,
            original.faces,
        )
        least[chosen] = np.minimum(least[chosen], [distance.mean for distance in found])
    return SurfaceSpecificity(least)


def _candidates(aligned: FloatArray, samples: FloatArray, weights: FloatArray) -> IntArray:
    """Return the training shapes (S, C) whose points are nearest to some points of the samples."""
    n_points = aligned.shape[1]
    some = np.unique(np.linspace(0, n_points - 1, min(n_points, COMPARED_POINTS)).astype(int))
    distances = np.full((len(samples), len(aligned)), np.inf)
    preselected = _preselected(aligned, samples, weights)  # (S, N)
    for index, shape in enumerate(aligned):
        own = np.flatnonzero(preselected[:, index])
        if len(own):
            gaps, _ = cKDTree(shape).query(samples[own][:, some].reshape(-1, 3))
            distances[own, index] = np.asarray(gaps).reshape(len(own), -1).mean(axis=1)
    nearest: IntArray = np.argsort(distances, axis=1, kind="stable")[:, :CANDIDATES]
    return nearest


def _preselected(aligned: FloatArray, samples: FloatArray, weights: FloatArray) -> BoolArray:
    """Return which training shapes (S, N) are among the nearest to each sample by their points."""
    if len(aligned) <= PRESELECTED:
        return np.ones((len(samples), len(aligned)), dtype=bool)
    squared = np.stack(
        [((samples - shape) ** 2).sum(axis=2) @ weights for shape in aligned], axis=1
    )
    last = np.partition(squared, PRESELECTED - 1, axis=1)[:, PRESELECTED - 1]
    chosen: BoolArray = squared <= last[:, None]
    return chosen
