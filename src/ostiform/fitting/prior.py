"""The distribution of a new shape: a model's modes, the smooth field they leave, and noise."""

from collections.abc import Mapping
from typing import Annotated

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.fitting.leftover import Leftover, LeftoverSource, estimated_leftover, matern
from ostiform.model import ShapeModel, StoredModel
from ostiform.surface import median_edge_length, vertex_areas
from ostiform.values import Axes, value

MODES_SHARE = 0.9995
"""Modes beyond this share of the variance join the leftover."""

MOST_MODES = 120
FIELD_FUNCTIONS = 90
FIELD_REMAINDER = 0.05
"""Functions are added until this share of the field's variance is left, which becomes noise."""

MOST_GROWTH = 4.0
"""Largest factor of the field's variance that makes up for what lies within the modes' span."""


@value
class FitPrior:
    """A Gaussian distribution of new shapes, ``x = mean + modes b + field c + noise``.

    The coefficients b and c are independent standard normal numbers. The Q points are the P
    points of the model, then the centre of every opening (the mean of its rim's points).

    Attributes
    ----------
    model : ShapeModel
    leftover : Leftover
    mean : (Q, 3) float64, mm
    modes : (Q, 3, K) float64, mm
        Displacements per standard deviation of each mode.
    field : (Q, M) float64, mm
        Displacements, alike in each coordinate, per unit of the field's coefficients.
    noise_variance : float, mm^2
        Of each coordinate of a point.
    centres : mapping of str to int
        The point that is the centre of each opening, by full name.
    edge : float, mm
        Median edge of the mean.
    area : float, mm^2
        Of the mean.
    """

    model: ShapeModel
    leftover: Leftover
    mean: Annotated[FloatArray, Axes("M", 3)]
    modes: Annotated[FloatArray, Axes("M", 3, "K")]
    field: Annotated[FloatArray, Axes("M", None)]
    noise_variance: float
    centres: Mapping[str, int]
    edge: float
    area: float

    @property
    def size(self) -> float:
        """Bounding-box diagonal of the mean, mm."""
        return float(np.linalg.norm(np.ptp(self.mean, axis=0)))

    @property
    def deviation(self) -> float:
        """Standard deviation of a coordinate that the modes leave, mm."""
        return float(np.sqrt(self.leftover.variance / 3.0))


def fit_prior(stored: StoredModel, leftover: Leftover | None = None) -> FitPrior:
    """Return the distribution of new shapes that a model and its leftover state.

    The field is a Gaussian process with the leftover's covariance over the mean shape, in its
    partial pivoted Cholesky factorisation (Harbrecht, Peters & Schneider 2012); what the
    factorisation leaves counts as noise, and so do modes without a share in the variance. A
    leftover that was measured was measured beyond the modes: the field is scaled to have that
    energy there.

    Parameters
    ----------
    stored : StoredModel
    leftover : Leftover, optional
        Default: that of `estimated_leftover`.
    """
    model = stored.model
    beyond = estimated_leftover(stored) if leftover is None else leftover
    total = np.cumsum(model.variances)
    n_modes = 0
    if len(total) and total[-1] > 0.0:
        n_modes = int(np.searchsorted(total, MODES_SHARE * total[-1])) + 1
        n_modes = min(n_modes, MOST_MODES, len(total))
    rest = float(model.variances[n_modes:].sum())
    spread = np.sqrt(beyond.growth * model.variances[:n_modes])
    modes = np.transpose(model.modes[:n_modes] * spread[:, None, None], (1, 2, 0))  # (P, 3, K)
    variance = beyond.smooth_variance / 3.0
    field, lost = _field(model.mean, variance * beyond.amplitude**2, beyond.length)
    if beyond.source is LeftoverSource.LEFT_OUT:
        field = field * _growth_beyond(model, field, beyond.smooth_variance)
    rims = {name: np.asarray(rim) for name, rim in model.mesh.loops.items()}
    return FitPrior(
        model=model,
        leftover=beyond,
        mean=_with_centres(model.mean, rims),
        modes=_with_centres(modes, rims),
        field=_with_centres(field, rims),
        noise_variance=(beyond.noise_variance + rest) / 3.0 + lost,
        centres={name: len(model.mean) + k for k, name in enumerate(rims)},
        edge=median_edge_length(model.mean, model.mesh.faces),
        area=float(vertex_areas(model.mean, model.mesh.faces).sum()),
    )


def _growth_beyond(model: ShapeModel, field: FloatArray, measured: float) -> float:
    """Return the factor that gives a field (P, M) the energy beyond the modes that was measured.

    Left-out shapes are measured beyond the modes; of a field that knows nothing of the modes, part
    lies within their span, where it says nothing new, the more of it the more modes there are.
    """
    weighted = model.modes * model.weights[:, None]  # (K, P, 3)
    within = float(((np.swapaxes(weighted, 1, 2) @ field) ** 2).sum())
    own = 3.0 * float(model.weights @ (field**2).sum(axis=1)) - within
    if own <= 0.0:
        return 1.0
    return float(np.sqrt(np.clip(measured / own, 1.0, MOST_GROWTH)))


def _with_centres(values: FloatArray, rims: Mapping[str, IntArray]) -> FloatArray:
    rows = [values, *(values[rim].mean(axis=0)[None] for rim in rims.values())]
    joined: FloatArray = np.concatenate(rows)
    return joined


def _field(points: FloatArray, variance: FloatArray, length: float) -> tuple[FloatArray, float]:
    """Return L (P, M) with L L^T near the field's covariance, and the mean variance it misses."""
    total = float(variance.mean())
    if total <= 0.0:
        return np.zeros((len(points), 0)), 0.0
    limit = min(FIELD_FUNCTIONS, len(points))
    factor = np.zeros((len(points), limit))
    deviation = np.sqrt(variance)
    remaining = variance.copy()
    used = 0
    for k in range(limit):
        if float(remaining.mean()) <= FIELD_REMAINDER * total:
            break
        pivot = int(np.argmax(remaining))
        distance = np.linalg.norm(points - points[pivot], axis=1)
        column = deviation * deviation[pivot] * matern(distance, length)
        column -= factor[:, :k] @ factor[pivot, :k]
        factor[:, k] = column / np.sqrt(remaining[pivot])
        remaining = np.maximum(remaining - factor[:, k] ** 2, 0.0)
        used = k + 1
    return np.ascontiguousarray(factor[:, :used]), float(remaining.mean())
