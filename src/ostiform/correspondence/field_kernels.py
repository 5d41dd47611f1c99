"""Compiled kernels of the warps: basis fields, cut-offs at the circles and their integration.

A field is a row of two tables. `table` (D, 12) float64: centre 0:3, direction 3:6, first axis of
the centre's tangent frame 6:9, support 9, angle 10, circle radius 11. `labels` (D, 4) int64: kind,
component sphere, number of control points on the circle of a twist, and 1 for a field with the
same kind, centre and support as the row before (the second of an interior control point, the
further ones of a circle). `circles` (K, 8) float64: centre 0:3, radius 3, cut-off width 4,
cosine of the outer and of the inner end of the cut-off 5:7, component sphere 7.
"""

import math

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.compiled import kernel

BUMP, ROTATION, BOOST, TWIST = 0, 1, 2, 3


@kernel
def _smooth_step(s: float) -> float:
    """Return the quintic 0 -> 1 step, C2 at both ends."""
    return s * s * s * (10.0 + s * (6.0 * s - 15.0))


@kernel
def wendland(q: float) -> float:
    """Return the Wendland C2 bump (1 - q)^4 (4 q + 1)."""
    if q >= 1.0:
        return 0.0
    r = (1.0 - q) * (1.0 - q)
    return r * r * (4.0 * q + 1.0)


@kernel
def _reach(f: FloatArray, kind: int) -> tuple[float, float]:
    """Return the cosines of the angles from a field's centre between which it is not zero."""
    if kind == BUMP:
        return 1.0 - 0.5 * f[9] ** 2, 2.0
    if kind == TWIST:
        far, near = f[11] + f[9], f[11] - f[9]
        return (math.cos(far) if far < math.pi else -2.0), (math.cos(near) if near > 0.0 else 2.0)
    return -2.0, 2.0


@kernel
def _field(f: FloatArray, kind: int, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return the tangent vector of a field other than a twist at a point, before the cut-offs."""
    if kind == ROTATION:
        return f[4] * z - f[5] * y, f[5] * x - f[3] * z, f[3] * y - f[4] * x
    height = 1.0
    if kind == BUMP:
        dot = f[0] * x + f[1] * y + f[2] * z
        height = wendland(math.sqrt(max(0.0, 2.0 - 2.0 * dot)) / f[9])
        if height == 0.0:
            return 0.0, 0.0, 0.0
    normal = f[3] * x + f[4] * y + f[5] * z
    return height * (f[3] - normal * x), height * (f[4] - normal * y), height * (f[5] - normal * z)


@kernel
def _about_circle(f: FloatArray, u: FloatArray, around: FloatArray) -> None:
    """Fill `around`: the twist's tangent vector but for the wave along the circle, the angle."""
    dot = f[0] * u[0] + f[1] * u[1] + f[2] * u[2]
    rho = math.acos(min(1.0, max(-1.0, dot)))
    height = wendland(abs(rho - f[11]) / f[9])
    if height > 0.0:
        height /= math.sin(rho)
    around[0] = height * (f[1] * u[2] - f[2] * u[1])
    around[1] = height * (f[2] * u[0] - f[0] * u[2])
    around[2] = height * (f[0] * u[1] - f[1] * u[0])
    second = (
        u[0] * (f[1] * f[8] - f[2] * f[7])
        + u[1] * (f[2] * f[6] - f[0] * f[8])
        + u[2] * (f[0] * f[7] - f[1] * f[6])
    )
    around[3] = math.atan2(second, u[0] * f[6] + u[1] * f[7] + u[2] * f[8])


@kernel
def _wave(angle: float, count: int) -> float:
    """Return the trigonometric interpolant of 1, 0, ..., 0 at an odd number of equal steps."""
    half = math.sin(0.5 * angle)
    if abs(half) < 1e-9:
        return 1.0
    return math.sin(0.5 * count * angle) / (count * half)


@kernel
def cut_off_share(s: float) -> float:
    """Return the share of the normal component that is cut off, s widths from a circle."""
    return 1.0 - _smooth_step(s) if s < 1.0 else 0.0


@kernel
def _near_circles(
    circles: FloatArray, sphere: int, on_circle: int, u: FloatArray, normals: FloatArray
) -> int:
    """Fill `normals` (K, 4) with the circles near a point and return how many there are.

    Columns: a tangent vector n towards the circle's centre, and the share to take off divided by
    |n|^2, so that cutting off is ``v -= normals[k, 3] (v . n) n``.
    """
    count = 0
    for k in range(len(circles)):
        c = circles[k]
        if c[7] != sphere:
            continue
        dot = c[0] * u[0] + c[1] * u[1] + c[2] * u[2]
        share = 1.0
        if k != on_circle:
            if dot <= c[5] or dot >= c[6]:
                continue
            share = cut_off_share(abs(math.acos(min(1.0, max(-1.0, dot))) - c[3]) / c[4])
        square = 0.0
        for i in range(3):
            normals[count, i] = c[i] - dot * u[i]
            square += normals[count, i] ** 2
        if square > 0.0:
            normals[count, 3] = share / square
            count += 1
    return count


@kernel
def _cut_off(normals: FloatArray, count: int, v: FloatArray) -> None:
    """Take the components normal to the near circles off a vector, in place."""
    for k in range(count):
        n = normals[k]
        part = n[3] * (v[0] * n[0] + v[1] * n[1] + v[2] * n[2])
        v[0] -= part * n[0]
        v[1] -= part * n[1]
        v[2] -= part * n[2]


@kernel
def active_fields(
    points: FloatArray, sphere: IntArray, table: FloatArray, labels: IntArray
) -> tuple[IntArray, IntArray]:
    """Return the fields that reach each point, as rows of indices.

    Returns
    -------
    starts : (P + 1,) int64
    fields : (A,) int64
        Those of point p are ``fields[starts[p]:starts[p + 1]]``.
    """
    count, n_fields = len(points), len(table)
    starts = np.zeros(count + 1, np.int64)
    found = np.empty(count * n_fields, np.int32)
    bounds = np.empty((n_fields, 2))
    for d in range(n_fields):
        bounds[d, 0], bounds[d, 1] = _reach(table[d], labels[d, 0])
    total = 0
    for p in range(count):
        x, y, z = points[p, 0], points[p, 1], points[p, 2]
        reaches = False
        for d in range(n_fields):
            if labels[d, 1] != sphere[p]:
                continue
            if labels[d, 3] == 0:
                dot = table[d, 0] * x + table[d, 1] * y + table[d, 2] * z
                reaches = bounds[d, 0] < dot < bounds[d, 1]
            if reaches:
                found[total] = d
                total += 1
        starts[p + 1] = total
    return starts, found[:total].astype(np.int64)


@kernel
def field_vectors(
    points: FloatArray,
    sphere: IntArray,
    curve: IntArray,
    starts: IntArray,
    fields: IntArray,
    table: FloatArray,
    labels: IntArray,
    circles: FloatArray,
) -> FloatArray:
    """Return the vector (A, 3) of every active field at its point, cut off at the circles."""
    vectors = np.empty((len(fields), 3))
    normals, around = np.empty((len(circles), 4)), np.empty(4)
    for p in range(len(points)):
        x, y, z = points[p, 0], points[p, 1], points[p, 2]
        near = _near_circles(circles, sphere[p], curve[p], points[p], normals)
        for a in range(starts[p], starts[p + 1]):
            d = fields[a]
            v = vectors[a]
            if labels[d, 0] == TWIST:
                if labels[d, 3] == 0:
                    _about_circle(table[d], points[p], around)
                wave = _wave(around[3] - table[d, 10], labels[d, 2])
                v[0], v[1], v[2] = wave * around[0], wave * around[1], wave * around[2]
            else:
                v[0], v[1], v[2] = _field(table[d], labels[d, 0], x, y, z)
            _cut_off(normals, near, v)
    return vectors


@kernel
def determinants(points: FloatArray, faces: IntArray) -> FloatArray:
    """Return ``det(a, b, c)`` (F,) of the corners of triangles; positive seen from outside."""
    values = np.empty(len(faces))
    for t in range(len(faces)):
        a, b, c = points[faces[t, 0]], points[faces[t, 1]], points[faces[t, 2]]
        values[t] = (
            a[0] * (b[1] * c[2] - b[2] * c[1])
            + a[1] * (b[2] * c[0] - b[0] * c[2])
            + a[2] * (b[0] * c[1] - b[1] * c[0])
        )
    return values
