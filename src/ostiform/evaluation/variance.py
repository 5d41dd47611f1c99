"""Variance across and along the surface, and how much of it the surfaces themselves demand.

Motion of points along a surface changes no shape: of a population's variance only the part along
the normals is seen in the surfaces, the tangential part is a choice of the correspondence.
"""

from dataclasses import dataclass

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.correspondence import area_shares
from ostiform.errors import InputError
from ostiform.surface import closest_points, surface_tree, vertex_normals

MOST_PAIRS = 100
"""Ordered pairs of shapes whose distance is measured; of more, so many are drawn."""


@dataclass(frozen=True, slots=True)
class DividedVariance:
    """Area-weighted variance of a population's shapes, mm^2 per point.

    Attributes
    ----------
    normal, tangential : float
        Along the normals of the mean shape, and in its tangent planes.
    """

    normal: float
    tangential: float

    @property
    def total(self) -> float:
        """Both together: the trace of the weighted covariance."""
        return self.normal + self.tangential


@dataclass(frozen=True, slots=True)
class PopulationSpread:
    """How a correspondence spreads its points: what tells a collapse from a good model.

    Attributes
    ----------
    variance : DividedVariance
    surface_variance : float, mm^2
        The least that the sampled surfaces allow; see `surface_variance`.
    weight_drift : float
        Share of the weight that lies at other points than it should; see `weight_drift`.
    """

    variance: DividedVariance
    surface_variance: float
    weight_drift: float


def population_spread(
    aligned: FloatArray, initial: FloatArray, weights: FloatArray, faces: IntArray
) -> PopulationSpread:
    """Return how aligned shapes spread their points.

    Parameters
    ----------
    aligned : (N, P, 3) float64, mm
    initial : (N, P, 3) float64, mm
        The same surfaces in the same pose, sampled evenly: without any warp.
    weights : (P,) float64
        Area shares of the initial points, sum 1.
    faces : (F, 3) int64

    Raises
    ------
    InputError
        If there are fewer than two shapes.
    """
    return PopulationSpread(
        divided_variance(aligned, weights, faces),
        surface_variance(initial, weights, faces),
        weight_drift(aligned, weights, faces),
    )


def divided_variance(aligned: FloatArray, weights: FloatArray, faces: IntArray) -> DividedVariance:
    """Divide the variance of aligned shapes by direction.

    Parameters
    ----------
    aligned : (N, P, 3) float64, mm
    weights : (P,) float64
        Sum 1.
    faces : (F, 3) int64

    Raises
    ------
    InputError
        If there are fewer than two shapes.
    """
    _check_count(aligned)
    mean = aligned.mean(axis=0)
    deviations = aligned - mean
    along = np.einsum("npk,pk->np", deviations, vertex_normals(mean, faces))
    count = len(aligned) - 1
    normal = float((along**2).sum(axis=0) @ weights) / count
    total = float((deviations**2).sum(axis=(0, 2)) @ weights) / count
    return DividedVariance(normal, total - normal)


def surface_variance(
    aligned: FloatArray, weights: FloatArray, faces: IntArray, seed: int = 0
) -> float:
    """Return the least variance that aligned surfaces allow, mm^2 per point.

    Half the mean over ordered pairs of shapes i != j of ``sum_p w_p d(x_ip, S_j)^2``, d the
    distance to the sampled surface S_j. The variance of any correspondence is half the mean of
    ``sum_p w_p |x_ip - x_jp|^2``, and no point of S_j is nearer than the closest one: points that
    cover the surfaces as these do cannot vary less in this pose. Of many pairs some are drawn.

    Parameters
    ----------
    aligned : (N, P, 3) float64, mm
    weights : (P,) float64
        Sum 1.
    faces : (F, 3) int64
    seed : int
        Of the draw.

    Raises
    ------
    InputError
        If there are fewer than two shapes.
    """
    _check_count(aligned)
    count = len(aligned)
    pairs = np.arange(count * (count - 1))
    if len(pairs) > MOST_PAIRS:
        pairs = np.sort(np.random.default_rng(seed).choice(pairs, MOST_PAIRS, replace=False))
    targets, sources = np.divmod(pairs, count - 1)
    sources = sources + (sources >= targets)
    total = 0.0
    for target in np.unique(targets):
        tree = surface_tree(aligned[target], faces)
        for source in sources[targets == target]:
            total += float(weights @ closest_points(tree, aligned[source]).distances ** 2)
    return 0.5 * total / len(pairs)


def weight_drift(points: FloatArray, weights: FloatArray, faces: IntArray) -> float:
    """Return the share of the weights that the points' areas have moved away from them.

    Half the sum over the points of the absolute difference between a point's weight and its mean
    area share on the shapes: 0 where the weights are the area shares, 1 where points that hold
    all the weight hold no surface.

    Parameters
    ----------
    points : (N, P, 3) float64, mm
    weights : (P,) float64
        Sum 1.
    faces : (F, 3) int64
    """
    shares = area_shares(points, faces).mean(axis=0)
    return 0.5 * float(np.abs(shares - weights).sum())


def _check_count(aligned: FloatArray) -> None:
    if len(aligned) < 2:
        raise InputError(f"variance of shapes: expected at least 2 shapes, found {len(aligned)}")
