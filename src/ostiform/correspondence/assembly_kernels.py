"""Compiled assembly of one shape's Gauss-Newton system from its active fields."""

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.compiled import kernel


@kernel
def landmark_derivatives(
    starts: IntArray, vectors: FloatArray, derivatives: FloatArray
) -> FloatArray:
    """Return how every active field moves its landmark, (A, 3) in mm.

    ``dS/du b``: vectors (A, 3) are b, derivatives (Q, 3, 3) dS/du.
    """
    moved = np.empty_like(vectors)
    for p in range(len(starts) - 1):
        matrix = derivatives[p]
        for a in range(starts[p], starts[p + 1]):
            for k in range(3):
                moved[a, k] = (
                    matrix[k, 0] * vectors[a, 0]
                    + matrix[k, 1] * vectors[a, 1]
                    + matrix[k, 2] * vectors[a, 2]
                )
    return moved


@kernel
def normal_matrix(
    starts: IntArray, fields: IntArray, moved: FloatArray, n_fields: int
) -> FloatArray:
    """Return ``J^T J`` (D, D), J the (3Q, D) matrix whose entries are `moved`."""
    matrix = np.zeros((n_fields, n_fields))
    for p in range(len(starts) - 1):
        for a in range(starts[p], starts[p + 1]):
            x, y, z = moved[a, 0], moved[a, 1], moved[a, 2]
            row = matrix[fields[a]]
            for b in range(starts[p], a + 1):
                row[fields[b]] += x * moved[b, 0] + y * moved[b, 1] + z * moved[b, 2]
    for d in range(n_fields):
        for e in range(d):
            matrix[e, d] = matrix[d, e]
    return matrix


@kernel
def score_derivatives(
    starts: IntArray,
    fields: IntArray,
    moved: FloatArray,
    modes: FloatArray,
    n_fields: int,
) -> FloatArray:
    """Return ``(U J)^T`` (D, R) for modes U^T of shape (3Q, R)."""
    scores = np.zeros((n_fields, modes.shape[1]))
    for p in range(len(starts) - 1):
        first, second, third = modes[3 * p], modes[3 * p + 1], modes[3 * p + 2]
        for a in range(starts[p], starts[p + 1]):
            row = scores[fields[a]]
            for r in range(len(row)):
                row[r] += moved[a, 0] * first[r] + moved[a, 1] * second[r] + moved[a, 2] * third[r]
    return scores


@kernel
def motion_derivatives(
    starts: IntArray,
    fields: IntArray,
    moved: FloatArray,
    motions: FloatArray,
    n_fields: int,
) -> FloatArray:
    """Return the derivative (D, 3, S) of each coordinate along motions M^T of shape (Q, S)."""
    scores = np.zeros((n_fields, 3, motions.shape[1]))
    for p in range(len(starts) - 1):
        motion = motions[p]
        for a in range(starts[p], starts[p + 1]):
            for k in range(3):
                row = scores[fields[a], k]
                for s in range(len(row)):
                    row[s] += moved[a, k] * motion[s]
    return scores


@kernel
def pulled_back(
    starts: IntArray, fields: IntArray, vectors: FloatArray, forces: FloatArray, n_fields: int
) -> FloatArray:
    """Return ``sum over points of vector . force`` (D,) for forces (Q, 3) at the points."""
    total = np.zeros(n_fields)
    for p in range(len(starts) - 1):
        for a in range(starts[p], starts[p + 1]):
            total[fields[a]] += (
                vectors[a, 0] * forces[p, 0]
                + vectors[a, 1] * forces[p, 1]
                + vectors[a, 2] * forces[p, 2]
            )
    return total


@kernel
def determinant_derivatives(
    points: FloatArray,
    faces: IntArray,
    starts: IntArray,
    fields: IntArray,
    vectors: FloatArray,
    n_fields: int,
) -> FloatArray:
    """Return the derivatives (F, D) of ``det(a, b, c)`` of triangles by the coefficients.

    Vectors (A, 3) are the active fields at the points.
    """
    derivatives = np.zeros((len(faces), n_fields))
    for t in range(len(faces)):
        for corner in range(3):
            p = faces[t, corner]
            b, c = points[faces[t, (corner + 1) % 3]], points[faces[t, (corner + 2) % 3]]
            x = b[1] * c[2] - b[2] * c[1]
            y = b[2] * c[0] - b[0] * c[2]
            z = b[0] * c[1] - b[1] * c[0]
            for a in range(starts[p], starts[p + 1]):
                derivatives[t, fields[a]] += (
                    x * vectors[a, 0] + y * vectors[a, 1] + z * vectors[a, 2]
                )
    return derivatives
