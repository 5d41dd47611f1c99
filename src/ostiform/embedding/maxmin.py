"""Untangling by maximising the minimum area of every local sub-mesh (HY eq. 1).

Each free vertex in turn is moved to ::

    x = argmax_x min_i A_i(x),   A_i(x) the signed area of the i-th triangle round the vertex,

in the stereographic plane (HY 2.1; Freitag & Plassmann 2000). The areas are linear in x and the
minimum concave, so the local problem has one optimum; it lies where three areas are equal. Two
local solvers:

* ``conjugate-gradient``: HY's. The minimum is not differentiable, so the soft minimum
  ``-(1/b) log sum exp(-b A_i)`` is maximised by Polak-Ribiere conjugate gradients with b raised in
  stages; the step is kept only if the true minimum does not fall.
* ``linear-program``: the exact optimum, by trying every triple of equal areas.

The iteration over vertices has no guarantee. It untangles meshes of a few thousand vertices with
short veins, and is known to fail on long veins at 17,000 vertices (thousands of flips left after
8,000 sweeps): the result says so and the caller falls back to another start.
"""

from enum import Enum
from typing import Annotated, Literal

import numpy as np

from ostiform.arrays import BoolArray, FloatArray, IntArray
from ostiform.compiled import kernel
from ostiform.embedding.rings import vertex_rings
from ostiform.errors import InputError
from ostiform.values import Axes, value

LocalSolver = Literal["conjugate-gradient", "linear-program"]

# More sweeps are not expected to help when this many have not lowered the number of folded
# triangles and have brought the least area less than a tenth nearer to zero.
PATIENCE = 50
LEAST_PROGRESS = 0.1
# Sharpness b of the soft minimum times the mean area of the ring's triangles, stage by stage.
SHARPNESS = np.array([4.0, 16.0, 64.0])
CG_STEPS = 6
# A triangle counts as valid when its area exceeds this share of the mean: the orientation of the
# image on the sphere then survives the projection's round-off.
LEAST_AREA = 1e-12


class MaxMinStatus(Enum):
    """Why the untangling stopped."""

    UNTANGLED = "every triangle is positively oriented"
    STALLED = "neither the number of folded triangles nor the least area improves any more"
    EXHAUSTED = "the number of sweeps allowed is used up"


@value
class MaxMinResult:
    """Where the untangling arrived.

    Attributes
    ----------
    points : (n, 2) float64
        Of the sweep with the fewest folded triangles.
    folded : int
        Triangles that are not positively oriented there.
    sweeps : int
    status : MaxMinStatus
    """

    points: Annotated[FloatArray, Axes("V", 2)]
    folded: int
    sweeps: int
    status: MaxMinStatus


def untangled_by_area(
    points: FloatArray,
    faces: IntArray,
    is_fixed: BoolArray,
    max_sweeps: int = 500,
    solver: LocalSolver = "conjugate-gradient",
) -> MaxMinResult:
    """Untangle a planar mesh by maximising the minimum area round every free vertex (HY eq. 1).

    Parameters
    ----------
    points : (n, 2) float64
    faces : (m, 3) int64
        Counter-clockwise where not folded.
    is_fixed : (n,) bool
        Vertices that stay; every vertex of the boundary must be one.
    max_sweeps : int
    solver : str
        ``"conjugate-gradient"`` (HY's) or ``"linear-program"`` (exact).

    Raises
    ------
    InputError
        If the solver is unknown.
    """
    if solver not in ("conjugate-gradient", "linear-program"):
        raise InputError(
            f"untangling solver: expected conjugate-gradient or linear-program, found {solver!r}"
        )
    rings = vertex_rings(faces, len(points))
    free = np.flatnonzero(~is_fixed)
    current = np.array(points, dtype=np.float64)
    best, (fewest, least) = current.copy(), _folded(current, faces)
    sweeps = since = 0
    while fewest and sweeps < max_sweeps and since < PATIENCE:
        _swept(current, rings.offsets, rings.start, rings.end, free, solver == "linear-program")
        sweeps, since = sweeps + 1, since + 1
        folded, area = _folded(current, faces)
        if folded < fewest:
            best, fewest, since = current.copy(), folded, 0
        if area > (1.0 - LEAST_PROGRESS) * least:
            least, since = area, 0
    if not fewest:
        status = MaxMinStatus.UNTANGLED
    else:
        status = MaxMinStatus.STALLED if since >= PATIENCE else MaxMinStatus.EXHAUSTED
    return MaxMinResult(best, fewest, sweeps, status)


def _folded(points: FloatArray, faces: IntArray) -> tuple[int, float]:
    """The number of folded triangles, and the least area."""
    a, b, c = points[faces[:, 0]], points[faces[:, 1]], points[faces[:, 2]]
    first, second = b - a, c - a
    doubled = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    folded = doubled <= LEAST_AREA * np.abs(doubled).mean()
    return int(folded.sum()), 0.5 * float(doubled.min())


@kernel
def _swept(
    points: FloatArray,
    offsets: IntArray,
    start: IntArray,
    end: IntArray,
    free: IntArray,
    exact: bool,
) -> None:
    """Move every free vertex in turn, in place."""
    for v in free:
        first, last = offsets[v], offsets[v + 1]
        count = last - first
        # A_k(x) = constants[k] + slopes[k] . x, with x relative to the vertex's position.
        constants, slopes = np.empty(count), np.empty((count, 2))
        for k in range(count):
            p, q = points[start[first + k]], points[end[first + k]]
            slopes[k, 0] = 0.5 * (p[1] - q[1])
            slopes[k, 1] = 0.5 * (q[0] - p[0])
            px, py = p[0] - points[v, 0], p[1] - points[v, 1]
            qx, qy = q[0] - points[v, 0], q[1] - points[v, 1]
            constants[k] = 0.5 * (px * qy - py * qx)
        move = _equal_areas(constants, slopes) if exact else _ascended(constants, slopes)
        before, after = np.inf, np.inf
        for k in range(count):
            before = min(before, constants[k])
            after = min(after, constants[k] + slopes[k, 0] * move[0] + slopes[k, 1] * move[1])
        if after > before:
            points[v] += move


@kernel
def _equal_areas(constants: FloatArray, slopes: FloatArray) -> FloatArray:
    """Exact optimum: the best point at which three areas are equal and the others no smaller."""
    count = len(constants)
    scale = np.abs(constants).mean()
    best, optimum = -np.inf, np.zeros(2)
    for i in range(count):
        for j in range(i + 1, count):
            a, b = slopes[i, 0] - slopes[j, 0], slopes[i, 1] - slopes[j, 1]
            right = constants[j] - constants[i]
            for k in range(j + 1, count):
                c, d = slopes[i, 0] - slopes[k, 0], slopes[i, 1] - slopes[k, 1]
                other = constants[k] - constants[i]
                det = a * d - b * c
                if abs(det) <= 1e-14 * (abs(a * d) + abs(b * c)):
                    continue
                x, y = (right * d - b * other) / det, (a * other - right * c) / det
                least = constants[i] + slopes[i, 0] * x + slopes[i, 1] * y
                if least <= best:
                    continue
                feasible = True
                for m in range(count):
                    area = constants[m] + slopes[m, 0] * x + slopes[m, 1] * y
                    if area < least - 1e-9 * scale:
                        feasible = False
                        break
                if feasible:
                    best = least
                    optimum[0], optimum[1] = x, y
    return optimum


@kernel
def _ascended(constants: FloatArray, slopes: FloatArray) -> FloatArray:
    """Polak-Ribiere conjugate gradients on the soft minimum of the areas."""
    scale = np.abs(constants).mean()
    steepest = np.sqrt((slopes**2).sum() / len(slopes))
    move = np.zeros(2)
    if scale == 0.0 or steepest == 0.0:
        return move
    x, y = 0.0, 0.0
    for stage in range(len(SHARPNESS)):
        sharpness = SHARPNESS[stage] / scale
        length = scale / steepest
        value, g, h = _soft_minimum(constants, slopes, x, y, sharpness)
        u, v = g, h
        for _ in range(CG_STEPS):
            slope = g * u + h * v
            if slope <= 0.0:
                u, v = g, h
                slope = g * g + h * h
            size = np.sqrt(u * u + v * v)
            if size <= 1e-12 * steepest:
                break
            step, accepted = length / size, False
            trial, p, q = value, g, h
            for _ in range(20):
                trial, p, q = _soft_minimum(
                    constants, slopes, x + step * u, y + step * v, sharpness
                )
                if trial >= value + 1e-4 * step * slope:
                    accepted = True
                    break
                step *= 0.5
            if not accepted:
                break
            x, y = x + step * u, y + step * v
            length = 2.0 * step * size
            factor = (p * (p - g) + q * (q - h)) / (g * g + h * h)
            if factor < 0.0:
                factor = 0.0
            u, v = p + factor * u, q + factor * v
            value, g, h = trial, p, q
    move[0], move[1] = x, y
    return move


@kernel
def _soft_minimum(
    constants: FloatArray, slopes: FloatArray, x: float, y: float, sharpness: float
) -> tuple[float, float, float]:
    """Value and gradient of the soft minimum."""
    least = np.inf
    for k in range(len(constants)):
        least = min(least, constants[k] + slopes[k, 0] * x + slopes[k, 1] * y)
    total, g, h = 0.0, 0.0, 0.0
    for k in range(len(constants)):
        area = constants[k] + slopes[k, 0] * x + slopes[k, 1] * y
        weight = np.exp(-sharpness * (area - least))
        total += weight
        g += weight * slopes[k, 0]
        h += weight * slopes[k, 1]
    return least - np.log(total) / sharpness, g / total, h / total
