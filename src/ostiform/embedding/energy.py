"""The barrier energy of a map to the sphere, its gradient and its projected Hessian.

A triangle is mapped from its flat reference to the chord triangle of three unit vectors. With J the
3 x 2 derivative, ``I = |J|^2`` and ``d = det(x0, x1, x2) / (2 A)``, the signed area ratio (on the
sphere it has the sign of the orientation predicate), the energy per reference area is ::

    psi = w_D I / 2 + w_M I / (2 chi(d)) + w_A (1 + d^2) / (2 chi(d))

the Dirichlet energy (HY eq. 3), MIPS (Hormann & Greiner 2000), 1 for a conformal map, and an area
term, 1 for d = 1. ``chi(d) = (d + sqrt(epsilon^2 + d^2)) / 2`` regularises the division so that
folded triangles have a finite energy (Garanzha et al. 2021); epsilon = 0 is the exact barrier.
The Hessian of psi in J is made positive by clamping its four analytic eigenvalues (Smith et al.
2019; the curvature of the sphere, a relative O(h), is left out of it but not of the gradient).
"""

from dataclasses import dataclass

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.compiled import kernel

# Eigenvalues of the Hessian are clamped at this share of their sum. With the exact barrier 1e-9
# costs raw marching-cubes meshes half as many steps again, 1e-2 regular ones twice as many; the
# regularised barrier is so stiff in folded triangles that 1e-4 of it would hold them in place.
EXACT_FLOOR = 1e-4
REGULARISED_FLOOR = 1e-9


@dataclass(frozen=True, slots=True)
class EnergyWeights:
    """Weights of the Dirichlet, MIPS and area terms of the energy."""

    dirichlet: float
    mips: float
    area: float

    def as_array(self) -> FloatArray:
        """Return the weights as (3,) float64, for the kernels."""
        return np.array([self.dirichlet, self.mips, self.area])


@kernel
def _chi(d: float, epsilon: float) -> tuple[float, float, float]:
    """Regularised positive part of d and its first two derivatives."""
    if epsilon == 0.0:
        return d, 1.0, 0.0
    s = np.sqrt(epsilon * epsilon + d * d)
    chi = 0.5 * (d + s) if d > 0.0 else 0.5 * epsilon * epsilon / (s - d)  # no cancellation
    return chi, 0.5 + 0.5 * d / s, 0.5 * epsilon * epsilon / (s * s * s)


@kernel
def _psi(I: float, d: float, weights: FloatArray, epsilon: float) -> float:
    chi, _, _ = _chi(d, epsilon)
    barrier = 0.5 * (weights[1] * I + weights[2] * (1.0 + d * d)) / chi
    value: float = 0.5 * weights[0] * I + barrier
    return value


@kernel
def _psi_derivatives(
    I: float, d: float, weights: FloatArray, epsilon: float
) -> tuple[float, float, float, float, float]:
    """Return psi and its derivatives by I, d, (I, d) and (d, d); it is linear in I."""
    chi, chi1, chi2 = _chi(d, epsilon)
    w_dirichlet, w_mips, w_area = weights[0], weights[1], weights[2]
    inverse = 1.0 / chi
    slope = chi1 * inverse
    curvature = 2.0 * slope * slope - chi2 * inverse  # chi (1 / chi)''
    numerator = w_mips * I + w_area * (1.0 + d * d)
    value = 0.5 * w_dirichlet * I + 0.5 * numerator * inverse
    by_I = 0.5 * w_dirichlet + 0.5 * w_mips * inverse
    by_d = (w_area * d - 0.5 * numerator * slope) * inverse
    by_I_d = -0.5 * w_mips * slope * inverse
    by_d_d = (w_area - 2.0 * w_area * d * slope + 0.5 * numerator * curvature) * inverse
    return value, by_I, by_d, by_I_d, by_d_d


@kernel
def energy_value(
    directions: FloatArray,
    faces: IntArray,
    gradients: FloatArray,
    areas: FloatArray,
    weights: FloatArray,
    epsilon: float,
) -> tuple[float, float]:
    """Return the energy and the least signed area ratio; infinite if folded at epsilon = 0."""
    energy = 0.0
    least = np.inf
    for t in range(faces.shape[0]):
        i, j, k = faces[t, 0], faces[t, 1], faces[t, 2]
        x0, y0, z0 = directions[i, 0], directions[i, 1], directions[i, 2]
        x1, y1, z1 = directions[j, 0], directions[j, 1], directions[j, 2]
        x2, y2, z2 = directions[k, 0], directions[k, 1], directions[k, 2]
        det = x0 * (y1 * z2 - z1 * y2) + y0 * (z1 * x2 - x1 * z2) + z0 * (x1 * y2 - y1 * x2)
        d = 0.5 * det / areas[t]
        least = min(least, d)
        if epsilon == 0.0 and d <= 0.0:
            return np.inf, d
        I = 0.0
        for b in range(2):
            g0, g1, g2 = gradients[t, 0, b], gradients[t, 1, b], gradients[t, 2, b]
            u = g0 * x0 + g1 * x1 + g2 * x2
            v = g0 * y0 + g1 * y1 + g2 * y2
            w = g0 * z0 + g1 * z1 + g2 * z2
            I += u * u + v * v + w * w
        energy += areas[t] * _psi(I, d, weights, epsilon)
    return energy, least


@kernel
def energy_and_derivatives(  # noqa: PLR0913 (a kernel over plain arrays)
    directions: FloatArray,
    faces: IntArray,
    gradients: FloatArray,
    areas: FloatArray,
    weights: FloatArray,
    epsilon: float,
    bases: FloatArray,
    dofs: IntArray,
    slots: IntArray,
    gradient: FloatArray,
    hessian: FloatArray,
) -> float:
    """Assemble the energy, its gradient and its projected Hessian in the degrees of freedom.

    Parameters
    ----------
    directions : (V, 3) float64
    faces : (F, 3) int64
    gradients, areas : (F, 3, 2), (F,) float64
        The reference triangles.
    weights : (3,) float64
    epsilon : float
    bases : (V, 2, 3) float64
        The motion of a vertex per unit of each of its two degrees of freedom.
    dofs : (V, 2) int64
        Index of each degree of freedom, -1 where fixed; vertices may share one.
    slots : (F, 21) int64
        Where in `hessian` each entry (p, q), p <= q, of a triangle's 6 x 6 block goes, row by row;
        -1 where a degree of freedom is fixed.
    gradient : (n_dofs,) float64
        Overwritten.
    hessian : (n_entries,) float64
        Values of the upper triangle, overwritten.
    """
    gradient[:] = 0.0
    hessian[:] = 0.0
    energy = 0.0
    column = np.empty((2, 3))  # J by columns
    cross = np.empty((3, 3))  # d det / d x_k
    local = np.empty((3, 2, 2))  # (corner, frame axis, degree of freedom)
    mode = np.empty((4, 6))
    dof = np.empty(6, dtype=np.int64)
    eigenvalues = np.empty(4)
    for t in range(faces.shape[0]):
        i, j, k = faces[t, 0], faces[t, 1], faces[t, 2]
        x0, y0, z0 = directions[i, 0], directions[i, 1], directions[i, 2]
        x1, y1, z1 = directions[j, 0], directions[j, 1], directions[j, 2]
        x2, y2, z2 = directions[k, 0], directions[k, 1], directions[k, 2]
        cross[0, 0], cross[0, 1], cross[0, 2] = (
            y1 * z2 - z1 * y2,
            z1 * x2 - x1 * z2,
            x1 * y2 - y1 * x2,
        )
        cross[1, 0], cross[1, 1], cross[1, 2] = (
            y2 * z0 - z2 * y0,
            z2 * x0 - x2 * z0,
            x2 * y0 - y2 * x0,
        )
        cross[2, 0], cross[2, 1], cross[2, 2] = (
            y0 * z1 - z0 * y1,
            z0 * x1 - x0 * z1,
            x0 * y1 - y0 * x1,
        )
        area = areas[t]
        d = 0.5 * (x0 * cross[0, 0] + y0 * cross[0, 1] + z0 * cross[0, 2]) / area
        I = 0.0
        for b in range(2):
            g0, g1, g2 = gradients[t, 0, b], gradients[t, 1, b], gradients[t, 2, b]
            column[b, 0] = g0 * x0 + g1 * x1 + g2 * x2
            column[b, 1] = g0 * y0 + g1 * y1 + g2 * y2
            column[b, 2] = g0 * z0 + g1 * z1 + g2 * z2
            I += column[b, 0] ** 2 + column[b, 1] ** 2 + column[b, 2] ** 2
        psi, by_I, by_d, by_I_d, by_d_d = _psi_derivatives(I, d, weights, epsilon)
        energy += area * psi

        for corner in range(3):
            vertex = faces[t, corner]
            for c in range(2):
                index = dofs[vertex, c]
                dof[2 * corner + c] = index
                if index >= 0:
                    slope = 0.0
                    for a in range(3):
                        by_x = (
                            2.0
                            * area
                            * by_I
                            * (
                                column[0, a] * gradients[t, corner, 0]
                                + column[1, a] * gradients[t, corner, 1]
                            )
                            + 0.5 * by_d * cross[corner, a]
                        )
                        slope += bases[vertex, c, a] * by_x
                    gradient[index] += slope

        # an orthonormal frame (p, q) of the tangent plane at the centroid
        nx, ny, nz = x0 + x1 + x2, y0 + y1 + y2, z0 + z1 + z2
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        nx, ny, nz = nx / length, ny / length, nz / length
        if abs(nx) < 0.8:
            px, py, pz = 1.0 - nx * nx, -nx * ny, -nx * nz
        else:
            px, py, pz = -ny * nx, 1.0 - ny * ny, -ny * nz
        length = np.sqrt(px * px + py * py + pz * pz)
        px, py, pz = px / length, py / length, pz / length
        qx, qy, qz = ny * pz - nz * py, nz * px - nx * pz, nx * py - ny * px
        j00 = px * column[0, 0] + py * column[0, 1] + pz * column[0, 2]
        j01 = px * column[1, 0] + py * column[1, 1] + pz * column[1, 2]
        j10 = qx * column[0, 0] + qy * column[0, 1] + qz * column[0, 2]
        j11 = qx * column[1, 0] + qy * column[1, 1] + qz * column[1, 2]

        # signed singular values J = U diag(s1, s2) V^T, U and V rotations
        sum_cos, dif_cos = 0.5 * (j00 + j11), 0.5 * (j00 - j11)
        dif_sin, sum_sin = 0.5 * (j10 + j01), 0.5 * (j10 - j01)
        s_sum, s_dif = np.hypot(sum_cos, sum_sin), np.hypot(dif_cos, dif_sin)
        s1, s2 = s_sum + s_dif, s_sum - s_dif
        angle_dif, angle_sum = np.arctan2(dif_sin, dif_cos), np.arctan2(sum_sin, sum_cos)
        theta, phi = 0.5 * (angle_sum - angle_dif), 0.5 * (angle_sum + angle_dif)
        cu, su, cv, sv = np.cos(phi), np.sin(phi), np.cos(theta), np.sin(theta)

        # eigenvalues: twist, flip, and the 2 x 2 scaling block
        eigenvalues[0] = 2.0 * by_I + by_d
        eigenvalues[1] = 2.0 * by_I - by_d
        h11 = 2.0 * by_I + 4.0 * by_I_d * s1 * s2 + by_d_d * s2 * s2
        h22 = 2.0 * by_I + 4.0 * by_I_d * s1 * s2 + by_d_d * s1 * s1
        h12 = by_d + 2.0 * by_I_d * (s1 * s1 + s2 * s2) + by_d_d * s1 * s2
        half_sum, half_dif = 0.5 * (h11 + h22), 0.5 * (h11 - h22)
        root = np.hypot(half_dif, h12)
        eigenvalues[2], eigenvalues[3] = half_sum + root, half_sum - root
        alpha = 0.5 * np.arctan2(h12, half_dif)
        ca, sa = np.cos(alpha), np.sin(alpha)
        floor_share = EXACT_FLOOR if epsilon == 0.0 else REGULARISED_FLOOR
        floor = 0.0
        for m in range(4):
            floor += floor_share * abs(eigenvalues[m])

        for corner in range(3):
            vertex = faces[t, corner]
            for c in range(2):
                bx, by, bz = bases[vertex, c, 0], bases[vertex, c, 1], bases[vertex, c, 2]
                local[corner, 0, c] = px * bx + py * by + pz * bz
                local[corner, 1, c] = qx * bx + qy * by + qz * bz
        half = np.sqrt(0.5)
        for m in range(4):
            if m == 0:
                m00, m01, m10, m11 = 0.0, -half, half, 0.0
            elif m == 1:
                m00, m01, m10, m11 = 0.0, half, half, 0.0
            elif m == 2:
                m00, m01, m10, m11 = ca, 0.0, 0.0, sa
            else:
                m00, m01, m10, m11 = -sa, 0.0, 0.0, ca
            # D = U M V^T with V^T = [[cv, -sv], [sv, cv]]
            n00, n01 = cu * m00 - su * m10, cu * m01 - su * m11
            n10, n11 = su * m00 + cu * m10, su * m01 + cu * m11
            d00, d01 = n00 * cv + n01 * sv, n01 * cv - n00 * sv
            d10, d11 = n10 * cv + n11 * sv, n11 * cv - n10 * sv
            scale = np.sqrt(area * max(eigenvalues[m], floor))
            for corner in range(3):
                g0, g1 = gradients[t, corner, 0], gradients[t, corner, 1]
                along = scale * (d00 * g0 + d01 * g1)
                across = scale * (d10 * g0 + d11 * g1)
                mode[m, 2 * corner] = local[corner, 0, 0] * along + local[corner, 1, 0] * across
                mode[m, 2 * corner + 1] = local[corner, 0, 1] * along + local[corner, 1, 1] * across
        entry = 0
        for r in range(6):
            for s in range(r, 6):
                slot = slots[t, entry]
                entry += 1
                if slot >= 0:
                    value = 0.0
                    for m in range(4):
                        value += mode[m, r] * mode[m, s]
                    if r != s and dof[r] == dof[s]:  # two vertices of one rim
                        value *= 2.0
                    hessian[slot] += value
    return energy


@kernel
def tangent_bases(directions: FloatArray, bases: FloatArray) -> None:
    """Fill `bases` (V, 2, 3) with an orthonormal basis of the tangent plane at every direction."""
    for i in range(directions.shape[0]):
        x, y, z = directions[i, 0], directions[i, 1], directions[i, 2]
        if abs(x) < 0.8:
            a, b, c = 1.0 - x * x, -x * y, -x * z
        else:
            a, b, c = -y * x, 1.0 - y * y, -y * z
        length = np.sqrt(a * a + b * b + c * c)
        a, b, c = a / length, b / length, c / length
        bases[i, 0, 0], bases[i, 0, 1], bases[i, 0, 2] = a, b, c
        bases[i, 1, 0], bases[i, 1, 1], bases[i, 1, 2] = y * c - z * b, z * a - x * c, x * b - y * a


@kernel
def largest_step(directions: FloatArray, motion: FloatArray, faces: IntArray) -> float:
    """Return the first step at which a triangle moving along straight lines loses its area.

    The smallest positive root of ``n . (e1 + s f1) x (e2 + s f2)``, n the triangle's centroid: an
    estimate on the sphere, good enough to start a line search that rejects folds anyway.
    """
    best = np.inf
    for t in range(faces.shape[0]):
        i, j, k = faces[t, 0], faces[t, 1], faces[t, 2]
        nx = directions[i, 0] + directions[j, 0] + directions[k, 0]
        ny = directions[i, 1] + directions[j, 1] + directions[k, 1]
        nz = directions[i, 2] + directions[j, 2] + directions[k, 2]
        ex, ey, ez = (
            directions[j, 0] - directions[i, 0],
            directions[j, 1] - directions[i, 1],
            directions[j, 2] - directions[i, 2],
        )
        fx, fy, fz = (
            directions[k, 0] - directions[i, 0],
            directions[k, 1] - directions[i, 1],
            directions[k, 2] - directions[i, 2],
        )
        ux, uy, uz = (
            motion[j, 0] - motion[i, 0],
            motion[j, 1] - motion[i, 1],
            motion[j, 2] - motion[i, 2],
        )
        vx, vy, vz = (
            motion[k, 0] - motion[i, 0],
            motion[k, 1] - motion[i, 1],
            motion[k, 2] - motion[i, 2],
        )
        c = nx * (ey * fz - ez * fy) + ny * (ez * fx - ex * fz) + nz * (ex * fy - ey * fx)
        b = (
            nx * (ey * vz - ez * vy + uy * fz - uz * fy)
            + ny * (ez * vx - ex * vz + uz * fx - ux * fz)
            + nz * (ex * vy - ey * vx + ux * fy - uy * fx)
        )
        a = nx * (uy * vz - uz * vy) + ny * (uz * vx - ux * vz) + nz * (ux * vy - uy * vx)
        discriminant = b * b - 4.0 * a * c
        if discriminant < 0.0:
            continue
        # q = -(b + sign(b) sqrt(.)) / 2; the roots are q / a and c / q
        root = np.sqrt(discriminant)
        q = -0.5 * (b + root) if b >= 0.0 else -0.5 * (b - root)
        if a != 0.0 and q / a > 0.0:
            best = min(best, q / a)
        if q != 0.0 and c / q > 0.0:
            best = min(best, c / q)
    return best
