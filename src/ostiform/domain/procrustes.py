"""Weighted Procrustes superposition in closed form: rotations, never reflections.

The rotation that best carries points x_p onto points y_p maximises ``trace(R C)`` with
``C = sum_p w_p x_p y_p^T``. With ``C = U S V^T`` it is ``R = V diag(1, 1, d) U^T``,
``d = det(V U^T)`` (Kabsch 1976, Umeyama 1991); the maximum is ``s_1 + s_2 + d s_3``, and would be
``s_1 + s_2 - d s_3`` if a reflection were allowed.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ostiform.arrays import FloatArray

# Change of the mean, relative to its size, below which a superposition has settled; rounding in
# the sums over points stays two orders below it.
SETTLED = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class Superposition:
    """Configurations superposed on their mean.

    Attributes
    ----------
    scales : (G,) float64
    rotations : (G, 3, 3) float64
    mean : (P, 3) float64
        Count-weighted mean of the scaled and rotated configurations.
    iterations : int
    converged : bool
        Whether the mean stopped moving before the iteration limit.
    """

    scales: FloatArray
    rotations: FloatArray
    mean: FloatArray
    iterations: int
    converged: bool


def best_rotations(correlations: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the proper rotations R that maximise ``trace(R C)`` for every C.

    Parameters
    ----------
    correlations : (n, 3, 3) float64
        ``C = sum_p w_p x_p y_p^T`` of centred points x and their targets y.

    Returns
    -------
    rotations : (n, 3, 3) float64
        Determinant +1.
    gains : (n, 3) float64
        Singular values, the last negative where a reflection would fit better: the maximum is
        their sum, the maximum over reflections the sum with the last one's sign changed.
    """
    u, gains, vt = np.linalg.svd(correlations)
    handedness = np.where(np.linalg.det(u) * np.linalg.det(vt) < 0, -1.0, 1.0)  # (n,)
    u = u.copy()
    u[:, :, 2] *= handedness[:, None]
    gains = gains.copy()
    gains[:, 2] *= handedness
    rotations: FloatArray = np.swapaxes(u @ vt, 1, 2)  # (n, 3, 3), V D U^T
    return rotations, gains


def superposed(
    configurations: FloatArray,
    weights: FloatArray,
    counts: FloatArray,
    sizes: FloatArray,
    start: int,
    scaling: bool,
    max_iterations: int,
) -> Superposition:
    """Superpose centred configurations on their mean by generalised Procrustes analysis.

    Alternates between the mean and the best rotation of every configuration onto it (Gower
    1975). With scaling, each scale is the regression on the mean, and all are multiplied by one
    factor that keeps the mean size: a power iteration for the scales of ten Berge (1977).

    Parameters
    ----------
    configurations : (G, P, 3) float64
        Weighted centroids at the origin. A configuration may itself be the mean of several
        shapes that move together.
    weights : (P,) float64
        Weight of each point, sum 1.
    counts : (G,) float64
        Shapes each configuration stands for.
    sizes : (G,) float64
        Root mean square distance of all its shapes' points from its centroid.
    start : int
        The configuration the first rotations are fitted to.
    scaling : bool
    max_iterations : int
    """
    shares = counts / counts.sum()  # (G,)
    scales = np.ones(len(configurations))
    mean = configurations[start]
    size = float(shares @ sizes)
    weighted = np.swapaxes(configurations * weights[:, None], 1, 2)  # (G, 3, P)
    rotations = np.broadcast_to(np.eye(3), (len(configurations), 3, 3))
    for iteration in range(1, max_iterations + 1):
        rotations, gains = best_rotations(weighted @ mean)
        if scaling:
            scales = np.maximum(gains.sum(axis=1), 0.0) / sizes**2  # (G,)
            scales = scales * (size / float(shares @ (scales * sizes)))
        placed = configurations @ np.swapaxes(rotations, 1, 2)  # (G, P, 3)
        updated = np.tensordot(shares * scales, placed, axes=1)  # (P, 3)
        moved = float(weighted_norms(updated - mean, weights))
        mean = updated
        if moved <= SETTLED * size:
            return Superposition(scales, rotations, mean, iteration, True)
    return Superposition(scales, rotations, mean, max_iterations, False)


def homogeneous(rotations: ArrayLike, translations: ArrayLike) -> FloatArray:
    """Return (n, 4, 4) matrices for column vectors from (n, 3, 3) linear parts and (n, 3)."""
    linear = np.asarray(rotations, dtype=np.float64)
    matrices = np.zeros((len(linear), 4, 4))
    matrices[:, :3, :3] = linear
    matrices[:, :3, 3] = translations
    matrices[:, 3, 3] = 1.0
    return matrices


def transformed(points: FloatArray, transforms: FloatArray) -> FloatArray:
    """Return points (n, P, 3) moved by transforms (n, 4, 4); one (4, 4) moves points (P, 3)."""
    linear, translation = transforms[..., :3, :3], transforms[..., :3, 3]
    moved: FloatArray = points @ np.swapaxes(linear, -1, -2) + translation[..., None, :]
    return moved


def weighted_norms(points: FloatArray, weights: FloatArray) -> FloatArray:
    """Return ``sqrt(sum_p w_p |x_p|^2)`` of points (..., P, 3)."""
    norms: FloatArray = np.sqrt(np.einsum("p,...pi,...pi->...", weights, points, points))
    return norms
