"""Projected Newton minimisation of the barrier energy on the sphere, one rotation per rim."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ostiform.arrays import BoolArray, FloatArray, IntArray, read_only
from ostiform.domain import Circle
from ostiform.embedding.energy import (
    EnergyWeights,
    energy_and_derivatives,
    energy_value,
    largest_step,
    tangent_bases,
)
from ostiform.embedding.reference import ReferenceTriangles
from ostiform.surface import Factorization, factorize

# Sufficient decrease of the Armijo rule, and share of the largest fold-free step to start from.
ARMIJO = 1e-4
STEP_SHARE = 0.9
MAX_HALVINGS = 40

# Share of the Newton step below which a step counts as short.
SHORT_STEP = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class MovingRim:
    """A rim that turns on its circle as one.

    Attributes
    ----------
    loop : (n,) int64
    circle : Circle
    angles : (n,) float64
        Where on the circle the rim's vertices are when its rotation is zero.
    """

    loop: IntArray
    circle: Circle
    angles: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class MapProblem:
    """What moves and what is minimised: the sparse structure shared by all Newton steps.

    Attributes
    ----------
    faces : (F, 3) int64
    reference : ReferenceTriangles
    rims : tuple of MovingRim
    free : (n,) int64
        Vertices with two degrees of freedom.
    dofs : (V, 2) int64
    slots : (F, 21) int64
    rows, starts : int32
        Pattern of the Hessian's upper triangle in compressed columns.
    """

    faces: IntArray
    reference: ReferenceTriangles
    rims: tuple[MovingRim, ...]
    free: IntArray
    dofs: IntArray
    slots: IntArray
    rows: IntArray
    starts: IntArray

    @property
    def n_dofs(self) -> int:
        """Number of degrees of freedom: two per free vertex, one per rim."""
        return 2 * len(self.free) + len(self.rims)


@dataclass(frozen=True, slots=True, eq=False)
class NewtonResult:
    """Where a minimisation stopped.

    Attributes
    ----------
    directions : (V, 3) float64
    rotations : (n_rims,) float64
        Rotation of each rim on its circle, radians.
    energy : float
    least_ratio : float
        Least signed area ratio of a triangle; the map is free of folds when it is positive.
    iterations : int
    has_converged : bool
        Whether the last step promised a relative decrease below the tolerance.
    """

    directions: FloatArray
    rotations: FloatArray
    energy: float
    least_ratio: float
    iterations: int
    has_converged: bool


def map_problem(
    faces: IntArray,
    reference: ReferenceTriangles,
    is_fixed: BoolArray,
    rims: Sequence[MovingRim] = (),
) -> MapProblem:
    """Return the structure of a minimisation.

    Parameters
    ----------
    faces : (F, 3) int64
    reference : ReferenceTriangles
    is_fixed : (V,) bool
        Vertices that do not move on their own; those of `rims` move with their rim.
    rims : sequence of MovingRim
    """
    free = np.flatnonzero(~is_fixed)
    dofs = np.full((len(is_fixed), 2), -1, dtype=np.int64)
    dofs[free] = np.arange(2 * len(free)).reshape(-1, 2)
    for number, rim in enumerate(rims):
        dofs[rim.loop, 0] = 2 * len(free) + number
        dofs[rim.loop, 1] = -1
    n_dofs = 2 * len(free) + len(rims)
    local = dofs[faces].reshape(-1, 6)  # (F, 6)
    first, second = np.triu_indices(6)
    one, two = local[:, first].ravel(), local[:, second].ravel()  # (21 F,)
    row, column = np.minimum(one, two), np.maximum(one, two)
    keys = np.where(row >= 0, column * n_dofs + row, -1)
    entries, slots = np.unique(keys, return_inverse=True)
    if entries[0] < 0:
        entries, slots = entries[1:], slots - 1
    starts = np.searchsorted(entries, np.arange(n_dofs + 1) * n_dofs)
    return MapProblem(
        faces=read_only(faces),
        reference=reference,
        rims=tuple(rims),
        free=free,
        dofs=dofs,
        slots=slots.reshape(-1, 21).astype(np.int64),
        rows=(entries % max(n_dofs, 1)).astype(np.int32),
        starts=starts.astype(np.int32),
    )


def minimised(
    problem: MapProblem,
    directions: FloatArray,
    weights: EnergyWeights,
    epsilon: float,
    max_iterations: int,
    tolerance: float,
    rotations: FloatArray | None = None,
    patience: int | None = None,
) -> NewtonResult:
    """Minimise the energy from a given map; at epsilon = 0 the map must be and stays fold-free.

    Parameters
    ----------
    problem : MapProblem
    directions : (V, 3) float64
        Unit vectors.
    weights : EnergyWeights
    epsilon : float
        Regularisation of the area ratio; 0 is the exact barrier.
    max_iterations : int
    tolerance : float
        Stops when the Newton step promises a relative decrease of the energy below this.
    rotations : (n_rims,) float64, optional
        Rotations of the rims in `directions`; zero by default.
    patience : int, optional
        Stops, not converged, after that many steps in a row shorter than `SHORT_STEP`: a few
        triangles hold all others back.

    Returns
    -------
    NewtonResult
    """
    current = directions.copy()
    turned = np.zeros(len(problem.rims)) if rotations is None else rotations.copy()
    reference = problem.reference
    terms = weights.as_array()

    def value(map_: FloatArray) -> tuple[float, float]:
        return energy_value(
            map_, problem.faces, reference.gradients, reference.areas, terms, epsilon
        )

    gradient = np.zeros(problem.n_dofs)
    hessian = np.zeros(len(problem.rows))
    bases = np.empty((len(directions), 2, 3))
    energy, least = value(current)
    factorization: Factorization | None = None
    converged = False
    iterations = short_steps = 0
    while iterations < max_iterations and problem.n_dofs and np.isfinite(energy):
        _fill_bases(problem, current, bases)
        energy_and_derivatives(
            current,
            problem.faces,
            reference.gradients,
            reference.areas,
            terms,
            epsilon,
            bases,
            problem.dofs,
            problem.slots,
            gradient,
            hessian,
        )
        factorization = _refactorized(problem, hessian, factorization)
        step = -factorization.solve(gradient)
        slope = float(gradient @ step)
        if not slope < 0.0:
            converged = slope == 0.0
            break
        length = 1.0
        if epsilon == 0.0:
            motion = _motion(problem, bases, step)
            length = min(1.0, STEP_SHARE * largest_step(current, motion, problem.faces))
        for _ in range(MAX_HALVINGS):
            trial, trial_turned = _moved(problem, current, bases, length * step, turned)
            trial_energy, trial_least = value(trial)
            if trial_energy <= energy + ARMIJO * length * slope:
                break
            length *= 0.5
        else:
            break
        current, turned, least = trial, trial_turned, trial_least
        promised, found = -0.5 * slope, energy - trial_energy
        energy = trial_energy
        iterations += 1
        # with a regularised barrier, folded slivers promise decreases that never come
        short_steps = short_steps + 1 if length < SHORT_STEP else 0
        if min(promised, found if epsilon > 0.0 else np.inf) < tolerance * abs(energy):
            converged = True
            break
        if patience is not None and short_steps >= patience:
            break
    return NewtonResult(current, turned, energy, least, iterations, converged)


def _refactorized(
    problem: MapProblem, hessian: FloatArray, factorization: Factorization | None
) -> Factorization:
    if factorization is None:
        upper = sparse.csc_array(
            (hessian, problem.rows, problem.starts), shape=(problem.n_dofs, problem.n_dofs)
        )
        return factorize(upper)
    factorization.update(hessian)
    return factorization


def _fill_bases(problem: MapProblem, directions: FloatArray, bases: FloatArray) -> None:
    """Tangent bases of the free vertices, motion per radian of the rims."""
    tangent_bases(directions, bases)
    for rim in problem.rims:
        bases[rim.loop, 0] = np.cross(rim.circle.center, directions[rim.loop])


def _motion(problem: MapProblem, bases: FloatArray, step: FloatArray) -> FloatArray:
    padded = np.append(step, 0.0)[problem.dofs]  # (V, 2); index -1 is the appended zero
    motion: FloatArray = padded[:, :1] * bases[:, 0] + padded[:, 1:] * bases[:, 1]
    return motion


def _moved(
    problem: MapProblem,
    directions: FloatArray,
    bases: FloatArray,
    step: FloatArray,
    rotations: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return the directions and rim rotations after a step."""
    moved = directions.copy()
    free = problem.free
    along = step[: 2 * len(free)].reshape(-1, 2)  # (n_free, 2)
    shifted = directions[free] + along[:, :1] * bases[free, 0] + along[:, 1:] * bases[free, 1]
    moved[free] = shifted / np.linalg.norm(shifted, axis=1, keepdims=True)
    turned = rotations + step[2 * len(free) :]
    for rim, angle in zip(problem.rims, turned, strict=True):
        moved[rim.loop] = rim.circle.points(rim.angles + angle)
    return moved, turned
