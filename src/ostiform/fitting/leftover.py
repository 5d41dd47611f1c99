"""What a model leaves of a shape it has not seen: estimated by leaving training shapes out.

The modes of N training shapes reproduce those exactly, and nothing else. A fit that took the
modes for the whole truth would be overconfident; here the deviation of left-out shapes from the
span of the others is measured, and described as a smooth random field plus independent noise.
"""

from collections.abc import Sequence
from enum import Enum
from typing import Annotated

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.errors import InputError
from ostiform.evaluation import Fold, cross_validation_folds
from ostiform.model import ShapeModel, StoredModel
from ostiform.study import ShapeId
from ostiform.values import Axes, value

SAMPLED_POINTS = 500
"""Points at which correlations are measured; their pairs are a hundred thousand."""

LENGTH_SHARES = np.geomspace(0.02, 0.4, 25)
"""Correlation lengths tried, as shares of the mean shape's diameter."""

GROWTH_LIMIT = 4.0
"""A left-out variance this many times the training one says that the prior is useless anyway."""

UNKNOWN_SHARE = 0.1
"""Share of the variance taken as left over where training shapes are not known."""

UNKNOWN_LENGTH = 0.1
"""Correlation length in that case, as a share of the diameter."""

AMPLITUDE_PRIOR = 2.0
"""The mean over the surface counts at every point as much as this many groups of shapes."""

NOISE_SHARE = 0.02
"""Of a leftover whose correlations are not known, this share is independent noise."""


class LeftoverSource(Enum):
    """Where a leftover was taken from; the value is the sentence shown with the results."""

    LEFT_OUT = "measured on training shapes left out in turn"
    SPECTRUM = (
        "assumed from the model's spectrum, because its training shapes are not known or too few"
    )
    GIVEN = "given"


@value
class Leftover:
    """The variation of a new shape beyond the modes of a model.

    Attributes
    ----------
    smooth_variance : float, mm^2 per point
        Of the smooth field, summed over the three coordinates.
    amplitude : (P,) float64
        Standard deviation of the field at every point of the model, relative to its root mean
        square over the surface.
    length : float, mm
        Correlations of the field fall with the distance d of points of the mean shape as
        ``(1 + u) exp(-u)``, ``u = sqrt(3) d / length`` (`matern`).
    noise_variance : float, mm^2 per point
        Of what is independent from point to point.
    growth : float
        Factor, at least 1, of the variance of new shapes along the modes over the training one.
    groups : int
        Number of independent groups of training shapes (subjects) that it was measured on.
    energy_dof : float
        Degrees of freedom of the scatter of the leftover's energy from shape to shape: twice the
        squared mean over the variance.
    source : LeftoverSource
    """

    smooth_variance: float
    amplitude: Annotated[FloatArray, Axes(None)]
    length: float
    noise_variance: float
    growth: float
    groups: int
    energy_dof: float
    source: LeftoverSource = LeftoverSource.GIVEN

    def __post_init__(self) -> None:
        """Check what annotations cannot say."""
        numbers = (self.smooth_variance, self.noise_variance, self.length, self.growth)
        if not (
            np.isfinite(numbers).all()
            and min(self.smooth_variance, self.noise_variance) >= 0.0
            and self.length > 0.0
            and self.growth >= 1.0
            and (self.amplitude > 0.0).all()
        ):
            raise InputError(
                "leftover of a model: expected variances of at least 0, a positive length and a "
                f"growth of at least 1, found {self.smooth_variance:g} and "
                f"{self.noise_variance:g} mm^2, {self.length:g} mm, {self.growth:g}"
            )

    @property
    def variance(self) -> float:
        """Of field and noise together, mm^2 per point."""
        return self.smooth_variance + self.noise_variance


def estimated_leftover(stored: StoredModel) -> Leftover:
    """Return what a model leaves of new shapes, measured by leaving training shapes out.

    Whole subjects are left out in turn; of one subject, blocks of phases, which say nothing about
    other subjects. A left-out shape is projected on the modes of the others; what remains gives
    the field's variance and, from its correlations over the distance of points, its length. All is
    computed from the scores, in which the training shapes are exact. A model whose training
    shapes are unknown, too few or truncated away gets `leftover_of_spectrum`.
    """
    model, scores = stored.model, stored.scores
    if len(scores) < 3 or len(model.modes) < 2:
        return leftover_of_spectrum(model)
    folds = _folds(stored.ids)
    if len(folds) < 2:
        return leftover_of_spectrum(model)
    remains = np.zeros_like(scores)  # (N, K)
    inside, trained = 0.0, 0.0
    for fold in folds:
        training = scores[list(fold.train)]
        mean = training.mean(axis=0)
        _, singular, directions = np.linalg.svd(
            (training - mean) / np.sqrt(len(training) - 1.0), full_matrices=False
        )
        directions = directions[singular > 1e-9 * max(float(singular[0]), 1e-300)]
        deviation = scores[list(fold.test)] - mean
        within = deviation @ directions.T
        remains[list(fold.test)] = deviation - within @ directions
        inside += float((within**2).sum())
        trained += float((singular**2).sum()) * len(deviation)
    energies = (remains**2).sum(axis=1)  # (N,)
    total = float((remains**2).sum(axis=1).mean())
    if not (total > 0.0 and trained > 0.0):
        return leftover_of_spectrum(model)
    length, noise_share = _correlations(model, remains)
    scatter = float(energies.var(ddof=1)) / float(energies.mean()) ** 2
    return Leftover(
        smooth_variance=(1.0 - noise_share) * total,
        amplitude=_amplitude(model, remains, length, len(folds)),
        length=length,
        noise_variance=noise_share * total + model.residual_variance,
        growth=float(np.clip(inside / trained, 1.0, GROWTH_LIMIT)),
        groups=len(folds),
        energy_dof=2.0 / max(scatter, 1e-3),
        source=LeftoverSource.LEFT_OUT,
    )


def leftover_of_spectrum(model: ShapeModel) -> Leftover:
    """Return a cautious leftover for a model without training shapes.

    A tenth of the model's variance, correlated over a tenth of the diameter; a model that states
    a larger residual variance gets that.
    """
    total = max(UNKNOWN_SHARE * float(model.variances.sum()), model.residual_variance)
    size = float(np.linalg.norm(np.ptp(model.mean, axis=0)))
    total = max(total, (1e-4 * size) ** 2)
    groups = max(model.sample_count, 2)
    return Leftover(
        smooth_variance=(1.0 - NOISE_SHARE) * total,
        amplitude=np.ones(len(model.mean)),
        length=UNKNOWN_LENGTH * size,
        noise_variance=NOISE_SHARE * total,
        growth=1.0,
        groups=groups,
        energy_dof=4.0,
        source=LeftoverSource.SPECTRUM,
    )


def _folds(ids: Sequence[ShapeId]) -> tuple[Fold, ...]:
    """Return the folds by subject wherever the others have two shapes or more."""
    subjects = list(dict.fromkeys(id.subject for id in ids))
    if len(subjects) != 2:
        return cross_validation_folds(ids).folds
    by_subject = [[k for k, id in enumerate(ids) if id.subject == s] for s in subjects]
    if min(map(len, by_subject)) < 2:
        return cross_validation_folds(ids).folds
    return tuple(
        Fold(subjects[k], tuple(by_subject[1 - k]), tuple(by_subject[k])) for k in range(2)
    )


def matern(distances: FloatArray, length: float) -> FloatArray:
    """Return the correlations of a once-differentiable random field (Matern, order 3/2)."""
    scaled = np.sqrt(3.0) * distances / length
    correlations: FloatArray = (1.0 + scaled) * np.exp(-scaled)
    return correlations


def spread_points(points: FloatArray, count: int) -> IntArray:
    """Return the indices of at most `count` points that cover a shape, farthest first."""
    count = min(count, len(points))
    chosen = np.empty(count, dtype=np.int64)
    chosen[0] = int(np.argmin(((points - points.mean(axis=0)) ** 2).sum(axis=1)))
    nearest = ((points - points[chosen[0]]) ** 2).sum(axis=1)
    for k in range(1, count):
        chosen[k] = int(np.argmax(nearest))
        nearest = np.minimum(nearest, ((points - points[chosen[k]]) ** 2).sum(axis=1))
    return chosen


def _correlations(model: ShapeModel, remains: FloatArray) -> tuple[float, float]:
    """Return the length in mm and the share of independent noise of the remaining fields.

    The share and the length that fit the products of the fields at pairs of points best, by least
    squares over bins of their distance.
    """
    chosen = spread_points(model.mean, SAMPLED_POINTS)
    place = model.mean[chosen]
    rows = np.transpose(model.modes[:, chosen], (2, 1, 0))  # (3, Q, K)
    covariance = remains.T @ remains / len(remains)  # (K, K)
    products = np.einsum("apk,kl,aql->pq", rows, covariance, rows, optimize=True)
    size = float(np.linalg.norm(np.ptp(model.mean, axis=0)))
    distance = np.sqrt(((place[:, None] - place[None]) ** 2).sum(axis=2))
    upper = np.triu_indices(len(chosen), 1)
    bins = np.minimum((distance[upper] / (0.02 * size)).astype(np.int64), 24)
    count = np.bincount(bins, minlength=25)
    used = (count > 0) & (np.arange(25) < 24)
    middle = np.bincount(bins, distance[upper], minlength=25)[used] / count[used]
    level = np.bincount(bins, products[upper], minlength=25)[used] / count[used]
    variance = float(np.trace(products)) / len(chosen)
    best = (np.inf, float(LENGTH_SHARES[0]) * size, 1.0)
    for share in LENGTH_SHARES:
        shape = matern(middle, float(share) * size)
        smooth = float(np.clip((shape @ level) / (shape @ shape * variance), 0.2, 0.98))
        misfit = float(((level - smooth * variance * shape) ** 2).sum())
        if misfit < best[0]:
            best = (misfit, float(share) * size, 1.0 - smooth)
    return best[1], best[2]


def _amplitude(model: ShapeModel, remains: FloatArray, length: float, groups: int) -> FloatArray:
    """Return the relative standard deviation (P,) of the remaining fields.

    Their mean square at each point, smoothed over the field's length and drawn towards its mean
    over the surface: a few groups of shapes do not say more.
    """
    covariance = remains.T @ remains / len(remains)  # (K, K)
    flat = np.transpose(model.modes, (1, 2, 0))  # (P, 3, K)
    local = ((flat @ covariance) * flat).sum(axis=(1, 2))  # (P,)
    nodes = spread_points(model.mean, SAMPLED_POINTS)
    offset = model.mean[:, None] - model.mean[None, nodes]  # (P, Q, 3)
    kernel = matern(np.sqrt((offset**2).sum(axis=2)), length)
    smoothed = kernel @ local[nodes] / kernel.sum(axis=1)
    mean = float(model.weights @ smoothed)
    drawn = (groups * smoothed + AMPLITUDE_PRIOR * mean) / (groups + AMPLITUDE_PRIOR)
    amplitude: FloatArray = np.sqrt(drawn / float(model.weights @ drawn))
    return amplitude
