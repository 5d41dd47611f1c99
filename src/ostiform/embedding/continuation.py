"""Newton minimisation of the barrier energy to convergence (design 3, step 3)."""

from dataclasses import dataclass

from ostiform.arrays import BoolArray, FloatArray
from ostiform.embedding.energy import EnergyWeights
from ostiform.embedding.newton import MapProblem, NewtonResult, minimised
from ostiform.embedding.untangle import untangled
from ostiform.surface import count_flipped

# Regularised barriers and their relative tolerances: they only have to come near.
STAGES = ((1e-1, 1e-2), (1e-2, 1e-2), (1e-3, 1e-3))
MAX_STAGE_ITERATIONS = 25

# Short steps in a row after which the exact barrier asks for them.
PATIENCE = 3


@dataclass(frozen=True, slots=True, eq=False)
class Continued:
    """Where the minimisation arrived.

    Attributes
    ----------
    directions : (V, 3) float64
        Free of folds if the start was.
    rotations : (n_rims,) float64
        Rotation of each rim from the start.
    energy : float
    iterations : int
        Newton steps, all stages together.
    has_converged : bool
    """

    directions: FloatArray
    rotations: FloatArray
    energy: float
    iterations: int
    has_converged: bool


def continued(
    problem: MapProblem,
    directions: FloatArray,
    weights: EnergyWeights,
    is_fixed: BoolArray,
    tolerance: float,
    max_iterations: int,
) -> Continued:
    """Minimise the energy from a fold-free map and stay fold-free.

    One stage of a regularised barrier comes near in a few long steps and is kept if it leaves no
    folds (regular meshes). Else the exact barrier starts from the given map (raw marching-cubes
    meshes). Where a few triangles hold that back, the barrier is regularised less and less, which
    lets them fold on the way; what is still folded then is untangled locally, and the exact
    barrier starts again from there. The best of the maps is returned.

    Parameters
    ----------
    problem : MapProblem
    directions : (V, 3) float64
        Free of folds.
    weights : EnergyWeights
    is_fixed : (V,) bool
        Vertices that a local untangling must not move (rims).
    tolerance, max_iterations
        Of the exact barrier.
    """
    epsilon, loose = STAGES[0]
    near = minimised(problem, directions, weights, epsilon, MAX_STAGE_ITERATIONS, loose)
    first, turned = directions, None
    if near.least_ratio > 0.0 and not count_flipped(near.directions, problem.faces):
        first, turned = near.directions, near.rotations
    direct = minimised(
        problem, first, weights, 0.0, max_iterations, tolerance, turned, patience=PATIENCE
    )
    steps = near.iterations + direct.iterations
    if direct.has_converged:
        return _continued(direct, steps)
    start, rotations, more = _regularised(problem, direct, weights)
    repaired = untangled(start, problem.faces, is_fixed, max_rounds=4)
    steps += more + repaired.iterations
    if repaired.folded:
        start, rotations = direct.directions, direct.rotations
    else:
        start = repaired.directions
    last = minimised(problem, start, weights, 0.0, max_iterations, tolerance, rotations)
    better = last if last.energy < direct.energy else direct
    return _continued(better, steps + last.iterations)


def _regularised(
    problem: MapProblem, start: NewtonResult, weights: EnergyWeights
) -> tuple[FloatArray, FloatArray, int]:
    """Return directions, rim rotations and steps of the regularised stages."""
    current, rotations, steps = start.directions, start.rotations, 0
    for epsilon, tolerance in STAGES:
        result = minimised(
            problem, current, weights, epsilon, MAX_STAGE_ITERATIONS, tolerance, rotations
        )
        current, rotations = result.directions, result.rotations
        steps += result.iterations
        if not count_flipped(current, problem.faces):
            break
    return current, rotations, steps


def _continued(result: NewtonResult, iterations: int) -> Continued:
    return Continued(
        result.directions, result.rotations, result.energy, iterations, result.has_converged
    )
