"""Local foldover-free untangling of the few triangles that are folded (Garanzha et al. 2021).

Each connected neighbourhood of folded triangles is mapped anew with its border fixed, by the
regularised barrier energy with equal equilateral references; the neighbourhood grows when that
fails. The paper's own untangling (HY eq. 1) is in `ostiform.embedding.maxmin`.
"""

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from ostiform.arrays import BoolArray, FloatArray, IntArray
from ostiform.embedding.energy import EnergyWeights, equilateral_reference
from ostiform.embedding.newton import map_problem, minimised
from ostiform.surface.sphere import exact_orientations, spherical_areas, triangle_determinants

__all__ = ["Untangled", "untangled"]

# Conformal and area terms weigh alike: the second keeps the first from collapsing triangles.
UNTANGLING = EnergyWeights(0.0, 0.5, 0.5)

# Regularisation epsilon^2 = floor^2 + share d^2, d the worst signed area ratio: the rule of the
# authors' later programs, which needs several times fewer steps here than that of their theorem.
EPSILON_FLOOR = 1e-3
EPSILON_SHARE = 0.04


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
        for patch in _connected(chosen, incidence):
            current, steps = _untangled_patch(current, faces, is_fixed, incidence, patch)
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


def _untangled_patch(
    directions: FloatArray,
    faces: IntArray,
    is_fixed: BoolArray,
    incidence: sparse.csr_array,
    patch: IntArray,
    max_outer: int = 30,
) -> tuple[FloatArray, int]:
    vertices, local = np.unique(faces[patch], return_inverse=True)
    local = local.reshape(-1, 3).astype(np.int64)
    inside = np.bincount(local.ravel(), minlength=len(vertices))
    around = np.diff(incidence.tocsc().indptr)[vertices]
    fixed = is_fixed[vertices] | (inside < around)
    start = np.ascontiguousarray(directions[vertices])
    area = float(spherical_areas(start, local).sum())
    reference = equilateral_reference(len(patch), max(area, 1e-12))
    problem = map_problem(local, reference, fixed)
    if problem.n_dofs == 0:
        return directions, 0
    least = float((triangle_determinants(start, local) / (2.0 * reference.areas)).min())
    factorization = None
    steps = 0
    for _ in range(max_outer):
        epsilon = float(np.sqrt(EPSILON_FLOOR**2 + EPSILON_SHARE * min(least, 0.0) ** 2))
        result = minimised(problem, start, UNTANGLING, epsilon, 10, 1e-4, None, factorization)
        steps += result.iterations
        start, least = result.directions, result.least_ratio
        if least > 0.0 or result.iterations == 0:
            break
    moved = directions.copy()
    moved[vertices] = start
    return moved, steps
