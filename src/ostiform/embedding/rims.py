"""Turn rims to arc length little by little, for starts that fold when it is done at once."""

from collections.abc import Sequence

import numpy as np

from ostiform.arrays import BoolArray, FloatArray, IntArray
from ostiform.domain import Circle
from ostiform.embedding.energy import EnergyWeights
from ostiform.embedding.newton import map_problem, minimised
from ostiform.embedding.reference import surface_reference
from ostiform.embedding.untangle import Untangled, untangled
from ostiform.surface import spherical_areas

# First step and least step, as shares of the way from the angles in the plane to arc length.
FIRST_STEP = 0.25
LEAST_STEP = 1.0 / 64.0

# Newton steps on the barrier energy between two steps: enough for the interior to follow.
RELAXATION_STEPS = 6
RELAXATION = EnergyWeights(0.0, 1.0, 1.0)


def rims_turned(
    vertices: FloatArray,
    faces: IntArray,
    directions: FloatArray,
    curves: Sequence[tuple[Circle, IntArray, FloatArray]],
    is_fixed: BoolArray,
) -> Untangled:
    """Turn rims from where they are to given angles on their circles, without folds.

    Every step turns the vertices of all curves by a share of their way, untangles what folds and
    relaxes the interior; a step that leaves folds is halved.

    Parameters
    ----------
    vertices : (V, 3) float64, mm
    faces : (F, 3) int64
    directions : (V, 3) float64
        Free of folds or nearly so, curves on their circles.
    curves : sequence of (Circle, (n,) int64, (n,) float64)
        Circle, vertices and final angles of each curve.
    is_fixed : (V,) bool
        The vertices of all curves.

    Returns
    -------
    Untangled
        Folded where the least step still leaves folds.
    """
    result = untangled(directions, faces, is_fixed)
    ways = [_ways(circle, directions[loop], angles) for circle, loop, angles in curves]
    done, step, iterations = 0.0, FIRST_STEP, result.iterations
    if result.folded:
        return result
    current = _relaxed(vertices, faces, result.directions, is_fixed)
    while done < 1.0:
        share = min(done + step, 1.0)
        trial = current.copy()
        for (circle, loop, angles), way in zip(curves, ways, strict=True):
            trial[loop] = circle.points(angles - (1.0 - share) * way)
        result = untangled(trial, faces, is_fixed)
        iterations += result.iterations
        if result.folded == 0:
            current = _relaxed(vertices, faces, result.directions, is_fixed)
            done, step = share, min(2.0 * step, FIRST_STEP)
        elif step > LEAST_STEP:
            step *= 0.5
        else:
            return Untangled(result.directions, result.folded, iterations)
    return Untangled(current, 0, iterations)


def _ways(circle: Circle, points: FloatArray, angles: FloatArray) -> FloatArray:
    """How far each vertex of a curve turns, continuous along it and least on average."""
    difference = np.unwrap(angles - circle.angles(points))
    ways: FloatArray = difference - 2.0 * np.pi * np.round(difference.mean() / (2.0 * np.pi))
    return ways


def _relaxed(
    vertices: FloatArray, faces: IntArray, directions: FloatArray, is_fixed: BoolArray
) -> FloatArray:
    area = float(spherical_areas(directions, faces).sum())
    problem = map_problem(faces, surface_reference(vertices, faces, area), is_fixed)
    return minimised(problem, directions, RELAXATION, 0.0, RELAXATION_STEPS, 1e-2).directions
