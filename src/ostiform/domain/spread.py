"""Moving circles on a sphere apart, as little as possible.

Minimises the squared movement of the centres under the gaps between circles, the seams that
contain them, and the order of the circles about the pole: a small smooth problem with
constraints, solved by sequential quadratic programming.
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.optimize import NonlinearConstraint, minimize

from ostiform.arrays import BoolArray, FloatArray, IntArray

# How far beyond the required gap the solver aims, so that the result passes exact checks.
MARGIN = 1e-6

# Neighbours in azimuth may come this close when circles are pushed, and no closer.
LEAST_TURN = float(np.radians(2.0))

MAX_ITERATIONS = 100

# Pairs with more room than this to spare are left out of the problem, radians.
REACH = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Caps:
    """Circles on the unit sphere and what is required of them.

    Attributes
    ----------
    centers : (n, 3) float64
    radii : (n,) float64, radians
    movable : (n,) bool
    apart : (m, 2) int64
        Pairs that must lie outside each other.
    within : (k, 2) int64
        Pairs of which the first must lie inside the second.
    apart_gaps : (m,) float64, radians
        The gap each pair must keep.
    within_gaps : (k,) float64, radians
    """

    centers: FloatArray
    radii: FloatArray
    movable: BoolArray
    apart: IntArray
    within: IntArray
    apart_gaps: FloatArray
    within_gaps: FloatArray


def violations(caps: Caps, centers: FloatArray) -> FloatArray:
    """Return by how much each pair, those apart then those within, misses its gap (m + k,).

    In radians; not above zero where the requirement is met.
    """
    _, signed = _clearances(caps, centers)
    missing: FloatArray = -signed
    return missing


def separated(caps: Caps, order: IntArray) -> FloatArray:
    """Return centres (n, 3) that meet the requirements, or come near, moved as little as possible.

    Does not check that they do: see `violations`.

    Parameters
    ----------
    caps : Caps
    order : (q, 2) int64
        Pairs of neighbours in azimuth about +z, the second ahead of the first, that keep that
        order (`azimuth_order`).
    """
    caps = _with_near_pairs(caps)
    free = np.flatnonzero(caps.movable)
    if len(free) == 0 or (violations(caps, caps.centers) <= 0).all():
        return caps.centers
    target = caps.centers[free]
    turns = _azimuth_steps(caps.centers, order)
    least_turns = np.minimum(turns, LEAST_TURN)

    def placed(flat: FloatArray) -> FloatArray:
        centers = caps.centers.copy()
        moved = flat.reshape(-1, 3)
        centers[free] = moved / np.linalg.norm(moved, axis=1)[:, None]
        return centers

    def clearances(flat: FloatArray) -> FloatArray:
        centers = placed(flat)
        steps = _azimuth_steps(centers, order)
        steps = turns + np.angle(np.exp(1j * (steps - turns)))
        return np.concatenate([_clearances(caps, centers)[1] - MARGIN, steps - least_turns])

    def gradient(flat: FloatArray) -> FloatArray:
        centers = placed(flat)
        per_center = np.concatenate(
            [_clearance_gradients(caps, centers), _azimuth_gradients(centers, order)]
        )[:, free]  # (m + k + q, f, 3)
        along = np.einsum("cfi,fi->cf", per_center, centers[free])
        tangent = per_center - along[:, :, None] * centers[free]
        lengths = np.linalg.norm(flat.reshape(-1, 3), axis=1)
        rows: FloatArray = (tangent / lengths[:, None]).reshape(len(tangent), -1)
        return rows

    def movement(flat: FloatArray) -> float:
        return 0.5 * float(np.sum((flat - target.ravel()) ** 2))

    def movement_gradient(flat: FloatArray) -> FloatArray:
        return flat - target.ravel()

    result = minimize(
        movement,
        _pushed(caps)[free].ravel(),
        jac=movement_gradient,
        method="SLSQP",
        constraints=[NonlinearConstraint(clearances, 0.0, np.inf, jac=gradient)],
        options={"maxiter": MAX_ITERATIONS, "ftol": 1e-14},
    )
    return placed(np.asarray(result.x))


def azimuth_order(centers: FloatArray, radii: FloatArray, members: IntArray) -> IntArray:
    """Return neighbours in azimuth about +z among some circles, (q, 2), the second ahead.

    Circles that contain a pole, or lie within 3 degrees of one, have no azimuth to keep.
    """
    height = np.arccos(np.clip(np.abs(centers[members, 2]), 0.0, 1.0))
    turning = members[height > radii[members] + np.radians(3.0)]
    if len(turning) < 3:
        return np.zeros((0, 2), dtype=np.int64)
    azimuth = np.arctan2(centers[turning, 1], centers[turning, 0])
    ring = turning[np.argsort(azimuth, kind="stable")]
    return np.array([*pairwise(ring), (ring[-1], ring[0])], dtype=np.int64)


def _with_near_pairs(caps: Caps) -> Caps:
    """Return the caps with the pairs that movement can change and that may come to touch."""
    near = violations(caps, caps.centers) > -REACH
    apart = caps.movable[caps.apart].any(axis=1) & near[: len(caps.apart)]
    within = caps.movable[caps.within].any(axis=1) & near[len(caps.apart) :]
    return replace(
        caps,
        apart=caps.apart[apart],
        apart_gaps=caps.apart_gaps[apart],
        within=caps.within[within],
        within_gaps=caps.within_gaps[within],
    )


def _clearances(caps: Caps, centers: FloatArray) -> tuple[FloatArray, FloatArray]:
    pairs = np.concatenate([caps.apart, caps.within])
    one, other = centers[pairs[:, 0]], centers[pairs[:, 1]]
    angles = 2.0 * np.arctan2(
        np.linalg.norm(one - other, axis=1), np.linalg.norm(one + other, axis=1)
    )  # (m + k,)
    count = len(caps.apart)
    radii = caps.radii[pairs]
    signed = np.concatenate(
        [
            angles[:count] - radii[:count].sum(axis=1) - caps.apart_gaps,
            radii[count:, 1] - radii[count:, 0] - caps.within_gaps - angles[count:],
        ]
    )
    return angles, signed


def _clearance_gradients(caps: Caps, centers: FloatArray) -> FloatArray:
    """Return derivatives (m + k, n, 3) of the clearances: d angle / d c_i = -c_j / sin(angle)."""
    pairs = np.concatenate([caps.apart, caps.within])
    angles, _ = _clearances(caps, centers)
    signs = np.concatenate([np.ones(len(caps.apart)), -np.ones(len(caps.within))])
    factors = -signs / np.maximum(np.sin(angles), 1e-9)
    gradients = np.zeros((len(pairs), len(centers), 3))
    rows = np.arange(len(pairs))
    gradients[rows, pairs[:, 0]] = factors[:, None] * centers[pairs[:, 1]]
    gradients[rows, pairs[:, 1]] = factors[:, None] * centers[pairs[:, 0]]
    return gradients


def _azimuth_steps(centers: FloatArray, order: IntArray) -> FloatArray:
    azimuth = np.arctan2(centers[:, 1], centers[:, 0])
    steps: FloatArray = np.mod(azimuth[order[:, 1]] - azimuth[order[:, 0]], 2.0 * np.pi)
    return steps


def _azimuth_gradients(centers: FloatArray, order: IntArray) -> FloatArray:
    squared = np.maximum(centers[:, 0] ** 2 + centers[:, 1] ** 2, 1e-12)
    turning = np.stack(
        [-centers[:, 1] / squared, centers[:, 0] / squared, np.zeros(len(centers))], axis=1
    )  # (n, 3)
    gradients = np.zeros((len(order), len(centers), 3))
    rows = np.arange(len(order))
    gradients[rows, order[:, 1]] = turning[order[:, 1]]
    gradients[rows, order[:, 0]] = -turning[order[:, 0]]
    return gradients


def _pushed(caps: Caps) -> FloatArray:
    """Return centres after a few rounds of moving violating pairs along their great circles."""
    centers = caps.centers.copy()
    pairs = np.concatenate([caps.apart, caps.within])
    away = np.concatenate([np.ones(len(caps.apart)), -np.ones(len(caps.within))])
    share = caps.movable[pairs] / np.maximum(caps.movable[pairs].sum(axis=1), 1)[:, None]
    for _ in range(20):
        missing = violations(caps, centers)
        if (missing <= 0).all():
            return centers
        steps = np.zeros_like(centers)
        for row in np.flatnonzero(missing > 0):
            one, other = pairs[row]
            apart = centers[one] - centers[other]
            if np.linalg.norm(apart) < 1e-3:
                # Coincident centres have no direction apart: take them along their parallel.
                apart = np.cross([0.0, 0.0, 1.0], centers[one]) + np.array([1e-3, 0.0, 0.0])
            direction = away[row] * missing[row] * apart / np.linalg.norm(apart)
            steps[one] += share[row, 0] * direction
            steps[other] -= share[row, 1] * direction
        centers = centers + 0.5 * steps
        centers = centers / np.linalg.norm(centers, axis=1)[:, None]
    return centers
