"""Local foldover-free untangling of the few triangles that are folded (Garanzha et al. 2021).

Each connected neighbourhood of folded triangles is mapped anew with its border fixed, by the
regularised barrier energy with equilateral references of the local size; the neighbourhood grows
when that fails. The paper's own untangling (HY eq. 1) is in `ostiform.embedding.maxmin`.
"""

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from ostiform.arrays import BoolArray, FloatArray, IntArray
from ostiform.embedding.energy import EnergyWeights
from ostiform.embedding.newton import MapProblem, map_problem, minimised
from ostiform.embedding.reference import equilateral_reference
from ostiform.surface import exact_orientations, spherical_areas, triangle_determinants

# Conformal and area terms weigh alike: the second keeps the first from collapsing triangles.
UNTANGLING = EnergyWeights(0.0, 0.5, 0.5)

# Regularisation epsilon^2 = floor^2 + share d^2, d the worst signed area ratio: the rule of the
# authors' later programs, which needs several times fewer steps here than that of their theorem.
EPSILON_FLOOR = 1e-3
EPSILON_SHARE = 0.04
LEAST_EPSILON = 1e-10

# Rings over which the size of a reference triangle is averaged, and its least share of the mean.
SMOOTHING_RINGS = 4
LEAST_SHARE = 1e-10


@dataclass(frozen=True, slots=True, eq=False)
class Untangled:
    """The result of an untangling.

    Attributes
    ----------
    directions : (V, 3) float64
    folded : int
        Triangles still folded.
    iterations : int
        Newton steps, all neighbourhoods together.
    """

    directions: FloatArray
    folded: int
    iterations: int


def untangled(
    directions: FloatArray,
    faces: IntArray,
    is_fixed: BoolArray,
    rings: int = 4,
    max_rounds: int = 7,
) -> Untangled:
    """Unfold a map whose folds are few, moving only their neighbourhoods.

    Two rounds with references of the local size (half the steps of equal ones); where they fail,
    from the given map again with references of equal size, which stand more disorder.

    Parameters
    ----------
    directions : (V, 3) float64
        Unit vectors.
    faces : (F, 3) int64
    is_fixed : (V,) bool
        Vertices that must not move.
    rings : int
        Rings of triangles around the folded ones in the first round; doubled after a round that
        leaves folds.
    max_rounds : int
    """
    local = _attempted(directions, faces, is_fixed, rings, min(max_rounds, 2), True)
    if local.folded == 0 or max_rounds <= 2:
        return local
    equal = _attempted(directions, faces, is_fixed, rings, max_rounds, False)
    best = equal if equal.folded <= local.folded else local
    return Untangled(best.directions, best.folded, local.iterations + equal.iterations)


def _attempted(
    directions: FloatArray,
    faces: IntArray,
    is_fixed: BoolArray,
    rings: int,
    max_rounds: int,
    has_local_size: bool,
) -> Untangled:
    current = directions
    iterations = 0
    incidence: sparse.csr_array | None = None
    for number in range(max_rounds):
        folded = _folded(current, faces)
        if not folded.any():
            break
        if incidence is None:
            incidence = _incidence(faces, len(directions))
        chosen = _grown(folded, incidence, rings * 2**number)
        for triangles in _connected(chosen, incidence):
            patch = _patch(current, faces, is_fixed, incidence, triangles, has_local_size)
            current, steps = _untangled_patch(current, patch)
            iterations += steps
        if chosen.all():
            break
    return Untangled(current, int(_folded(current, faces).sum()), iterations)


def _folded(directions: FloatArray, faces: IntArray) -> BoolArray:
    """Folded or degenerate triangles, exactly: only uncertain signs need the exact predicate."""
    determinants = triangle_determinants(directions, faces)
    folded: BoolArray = determinants <= 0.0
    uncertain = np.flatnonzero(np.abs(determinants) < 1e-14)
    folded[uncertain] = exact_orientations(directions, faces[uncertain]) <= 0
    return folded


def _incidence(faces: IntArray, n_vertices: int) -> sparse.csr_array:
    rows = np.repeat(np.arange(len(faces)), 3)
    entries = (np.ones(3 * len(faces)), (rows, faces.ravel()))
    return sparse.coo_array(entries, shape=(len(faces), n_vertices)).tocsr()


def _grown(chosen: BoolArray, incidence: sparse.csr_array, rings: int) -> BoolArray:
    grown = chosen
    for _ in range(rings):
        touched = incidence.T @ grown.astype(np.float64) > 0
        grown = incidence @ touched.astype(np.float64) > 0
    return grown


def _connected(chosen: BoolArray, incidence: sparse.csr_array) -> list[IntArray]:
    """Split chosen triangles into sets that share no vertex."""
    members = np.flatnonzero(chosen)
    rows = incidence[members]
    _, labels = connected_components(rows @ rows.T, directed=False)
    order = np.argsort(labels, kind="stable")
    return np.split(members[order], np.flatnonzero(np.diff(labels[order])) + 1)


def _local_areas(directions: FloatArray, faces: IntArray) -> FloatArray:
    """Return the size (F,) of the triangles around each triangle, folded or not.

    Mean absolute areas over a few rings: near an opened hole triangles differ by orders of
    magnitude over a patch, but not over a few rings.
    """
    corners = faces.ravel()
    uses = np.bincount(corners)
    areas = np.abs(spherical_areas(directions, faces))
    for _ in range(SMOOTHING_RINGS):
        around = np.bincount(corners, np.repeat(areas, 3)) / uses
        areas = around[faces].mean(axis=1)
    floored: FloatArray = np.maximum(areas, LEAST_SHARE * areas.mean())
    return floored


@dataclass(frozen=True, slots=True, eq=False)
class _Patch:
    """A neighbourhood to be mapped anew: its vertices in the mesh, and its own problem."""

    vertices: IntArray
    problem: MapProblem


def _patch(
    directions: FloatArray,
    faces: IntArray,
    is_fixed: BoolArray,
    incidence: sparse.csr_array,
    triangles: IntArray,
    has_local_size: bool,
) -> _Patch:
    vertices, local = np.unique(faces[triangles], return_inverse=True)
    local = local.reshape(-1, 3).astype(np.int64)
    inside = np.bincount(local.ravel(), minlength=len(vertices))
    around = np.bincount(incidence.indices, minlength=len(directions))[vertices]
    fixed = is_fixed[vertices] | (inside < around)
    if has_local_size:
        areas = _local_areas(directions[vertices], local)
    else:
        total = float(spherical_areas(directions[vertices], local).sum())
        areas = np.full(len(local), max(total, 1e-12) / len(local))
    return _Patch(vertices, map_problem(local, equilateral_reference(areas), fixed))


def _untangled_patch(
    directions: FloatArray, patch: _Patch, max_outer: int = 30
) -> tuple[FloatArray, int]:
    """Return the map with a patch untangled as far as possible, and the Newton steps taken."""
    problem = patch.problem
    start = np.ascontiguousarray(directions[patch.vertices])
    if problem.n_dofs == 0:
        return directions, 0
    ratios = triangle_determinants(start, problem.faces) / (2.0 * problem.reference.areas)
    least = float(ratios.min())
    steps = 0
    floor = EPSILON_FLOOR
    for _ in range(max_outer):
        epsilon = float(np.sqrt(floor**2 + EPSILON_SHARE * min(least, 0.0) ** 2))
        result = minimised(problem, start, UNTANGLING, epsilon, 10, 1e-4)
        steps += result.iterations
        # a fold smaller than epsilon costs nothing: ask for less where it does not go away
        if result.least_ratio < 0.5 * least or result.iterations == 0:
            floor = max(0.1 * floor, LEAST_EPSILON)
        start, least = result.directions, result.least_ratio
        if least > 0.0:
            break
    moved = directions.copy()
    moved[patch.vertices] = start
    return moved, steps
