"""Compiled interpolation of positions at directions: within triangles and along curves."""

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.compiled import kernel


@kernel
def interpolated_on_curve(
    frame: FloatArray,
    first_angle: float,
    sign: float,
    positions: FloatArray,
    vertices: FloatArray,
    queries: FloatArray,
    derivative: bool,
) -> tuple[FloatArray, FloatArray]:
    """Return positions (n, 3) on a closed polyline, and their derivative (n, 3, 3) or nothing."""
    # Fraction sin u / (sin u + sin v) of the chord, u and v the angles to
    # the edge's ends; its derivative by the angle is sin(u + v) / (sin u + sin v)^2, and that of
    # the angle by the direction points along the circle, over the distance from its axis.
    points = np.empty((len(queries), 3))
    jacobian = np.zeros((len(queries) if derivative else 0, 3, 3))
    for q in range(len(queries)):
        x = (queries[q] * frame[0]).sum()
        y = (queries[q] * frame[1]).sum()
        along = (sign * (np.arctan2(y, x) - first_angle)) % (2.0 * np.pi)
        edge = np.searchsorted(positions, along, side="right") - 1
        edge = min(max(edge, 0), len(positions) - 2)
        length = positions[edge + 1] - positions[edge]
        before = min(max(along - positions[edge], 0.0), length)
        both = np.sin(before) + np.sin(length - before)
        fraction = np.sin(before) / both
        for d in range(3):
            chord = vertices[edge + 1, d] - vertices[edge, d]
            points[q, d] = vertices[edge, d] + fraction * chord
            if derivative:
                slope = sign * chord * np.sin(length) / both**2 / (x * x + y * y)
                for e in range(3):
                    jacobian[q, d, e] = slope * (x * frame[1, e] - y * frame[0, e])
    return points, jacobian


@kernel
def interpolated(
    corners: FloatArray,
    faces: IntArray,
    n_faces: int,
    positions: FloatArray,
    queries: FloatArray,
    triangles: IntArray,
    derivative: bool,
) -> tuple[FloatArray, FloatArray]:
    """Return positions (n, 3) in given triangles, and their derivative (n, 3, 3) or nothing."""
    # With n_0 = b x c, n_1 = c x a, n_2 = a x b: weights w_i = n_i . p, barycentric w_i / sum w,
    # position x = sum w_i x_i / sum w, and dx/dp = sum (x_i - x) n_i' / sum w. Beyond a rim (in a
    # fan, whose third corner is the apex) w_2 is left out. Differences from p keep the digits.
    points = np.zeros((len(queries), 3))
    jacobian = np.zeros((len(queries) if derivative else 0, 3, 3))
    normals = np.empty((3, 3))
    weights = np.empty(3)
    for q in range(len(queries)):
        p = queries[q]
        t = triangles[q]
        used = 3 if t < n_faces else 2
        total = 0.0
        for i in range(used):
            u, v = corners[faces[t, (i + 1) % 3]], corners[faces[t, (i + 2) % 3]]
            ex, ey, ez = v[0] - u[0], v[1] - u[1], v[2] - u[2]
            normals[i, 0] = u[1] * ez - u[2] * ey  # u x v = u x (v - u)
            normals[i, 1] = u[2] * ex - u[0] * ez
            normals[i, 2] = u[0] * ey - u[1] * ex
            weights[i] = 0.0
            for d in range(3):
                weights[i] += normals[i, d] * (p[d] - u[d])
            weights[i] = max(weights[i], 0.0)
            total += weights[i]
        if total <= 0.0:  # the centre of a hole: the middle of its fan triangle's rim edge
            weights[:] = 1.0
            total = float(used)
        for i in range(used):
            for d in range(3):
                points[q, d] += weights[i] / total * positions[faces[t, i], d]
        if not derivative:
            continue
        for i in range(used):
            along = 0.0
            for d in range(3):
                along += normals[i, d] * p[d]
            for d in range(3):
                excess = (positions[faces[t, i], d] - points[q, d]) / total
                for e in range(3):
                    jacobian[q, d, e] += excess * (normals[i, e] - along * p[e])
    return points, jacobian
