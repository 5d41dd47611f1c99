"""Diffeomorphisms of space in closed form, with their Jacobians and inverses.

`Affine` and `Axial` invert in closed form or in one dimension, `TubeWarp` and `Bumps` by Newton's
method, which converges because their displacements are contractions or nearly so.
"""

from dataclasses import field
from typing import Annotated, TypeAlias

import numpy as np
from scipy.interpolate import CubicSpline

from ostiform.arrays import FloatArray, frozen_floats
from ostiform.compiled import kernel
from ostiform.demo.inversion import INVERSE_TOLERANCE_MM, MAX_NEWTON_STEPS, newton_inverse
from ostiform.errors import ConvergenceError, InputError
from ostiform.values import Axes, value


@value
class Affine:
    """x -> matrix x + shift.

    Attributes
    ----------
    matrix : (3, 3) float64
        Positive determinant.
    shift : (3,) float64, mm
    """

    matrix: Annotated[FloatArray, Axes(3, 3)]
    shift: Annotated[FloatArray, Axes(3)]

    def __post_init__(self) -> None:
        """Check the orientation."""
        if np.linalg.det(self.matrix) <= 0.0:
            raise InputError(
                f"affine map: expected a positive determinant, found "
                f"{np.linalg.det(self.matrix):.3g}; give a matrix that keeps orientation"
            )

    def forward(self, points: FloatArray) -> FloatArray:
        """Return the images (n, 3)."""
        return points @ self.matrix.T + self.shift

    def linearised(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the images (n, 3) and the derivatives (n, 3, 3)."""
        return self.forward(points), np.broadcast_to(self.matrix, (len(points), 3, 3))

    def inverse(self, points: FloatArray) -> FloatArray:
        """Return the points (n, 3) whose images are given."""
        return (points - self.shift) @ np.linalg.inv(self.matrix).T


@value
class Axial:
    """Each plane of constant z is scaled and turned about an axis and displaced.

    Between the knots the profiles are clamped cubic splines, beyond them they are constant. The
    map is a diffeomorphism when z + displacement_z(z) increases, which construction checks.

    Attributes
    ----------
    axis_point : (2,) float64, mm
        x, y of the axis.
    knots : (K,) float64, mm
        Increasing heights z.
    displacement : (K, 3) float64, mm
    log_scale : (K, 2) float64
        Logarithm of the scaling in x and y.
    turn : (K,) float64, radians
    """

    axis_point: Annotated[FloatArray, Axes(2)]
    knots: Annotated[FloatArray, Axes("K")]
    displacement: Annotated[FloatArray, Axes("K", 3)]
    log_scale: Annotated[FloatArray, Axes("K", 2)]
    turn: Annotated[FloatArray, Axes("K")]
    _profiles: CubicSpline = field(init=False, repr=False)  # of all six, one column each

    def __post_init__(self) -> None:
        """Lay out the profiles, and check that heights keep their order."""
        table = np.column_stack([self.displacement, self.log_scale, self.turn])  # (K, 6)
        profiles = CubicSpline(self.knots, table, bc_type="clamped")
        object.__setattr__(self, "_profiles", profiles)
        heights = np.linspace(self.knots[0], self.knots[-1], 64 * len(self.knots))
        rise = 1.0 + profiles(heights, 1)[:, 2]
        if rise.min() <= 0.0:
            raise InputError(
                f"axial map: expected heights to keep their order, found a slope of "
                f"{rise.min():.3g}; reduce the displacement along z"
            )

    def forward(self, points: FloatArray) -> FloatArray:
        """Return the images (n, 3)."""
        return self.linearised(points)[0]

    def linearised(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the images (n, 3) and the derivatives (n, 3, 3)."""
        profile, slope = self._at(points[:, 2])
        scale, turn = np.exp(profile[:, 3:5]), profile[:, 5]
        u, v = (scale * (points[:, :2] - self.axis_point)).T
        du, dv = u * slope[:, 3], v * slope[:, 4]
        cos, sin = np.cos(turn), np.sin(turn)
        turned = np.stack(
            [
                cos * u - sin * v + self.axis_point[0],
                sin * u + cos * v + self.axis_point[1],
                points[:, 2],
            ],
            axis=1,
        )
        result = np.zeros((len(points), 3, 3))
        result[:, 0, 0] = cos * scale[:, 0]
        result[:, 0, 1] = -sin * scale[:, 1]
        result[:, 1, 0] = sin * scale[:, 0]
        result[:, 1, 1] = cos * scale[:, 1]
        result[:, 0, 2] = cos * du - sin * dv - slope[:, 5] * (sin * u + cos * v) + slope[:, 0]
        result[:, 1, 2] = sin * du + cos * dv + slope[:, 5] * (cos * u - sin * v) + slope[:, 1]
        result[:, 2, 2] = 1.0 + slope[:, 2]
        return turned + profile[:, :3], result

    def inverse(self, points: FloatArray) -> FloatArray:
        """Return the points (n, 3) whose images are given."""
        table = np.linspace(self.knots[0], self.knots[-1], 256)
        images = table + self._at(table)[0][:, 2]
        z = np.interp(points[:, 2], images, table)
        below, above = points[:, 2] < images[0], points[:, 2] > images[-1]
        z = np.where(below, points[:, 2] - images[0] + table[0], z)
        z = np.where(above, points[:, 2] - images[-1] + table[-1], z)
        rise = CubicSpline(self.knots, self.displacement[:, 2], bc_type="clamped")
        for _ in range(MAX_NEWTON_STEPS):
            inside = np.clip(z, self.knots[0], self.knots[-1])
            slope = np.where(z == inside, rise(inside, 1), 0.0)
            step = (z + rise(inside) - points[:, 2]) / (1.0 + slope)
            z = z - step
            if np.abs(step).max(initial=0.0) < INVERSE_TOLERANCE_MM:
                break
        else:
            raise ConvergenceError(
                f"axial map: expected the inverse within {MAX_NEWTON_STEPS} Newton steps, found a "
                f"last step of {np.abs(step).max():.3g} mm; reduce the displacement along z"
            )
        profile, _ = self._at(z)
        a, b = (points[:, :2] - profile[:, :2] - self.axis_point).T
        cos, sin = np.cos(profile[:, 5]), np.sin(profile[:, 5])
        flat = np.stack([cos * a + sin * b, cos * b - sin * a], axis=1) / np.exp(profile[:, 3:5])
        return np.column_stack([flat + self.axis_point, z])

    def _at(self, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        inside = np.clip(z, self.knots[0], self.knots[-1])
        slope = self._profiles(inside, 1)
        slope[(z < self.knots[0]) | (z > self.knots[-1])] = 0.0
        return self._profiles(inside), slope


@value
class TubeWarp:
    """Length, direction and calibre of a tube changed by deforming the space round it.

    With t the distance along the axis and r from it, the displacement is
    ``w(r) (ramp(t) reach + widening step(t) (x - axis))``: w is 1 up to `inner_radius` and
    falls to 0 at `outer_radius`, the ramp rises from 0 at t = 0 to 1 at t = `length` and beyond.

    Attributes
    ----------
    base : (3,) float64, mm
    axis : (3,) float64
        Unit vector.
    length : float, mm
    inner_radius, outer_radius : float, mm
    reach : (3,) float64, mm
        Displacement of the tube's end: along the axis its lengthening, across it its bending.
    widening : float
        Relative change of the radius.
    """

    base: Annotated[FloatArray, Axes(3)]
    axis: Annotated[FloatArray, Axes(3)]
    length: float
    inner_radius: float
    outer_radius: float
    reach: Annotated[FloatArray, Axes(3)]
    widening: float

    def __post_init__(self) -> None:
        """Normalise the axis and check the radii."""
        axis = frozen_floats(self.axis / np.linalg.norm(self.axis), (3,), "tube axis")
        object.__setattr__(self, "axis", axis)
        if not 0.0 < self.inner_radius < self.outer_radius:
            raise InputError(
                f"tube warp: expected 0 < inner radius < outer radius, found {self.inner_radius} "
                f"and {self.outer_radius}; set the outer radius larger"
            )

    def forward(self, points: FloatArray) -> FloatArray:
        """Return the images (n, 3)."""
        return points + self._displacement(points)[0]

    def linearised(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the images (n, 3) and the derivatives (n, 3, 3)."""
        value, slope = self._displacement(points)
        return points + value, np.eye(3) + slope

    def inverse(self, points: FloatArray) -> FloatArray:
        """Return the points (n, 3) whose images are given."""
        return newton_inverse(self._displacement, points, "tube warp")

    def _displacement(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        return _tube_displacement(
            np.ascontiguousarray(points),
            np.stack([self.base, self.axis, self.reach]),
            (self.length, self.inner_radius, self.outer_radius, self.widening),
        )


@value
class Bumps:
    """Regional displacements: x + sum_k d_k (1 - |x - c_k|^2 / s_k^2)^4 inside |x - c_k| < s_k.

    Attributes
    ----------
    centers : (K, 3) float64, mm
    radii : (K,) float64, mm
    displacements : (K, 3) float64, mm
    """

    centers: Annotated[FloatArray, Axes("K", 3)]
    radii: Annotated[FloatArray, Axes("K")]
    displacements: Annotated[FloatArray, Axes("K", 3)]

    def forward(self, points: FloatArray) -> FloatArray:
        """Return the images (n, 3)."""
        return points + self._displacement(points)[0]

    def linearised(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the images (n, 3) and the derivatives (n, 3, 3)."""
        value, slope = self._displacement(points)
        return points + value, np.eye(3) + slope

    def inverse(self, points: FloatArray) -> FloatArray:
        """Return the points (n, 3) whose images are given."""
        return newton_inverse(self._displacement, points, "regional displacements")

    def _displacement(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        return _bump_displacement(
            np.ascontiguousarray(points), self.centers, self.radii, self.displacements
        )


SpaceMap: TypeAlias = Affine | Axial | TubeWarp | Bumps
"""An invertible smooth map of space: images, derivatives and inverses of points (n, 3) in mm."""


@kernel
def _bump_displacement(
    points: FloatArray, centers: FloatArray, radii: FloatArray, displacements: FloatArray
) -> tuple[FloatArray, FloatArray]:
    value = np.zeros((len(points), 3))
    slope = np.zeros((len(points), 3, 3))
    for i in range(len(points)):
        for k in range(len(centers)):
            dx = points[i, 0] - centers[k, 0]
            dy = points[i, 1] - centers[k, 1]
            dz = points[i, 2] - centers[k, 2]
            rest = 1.0 - (dx * dx + dy * dy + dz * dz) / radii[k] ** 2
            if rest <= 0.0:
                continue
            cube = rest * rest * rest
            factor = -8.0 / radii[k] ** 2 * cube
            for j in range(3):
                d = displacements[k, j]
                value[i, j] += cube * rest * d
                slope[i, j, 0] += d * factor * dx
                slope[i, j, 1] += d * factor * dy
                slope[i, j, 2] += d * factor * dz
    return value, slope


@kernel
def _tube_displacement(
    points: FloatArray, vectors: FloatArray, sizes: tuple[float, float, float, float]
) -> tuple[FloatArray, FloatArray]:
    length, inner, outer, widening = sizes
    base, axis, reach = vectors[0], vectors[1], vectors[2]
    value = np.zeros((len(points), 3))
    slope = np.zeros((len(points), 3, 3))
    across = np.empty(3)
    for i in range(len(points)):
        t = r = 0.0
        for k in range(3):
            t += (points[i, k] - base[k]) * axis[k]
        for k in range(3):
            across[k] = points[i, k] - base[k] - t * axis[k]
            r += across[k] ** 2
        r = np.sqrt(r)
        if t <= 0.0 or r >= outer:
            continue
        fall, fall_slope = _step((r - inner) / (outer - inner))
        near, near_slope = 1.0 - fall, -fall_slope / (outer - inner)
        ramp, ramp_slope = _ramp(t, length)
        rise, rise_slope = _step(t / (0.6 * length))
        rise_slope = rise_slope / (0.6 * length)
        for j in range(3):
            pull = ramp * reach[j] + widening * rise * across[j]
            along = ramp_slope * reach[j] + widening * rise_slope * across[j]
            value[i, j] = near * pull
            for k in range(3):
                flat = (1.0 if j == k else 0.0) - axis[j] * axis[k]
                slope[i, j, k] = near_slope * pull * across[k] / max(r, 1e-12)
                slope[i, j, k] += near * (along * axis[k] + widening * rise * flat)
    return value, slope


@kernel
def _step(u: float) -> tuple[float, float]:
    # Quintic smooth step from 0 at u = 0 to 1 at u = 1, and its slope.
    u = min(max(u, 0.0), 1.0)
    return u**3 * (10.0 + u * (6.0 * u - 15.0)), 30.0 * u**2 * (1.0 - u) ** 2


@kernel
def _ramp(t: float, length: float) -> tuple[float, float]:
    # Slope 1 / length from about t = length / 3 to t = length, then level: the difference of two
    # integrated smooth steps.
    width = length / 3.0
    rise, rise_slope = _integrated_step(t / width)
    stop, stop_slope = _integrated_step((t - length) / width)
    return (rise - stop) * width / length, (rise_slope - stop_slope) / length


@kernel
def _integrated_step(u: float) -> tuple[float, float]:
    inside = min(max(u, 0.0), 1.0)
    integral = inside**4 * (2.5 + inside * (inside - 3.0)) + max(u - 1.0, 0.0)
    return integral, _step(u)[0]
