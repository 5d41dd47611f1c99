"""A closed component on its sphere: no opening to project from, three rotations left free."""

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.embedding.disc import disc_solution
from ostiform.surface import inverse_stereographic, uniform_laplacian, vertex_areas


def punctured_start(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Return a fold-free map (V, 3) of a closed surface of genus 0 to the sphere.

    One vertex is put at the pole; its neighbours are the convex border of a Tutte embedding of
    the rest (HY 2.1), which is scaled so that each hemisphere gets half of the surface.

    Parameters
    ----------
    vertices : (V, 3) float64, mm
    faces : (F, 3) int64
        Closed, genus 0, outward.
    """
    removed = _puncture(vertices, faces)
    ring = _ring(faces, removed)
    azimuth = -2.0 * np.pi * np.arange(len(ring)) / len(ring)  # hole at the pole on the right
    kept = faces[(faces != removed).all(axis=1)]
    laplacian = uniform_laplacian(kept, len(vertices)).tolil()
    laplacian[removed, removed] = 1.0  # decoupled; its place is the pole
    fixed = np.append(ring, removed)
    zeta = disc_solution(laplacian.tocsr(), fixed, np.append(np.exp(1j * azimuth), 0.0))
    weights = vertex_areas(vertices, faces)
    rest = np.flatnonzero(np.arange(len(vertices)) != removed)
    order = rest[np.argsort(np.abs(zeta[rest]), kind="stable")]
    share = np.cumsum(weights[order]) / weights[order].sum()
    middle = float(np.abs(zeta[order[np.searchsorted(share, 0.5)]]))
    directions = inverse_stereographic(zeta / max(middle, 1e-12))
    directions[removed] = [0.0, 0.0, 1.0]
    return directions


def _puncture(vertices: FloatArray, faces: IntArray) -> int:
    """The vertex of most neighbours among the tenth nearest to the surface's centre.

    Far from the tips of tubes, whose image would otherwise spread over the sphere.
    """
    weights = vertex_areas(vertices, faces)
    center = weights @ vertices / weights.sum()
    distance = np.linalg.norm(vertices - center, axis=1)
    near = distance <= np.quantile(distance, 0.1)
    degree = np.bincount(faces.ravel(), minlength=len(vertices))
    return int(np.argmax(np.where(near, degree, -1)))


def _ring(faces: IntArray, vertex: int) -> IntArray:
    """Neighbours in order, the rest of the surface on the left."""
    around = faces[(faces == vertex).any(axis=1)]
    corner = np.argmax(around == vertex, axis=1)
    rows = np.arange(len(around))
    following = {
        int(b): int(a)
        for a, b in zip(around[rows, (corner + 1) % 3], around[rows, (corner + 2) % 3], strict=True)
    }
    ring = [next(iter(following))]
    while following[ring[-1]] != ring[0]:
        ring.append(following[ring[-1]])
    return np.array(ring, dtype=np.int64)
