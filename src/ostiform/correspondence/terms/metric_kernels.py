"""Compiled assembly of the metric term: how the fields change the logarithms of edge lengths."""

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.compiled import kernel


@kernel
def metric_system(
    points: FloatArray,
    edges: IntArray,
    residuals: FloatArray,
    weights: FloatArray,
    starts: IntArray,
    fields: IntArray,
    moved: FloatArray,
    n_fields: int,
) -> tuple[FloatArray, FloatArray]:
    """Return half the gradient (D,) and half the Gauss-Newton matrix (D, D) of the metric term.

    points (Q, 3), edges (E, 2), residuals (E,) of the logarithms, weights (E,); moved (A, 3) is
    how every active field moves its point, mm.
    """
    gradient = np.zeros(n_fields)
    matrix = np.zeros((n_fields, n_fields))
    indices = np.empty(n_fields, np.int64)
    slopes = np.empty(n_fields)
    for e in range(len(edges)):
        k, l = edges[e, 0], edges[e, 1]
        square = 0.0
        for i in range(3):
            square += (points[k, i] - points[l, i]) ** 2
        if square == 0.0:
            continue
        x = (points[k, 0] - points[l, 0]) / square
        y = (points[k, 1] - points[l, 1]) / square
        z = (points[k, 2] - points[l, 2]) / square
        a, b = starts[k], starts[l]
        count = 0
        while a < starts[k + 1] or b < starts[l + 1]:
            at_k = a < starts[k + 1] and (b >= starts[l + 1] or fields[a] <= fields[b])
            at_l = b < starts[l + 1] and (a >= starts[k + 1] or fields[b] <= fields[a])
            slope = 0.0
            if at_k:
                indices[count] = fields[a]
                slope += x * moved[a, 0] + y * moved[a, 1] + z * moved[a, 2]
                a += 1
            if at_l:
                indices[count] = fields[b]
                slope -= x * moved[b, 0] + y * moved[b, 1] + z * moved[b, 2]
                b += 1
            slopes[count] = slope
            count += 1
        for i in range(count):
            scaled = weights[e] * slopes[i]
            gradient[indices[i]] += scaled * residuals[e]
            row = matrix[indices[i]]
            for j in range(i + 1):
                row[indices[j]] += scaled * slopes[j]
    for d in range(n_fields):
        for e in range(d):
            matrix[e, d] = matrix[d, e]
    return gradient, matrix
