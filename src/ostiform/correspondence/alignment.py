"""Alignment of shapes in correspondence: weighted generalised Procrustes (design 5).

One transform is fitted to all shapes of a group (the phases of a subject) jointly, so that
motion is not aligned away. The rotation and translation of a group depend on its mean shape only:
``sum_i sum_p w_p |s R x_ip + t - m_p|^2`` over the shapes i of a group differs from the count
times ``sum_p w_p |s R mean_i(x_ip) + t - m_p|^2`` by a term that holds s but neither R nor t.
"""

from collections.abc import Sequence
from enum import Enum
from typing import Annotated, get_args

import numpy as np

from ostiform.arrays import BoolArray, FloatArray, IntArray, frozen_floats
from ostiform.domain import (
    best_rotations,
    homogeneous,
    superposed,
    transformed,
    weighted_norms,
)
from ostiform.errors import InputError
from ostiform.study import AlignmentMode
from ostiform.values import Axes, value

MODES: tuple[AlignmentMode, ...] = get_args(AlignmentMode)

# Relative difference of sizes and distances below which two groups count as equally good
# references: far above rounding, far below any difference between real shapes.
TIE = 1e-9

# A group is reported as mirrored when allowing a reflection would shrink its distance to the mean
# to less than this: shapes of one population fit worse, not better, when they are mirrored.
MIRRORED_BELOW = 0.6

# Extent relative to the distance from the origin that is rounding only.
COINCIDENT = 1e-13

MAX_ITERATIONS = 1000


class AlignmentStatus(Enum):
    """How an alignment ended."""

    CONVERGED = "the mean shape stopped moving"
    ITERATION_LIMIT = "the mean shape was still moving at the iteration limit"
    NOT_ALIGNED = "the shapes were left in their input coordinates"


@value
class Alignment:
    """Shapes aligned to their mean.

    Attributes
    ----------
    aligned : (N, P, 3) float64, mm
    transforms : (N, 4, 4) float64
        From input to aligned coordinates (column vectors), equal within a group.
    mean : (P, 3) float64, mm
        Mean of the aligned shapes.
    reference : int
        A shape of the group whose input coordinates the aligned frame is.
    mirrored : (N,) bool
        Whether the shape's group would fit the mean far better as its mirror image.
    iterations : int
    status : AlignmentStatus
    """

    aligned: Annotated[FloatArray, Axes("N", "P", 3)]
    transforms: Annotated[FloatArray, Axes("N", 4, 4)]
    mean: Annotated[FloatArray, Axes("P", 3)]
    reference: int
    mirrored: Annotated[BoolArray, Axes("N")]
    iterations: int
    status: AlignmentStatus


def align(
    points: FloatArray,
    weights: FloatArray,
    mode: AlignmentMode = "rigid",
    groups: IntArray | Sequence[int] | None = None,
    max_iterations: int = MAX_ITERATIONS,
) -> Alignment:
    """Align shapes to their mean by weighted generalised Procrustes analysis, without reflection.

    Every shape counts once in the mean. The frame of the result is the input frame of the
    *medoid*, the group whose mean shape is nearest to the mean: its rotation is the identity and
    its centroid stays where it is. Ties are broken by size, then by coordinates, so the result
    does not depend on the order of the shapes. With ``similarity`` the mean root mean square
    distance from the centroid over the shapes' groups is the same before and after.

    Parameters
    ----------
    points : (N, P, 3) float64, mm
        Shapes in correspondence.
    weights : (P,) float64
        Weight of each point, not negative; used relative to their sum.
    mode : {"rigid", "similarity", "none"}
    groups : (N,) int, optional
        Label of the group of each shape; one transform per group. Default: one group per shape.
    max_iterations : int

    Raises
    ------
    InputError
        If an array has the wrong shape or values, the mode is unknown, or all points of a group
        coincide.
    """
    points = _checked_points(points)
    shares = _checked_weights(weights, points.shape[1])
    _check_mode(mode)
    labels = np.arange(len(points)) if groups is None else np.asarray(groups)
    if labels.shape != (len(points),):
        raise InputError(
            f"groups: expected one label for each of {len(points)} shapes, found an array of "
            f"shape {labels.shape}"
        )
    if mode == "none":
        identity = np.broadcast_to(np.eye(4), (len(points), 4, 4))
        return Alignment(
            aligned=points,
            transforms=identity,
            mean=points.mean(axis=0),
            reference=0,
            mirrored=np.zeros(len(points), dtype=bool),
            iterations=0,
            status=AlignmentStatus.NOT_ALIGNED,
        )
    _, first, index, counts = np.unique(
        labels, return_index=True, return_inverse=True, return_counts=True
    )
    means = _group_means(points, index, counts)  # (G, P, 3)
    centroids = np.einsum("p,gpi->gi", shares, means)  # (G, 3)
    sizes = _group_sizes(points, shares, index, counts, centroids)
    if not (sizes > COINCIDENT * np.abs(points).max()).all():
        raise InputError(
            f"points: expected shapes of some extent, found all points of shape "
            f"{int(first[np.argmin(sizes)])} at one position"
        )
    centred = means - centroids[:, None, :]  # (G, P, 3)
    superposition = superposed(
        centred,
        shares,
        counts.astype(np.float64),
        sizes,
        start=_of_median_size(means, sizes),
        scaling=mode == "similarity",
        max_iterations=max_iterations,
    )
    scaled = superposition.scales[:, None, None] * superposition.rotations  # (G, 3, 3)
    placed = centred @ np.swapaxes(scaled, 1, 2)  # (G, P, 3)
    distances = weighted_norms(placed - superposition.mean, shares)  # (G,)
    medoid = _medoid(means, sizes, distances)
    to_medoid = superposition.rotations[medoid].T
    linear = to_medoid @ scaled  # (G, 3, 3)
    linear[medoid] = superposition.scales[medoid] * np.eye(3)
    translations = centroids[medoid] - np.einsum("gij,gj->gi", linear, centroids)
    if mode == "rigid":
        translations[medoid] = 0.0
    transforms = homogeneous(linear, translations)[index]  # (N, 4, 4)
    aligned = transformed(points, transforms)
    mirrored = _mirrored(centred, superposition.mean, shares, superposition.scales)
    return Alignment(
        aligned=aligned,
        transforms=transforms,
        mean=aligned.mean(axis=0),
        reference=int(first[medoid]),
        mirrored=mirrored[index],
        iterations=superposition.iterations,
        status=AlignmentStatus.CONVERGED
        if superposition.converged
        else AlignmentStatus.ITERATION_LIMIT,
    )


def align_to(
    points: FloatArray,
    target: FloatArray,
    weights: FloatArray,
    mode: AlignmentMode = "rigid",
) -> FloatArray:
    """Return the one transform that carries n shapes jointly onto their targets.

    Minimises ``sum_i sum_p w_p |s R x_ip + t - y_ip|^2`` over rotations R, translations t and,
    with ``similarity``, scales s (Umeyama 1991, equations 34 to 43, weighted).

    Parameters
    ----------
    points : (n, P, 3) float64, mm
    target : (P, 3) or (n, P, 3) float64, mm
    weights : (P,) float64
    mode : {"rigid", "similarity", "none"}

    Returns
    -------
    transform : (4, 4) float64
        For column vectors.

    Raises
    ------
    InputError
        If an array has the wrong shape or values, the mode is unknown, or all points coincide.
    """
    points = _checked_points(points)
    goal = np.asarray(target, dtype=np.float64)
    goal = frozen_floats(
        goal, points.shape if goal.ndim == 3 else points.shape[1:], "target of the alignment"
    )
    shares = _checked_weights(weights, points.shape[1])
    _check_mode(mode)
    if mode == "none":
        return np.eye(4)
    targets = np.broadcast_to(goal, points.shape)
    centroid = np.einsum("p,npi->i", shares, points) / len(points)
    target_centroid = np.einsum("p,npi->i", shares, targets) / len(points)
    centred = points - centroid
    correlation = np.einsum("p,npi,npj->ij", shares, centred, targets - target_centroid)
    squared_size = float(np.einsum("p,npi,npi->", shares, centred, centred))
    if squared_size <= (COINCIDENT * np.abs(points).max()) ** 2:
        raise InputError("points: expected shapes of some extent, found all at one position")
    rotations, gains = best_rotations(correlation[None])
    scale = max(float(gains.sum()), 0.0) / squared_size if mode == "similarity" else 1.0
    linear = scale * rotations  # (1, 3, 3)
    transform: FloatArray = homogeneous(linear, target_centroid - linear @ centroid)[0]
    return transform


def _checked_points(points: FloatArray) -> FloatArray:
    checked = frozen_floats(points, (None, None, 3), "points to align")
    if checked.shape[0] == 0 or checked.shape[1] == 0:
        raise InputError(
            f"points to align: expected at least one shape of at least one point, found "
            f"{checked.shape[0]} of {checked.shape[1]}"
        )
    return checked


def _checked_weights(weights: FloatArray, count: int) -> FloatArray:
    checked = frozen_floats(weights, (count,), "weights of the alignment")
    if (checked < 0).any() or not checked.sum() > 0:
        raise InputError(
            f"weights of the alignment: expected numbers not below zero with a positive sum, found "
            f"a minimum of {checked.min():g} and a sum of {checked.sum():g}"
        )
    shares: FloatArray = checked / checked.sum()
    return shares


def _check_mode(mode: str) -> None:
    if mode not in MODES:
        raise InputError(f'alignment mode: expected one of {", ".join(MODES)}, found "{mode}"')


def _group_means(points: FloatArray, index: IntArray, counts: IntArray) -> FloatArray:
    sums = np.zeros((len(counts), *points.shape[1:]))
    np.add.at(sums, index, points)
    means: FloatArray = sums / counts[:, None, None]
    return means


def _group_sizes(
    points: FloatArray,
    weights: FloatArray,
    index: IntArray,
    counts: IntArray,
    centroids: FloatArray,
) -> FloatArray:
    """Return the root mean square distance (G,) of a group's points from its centroid."""
    squared = weighted_norms(points - centroids[index][:, None, :], weights) ** 2  # (N,)
    sizes: FloatArray = np.sqrt(np.bincount(index, squared, len(counts)) / counts)
    return sizes


def _of_median_size(means: FloatArray, sizes: FloatArray) -> int:
    """Return the group of median size; of several of the same size, the first by coordinates."""
    median = np.partition(sizes, (len(sizes) - 1) // 2)[(len(sizes) - 1) // 2]
    return _first_by_coordinates(means, np.flatnonzero(np.abs(sizes - median) <= TIE * median))


def _medoid(means: FloatArray, sizes: FloatArray, distances: FloatArray) -> int:
    """Return the group nearest to the mean; of several, the largest, then by coordinates."""
    nearest = np.flatnonzero(distances <= distances.min() + TIE * sizes.mean())
    largest = nearest[sizes[nearest] >= sizes[nearest].max() * (1.0 - TIE)]
    return _first_by_coordinates(means, largest)


def _first_by_coordinates(means: FloatArray, candidates: IntArray) -> int:
    return int(min(candidates, key=lambda group: tuple(means[group].ravel())))


def _mirrored(
    centred: FloatArray, mean: FloatArray, weights: FloatArray, scales: FloatArray
) -> BoolArray:
    _, gains = best_rotations(np.swapaxes(centred * weights[:, None], 1, 2) @ mean)
    squares = (scales * weighted_norms(centred, weights)) ** 2 + weighted_norms(mean, weights) ** 2
    proper = np.maximum(squares - 2.0 * scales * gains.sum(axis=1), 0.0)
    improper = np.maximum(squares - 2.0 * scales * (gains @ np.array([1.0, 1.0, -1.0])), 0.0)
    flat = gains[:, 2] >= 0.0  # no reflection fits better than the best rotation
    mirrored: BoolArray = ~flat & (improper < MIRRORED_BELOW**2 * proper)
    return mirrored
