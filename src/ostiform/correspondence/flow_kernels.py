"""Compiled flows of a stationary velocity, whose fields have been summed where that is exact.

With coefficients given, the conformal fields of a sphere are one rotation and one boost, the two
splines of a control point one vector, and the twists of a circle with one support one
trigonometric polynomial: a tenth of the fields, and none of their angles.
"""

import math

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.compiled import kernel
from ostiform.correspondence.field_kernels import cut_off_share, wendland


@kernel(error_model="numpy")
def _twisted(first: int, last: int, away: float, x: float, y: float, rings: FloatArray) -> float:
    """Return the speed along a circle at cosine x and sine y of the angle about its centre."""
    total = 0.0
    for g in range(first, last):
        if away < rings[g, 0]:
            wave, c, s = rings[g, 2], 1.0, 0.0
            for j in range(3, 3 + int(rings[g, 1]), 2):
                c, s = c * x - s * y, s * x + c * y
                wave += rings[g, j] * c + rings[g, j + 1] * s
            total += wave * wendland(away / rings[g, 0])
    return total


@kernel(error_model="numpy")
def _velocity(
    u: tuple[float, float, float],
    sphere: int,
    on_circle: int,
    near: IntArray,
    count: int,
    conformal: FloatArray,
    bumps: FloatArray,
    circles: FloatArray,
    rings: FloatArray,
    first_ring: IntArray,
    normals: FloatArray,
) -> tuple[float, float, float]:
    x, y, z = u
    a = conformal[sphere]
    along = a[3] * x + a[4] * y + a[5] * z
    vx = a[1] * z - a[2] * y + a[3] - along * x
    vy = a[2] * x - a[0] * z + a[4] - along * y
    vz = a[0] * y - a[1] * x + a[5] - along * z
    for i in range(count):
        b = near[i]
        square = 2.0 - 2.0 * (bumps[b, 0] * x + bumps[b, 1] * y + bumps[b, 2] * z)
        if square >= bumps[b, 6] * bumps[b, 6]:
            continue
        height = wendland(math.sqrt(max(0.0, square)) / bumps[b, 6])
        along = bumps[b, 3] * x + bumps[b, 4] * y + bumps[b, 5] * z
        vx += height * (bumps[b, 3] - along * x)
        vy += height * (bumps[b, 4] - along * y)
        vz += height * (bumps[b, 5] - along * z)
    found = 0
    for k in range(len(circles)):
        if circles[k, 7] != sphere:
            continue
        dot = circles[k, 0] * x + circles[k, 1] * y + circles[k, 2] * z
        share = 1.0 if k == on_circle else 0.0
        if min(circles[k, 14], circles[k, 5]) < dot < max(circles[k, 15], circles[k, 6]):
            first = circles[k, 8] * x + circles[k, 9] * y + circles[k, 10] * z
            second = circles[k, 11] * x + circles[k, 12] * y + circles[k, 13] * z
            sine = math.sqrt(first * first + second * second)
            away = abs(math.atan2(sine, dot) - circles[k, 3])
            if sine > 0.0:
                part = 1.0 / sine
                part *= _twisted(
                    first_ring[k], first_ring[k + 1], away, part * first, part * second, rings
                )
                vx += part * (circles[k, 1] * z - circles[k, 2] * y)
                vy += part * (circles[k, 2] * x - circles[k, 0] * z)
                vz += part * (circles[k, 0] * y - circles[k, 1] * x)
            if k != on_circle:
                share = cut_off_share(away / circles[k, 4])
        if share > 0.0:
            square = 0.0
            for i in range(3):
                normals[found, i] = circles[k, i] - dot * u[i]
                square += normals[found, i] ** 2
            if square > 0.0:
                normals[found, 3] = share / square
                found += 1
    for k in range(found):
        part = normals[k, 3] * (vx * normals[k, 0] + vy * normals[k, 1] + vz * normals[k, 2])
        vx -= part * normals[k, 0]
        vy -= part * normals[k, 1]
        vz -= part * normals[k, 2]
    return vx, vy, vz


@kernel(error_model="numpy")
def _landed(
    x: float, y: float, z: float, on_circle: int, circles: FloatArray
) -> tuple[float, float, float]:
    """Return a point put back on the unit sphere, and on its circle."""
    if on_circle < 0:
        scale = 1.0 / math.sqrt(x * x + y * y + z * z)
        return scale * x, scale * y, scale * z
    c = circles[on_circle]
    dot = c[0] * x + c[1] * y + c[2] * z
    x, y, z = x - dot * c[0], y - dot * c[1], z - dot * c[2]
    scale, height = math.sin(c[3]) / math.sqrt(x * x + y * y + z * z), math.cos(c[3])
    return scale * x + height * c[0], scale * y + height * c[1], scale * z + height * c[2]


@kernel(error_model="numpy")
def _bumps_near(
    u: tuple[float, float, float],
    sphere: int,
    bumps: FloatArray,
    bump_sphere: IntArray,
    margin: float,
    near: IntArray,
) -> int:
    """Fill `near` with the splines that come within a margin of a point; return how many."""
    count = 0
    for b in range(len(bumps)):
        dot = bumps[b, 0] * u[0] + bumps[b, 1] * u[1] + bumps[b, 2] * u[2]
        if bump_sphere[b] == sphere and 2.0 - 2.0 * dot < (bumps[b, 6] + margin) ** 2:
            near[count] = b
            count += 1
    return count


@kernel(error_model="numpy")
def flow_points(
    points: FloatArray,
    sphere: IntArray,
    curve: IntArray,
    conformal: FloatArray,
    bumps: FloatArray,
    bump_sphere: IntArray,
    circles: FloatArray,
    rings: FloatArray,
    first_ring: IntArray,
    margin: float,
    steps: int,
) -> FloatArray:
    """Carry points (P, 3) along a velocity for unit time by steps of RK4 on the sphere.

    No point travels farther than the margin. See `merged_velocity.MergedVelocity`.
    """
    moved = np.empty_like(points)
    h = 1.0 / steps
    normals, near = np.empty((len(circles), 4)), np.empty(len(bumps), np.int64)
    for p in range(len(points)):
        u = points[p, 0], points[p, 1], points[p, 2]
        count = _bumps_near(u, sphere[p], bumps, bump_sphere, margin, near)
        for _ in range(steps):
            at = u
            sx, sy, sz = 0.0, 0.0, 0.0
            for stage in range(4):
                v = _velocity(
                    at,
                    sphere[p],
                    curve[p],
                    near,
                    count,
                    conformal,
                    bumps,
                    circles,
                    rings,
                    first_ring,
                    normals,
                )
                weight = 1.0 if stage == 0 or stage == 3 else 2.0
                sx, sy, sz = sx + weight * v[0], sy + weight * v[1], sz + weight * v[2]
                if stage < 3:
                    part = h if stage == 2 else 0.5 * h
                    at = _landed(
                        u[0] + part * v[0],
                        u[1] + part * v[1],
                        u[2] + part * v[2],
                        curve[p],
                        circles,
                    )
            u = _landed(
                u[0] + h * sx / 6.0, u[1] + h * sy / 6.0, u[2] + h * sz / 6.0, curve[p], circles
            )
        moved[p, 0], moved[p, 1], moved[p, 2] = u
    return moved


@kernel(error_model="numpy")
def velocities(
    points: FloatArray,
    sphere: IntArray,
    curve: IntArray,
    conformal: FloatArray,
    bumps: FloatArray,
    bump_sphere: IntArray,
    circles: FloatArray,
    rings: FloatArray,
    first_ring: IntArray,
) -> FloatArray:
    """Return the velocity (P, 3) at points; see `merged_velocity.MergedVelocity`."""
    rates = np.empty_like(points)
    normals, near = np.empty((len(circles), 4)), np.empty(len(bumps), np.int64)
    for p in range(len(points)):
        u = points[p, 0], points[p, 1], points[p, 2]
        count = _bumps_near(u, sphere[p], bumps, bump_sphere, 0.0, near)
        v = _velocity(
            u,
            sphere[p],
            curve[p],
            near,
            count,
            conformal,
            bumps,
            circles,
            rings,
            first_ring,
            normals,
        )
        rates[p, 0], rates[p, 1], rates[p, 2] = v
    return rates
