"""Newton minimisation of the barrier energy to convergence (design 3, step 3)."""

from dataclasses import dataclass

from ostiform.arrays import BoolArray, FloatArray
from ostiform.embedding.energy import EnergyWeights
from ostiform.embedding.newton import MapProblem, NewtonResult, minimised
from ostiform.embedding.untangle import untangled
from ostiform.surface.sphere import count_flipped

__all__ = ["Continued", "continued"]

# Regularised barriers and their relative tolerances: they only have to come near.
STAGES = ((1e-1, 1e-2), (1e-2, 1e-2), (1e-3, 1e-3))
MAX_STAGE_ITERATIONS = 25


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

    The exact barrier goes straight to the minimum from a good start: 9 to 20 steps, 25 to 45 for
    raw marching-cubes meshes, no more than with the continuation that design 3 lists. Only where
    it has not converged, the barrier is regularised less and less, which lets the triangles that
    cap its steps fold on the way; what is still folded then is untangled locally, and the exact
    barrier starts again from there. The better of the two minima is returned.

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
    direct = minimised(problem, directions, weights, 0.0, max_iterations, tolerance)
    if direct.has_converged:
        return _continued(direct, direct.iterations)
    start, rotations, steps = _regularised(problem, direct, weights)
    repaired = untangled(start, problem.faces, is_fixed, max_rounds=4)
    steps += direct.iterations + repaired.iterations
    if repaired.folded:
        return _continued(direct, steps)
    again = minimised(
        problem, repaired.directions, weights, 0.0, max_iterations, tolerance, rotations
    )
    better = again if again.energy < direct.energy else direct
    return _continued(better, steps + again.iterations)


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
