"""Newton minimisation with the barrier regularised less and less (design 3, step 3)."""

from dataclasses import dataclass

import numpy as np

from ostiform.arrays import BoolArray, FloatArray
from ostiform.embedding.energy import EnergyWeights
from ostiform.embedding.newton import MapProblem, minimised
from ostiform.embedding.untangle import untangled
from ostiform.surface.sphere import count_flipped

__all__ = ["Continued", "continued"]

# Each stage's epsilon with its own relative tolerance: early ones only have to come near.
STAGES = ((1e-1, 1e-2), (1e-2, 1e-2), (1e-3, 1e-3))
MAX_STAGE_ITERATIONS = 25


@dataclass(frozen=True, slots=True, eq=False)
class Continued:
    """Where the minimisation arrived.

    Attributes
    ----------
    directions : (V, 3) float64
    rotations : (n_rims,) float64
    energy : float
    iterations : int
    restarted : bool
        Whether the regularised stages had to be thrown away because they left folds.
    has_converged : bool
    """

    directions: FloatArray
    rotations: FloatArray
    energy: float
    iterations: int
    restarted: bool
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

    The regularised energies let a few slivers fold on the way, which would otherwise cap every
    step; what is still folded before the last stage is untangled locally, and if that fails the
    last stage starts from the given map.

    Parameters
    ----------
    problem : MapProblem
    directions : (V, 3) float64
        Free of folds.
    weights : EnergyWeights
    is_fixed : (V,) bool
        Vertices that a local untangling must not move (rims).
    tolerance, max_iterations
        Of the last stage.
    """
    current = directions
    rotations = np.zeros(len(problem.rims))
    iterations = 0
    for epsilon, loose in STAGES:
        result = minimised(
            problem,
            current,
            weights,
            epsilon,
            MAX_STAGE_ITERATIONS,
            max(loose, tolerance),
            rotations,
        )
        current, rotations = result.directions, result.rotations
        iterations += result.iterations
        if result.least_ratio > 0.0:
            break
    restarted = False
    if count_flipped(current, problem.faces):
        repaired = untangled(current, problem.faces, is_fixed, max_rounds=4)
        iterations += repaired.iterations
        current = repaired.directions
        if repaired.folded:
            current, rotations, restarted = directions, np.zeros(len(problem.rims)), True
    result = minimised(
        problem,
        current,
        weights,
        0.0,
        max_iterations * (3 if restarted else 1),
        tolerance,
        rotations,
    )
    return Continued(
        result.directions,
        result.rotations,
        result.energy,
        iterations + result.iterations,
        restarted,
        result.has_converged,
    )
