"""Implicit bodies with known openings: smooth unions of ellipsoids and tapered tubes.

A body is described once, in *material* coordinates; the shapes of a population with known
correspondence are its images under diffeomorphisms of space (`deformation`).
"""

from collections.abc import Mapping
from dataclasses import field
from typing import Annotated

import numpy as np

from ostiform.arrays import BoolArray, FloatArray, frozen_floats
from ostiform.compiled import kernel
from ostiform.errors import InputError
from ostiform.values import Axes, value

_SMALLEST_NORM = 1e-12
"""Lengths below this are the centre or the axis of a primitive, where its gradient is undefined."""


@value
class Ellipsoid:
    """A solid ellipsoid, its distance exact to first order at the surface.

    With k0 = |q|, k1 = |q / semi_axes|, q the point in units of the semi-axes, the signed
    distance is taken as k0 (k0 - 1) / k1.

    Attributes
    ----------
    center : (3,) float64, mm
    semi_axes : (3,) float64, mm
    frame : (3, 3) float64
        Rotation whose columns are the directions of the semi-axes.
    """

    center: Annotated[FloatArray, Axes(3)]
    semi_axes: Annotated[FloatArray, Axes(3)]
    frame: Annotated[FloatArray, Axes(3, 3)]

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Return the corners (3,), (3,) of the axis-aligned box round the ellipsoid."""
        reach = np.sqrt(((self.frame * self.semi_axes) ** 2).sum(axis=1))
        return self.center - reach, self.center + reach


@value
class Tube:
    """A straight tube with round ends, its radius linear between two points.

    The signed distance is taken as that to the axis less the local radius.

    Attributes
    ----------
    start, end : (3,) float64, mm
    start_radius, end_radius : float, mm
    """

    start: Annotated[FloatArray, Axes(3)]
    end: Annotated[FloatArray, Axes(3)]
    start_radius: float
    end_radius: float

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Return the corners (3,), (3,) of the axis-aligned box round the tube."""
        return (
            np.minimum(self.start - self.start_radius, self.end - self.end_radius),
            np.maximum(self.start + self.start_radius, self.end + self.end_radius),
        )


@value
class Cut:
    """A surface that opens a body, or divides it into two parts that share a seam.

    The cutting surface is the plane through `center` across `normal`, raised by
    ``saddle_mm (u^2 - v^2) / radius_mm^2`` with u along `saddle_axis`; it acts within a ball of
    radius `radius_mm` round the centre.

    Attributes
    ----------
    first : str
        The ostium on the near side (against the normal), ``"PART.OSTIUM"``.
    second : str or None
        The ostium on the far side when the cut is a seam; None when the far side is dropped.
    center : (3,) float64, mm
    normal : (3,) float64
        Unit vector out of the first part.
    radius_mm : float
    saddle_axis : (3,) float64
        Unit vector across the normal.
    saddle_mm : float
    """

    first: str
    second: str | None
    center: Annotated[FloatArray, Axes(3)]
    normal: Annotated[FloatArray, Axes(3)]
    radius_mm: float
    saddle_axis: Annotated[FloatArray, Axes(3)]
    saddle_mm: float = 0.0

    def __post_init__(self) -> None:
        """Normalise the directions."""
        normal = self.normal / np.linalg.norm(self.normal)
        axis = self.saddle_axis - (self.saddle_axis @ normal) * normal
        length = np.linalg.norm(axis)
        if length < _SMALLEST_NORM:
            raise InputError(
                f"cut {self.first}: expected a saddle axis across the normal, found one along it; "
                "give another axis"
            )
        object.__setattr__(self, "normal", frozen_floats(normal, (3,), "cut normal"))
        object.__setattr__(self, "saddle_axis", frozen_floats(axis / length, (3,), "saddle axis"))

    def height(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the height over the cutting surface (n,), mm, and its gradient (n, 3)."""
        offset = points - self.center
        other = np.cross(self.normal, self.saddle_axis)
        u, v = offset @ self.saddle_axis, offset @ other
        rise = self.saddle_mm / self.radius_mm**2
        value = offset @ self.normal - rise * (u**2 - v**2)
        tilt = u[:, None] * self.saddle_axis - v[:, None] * other
        return value, self.normal - 2.0 * rise * tilt

    def reaches(self, points: FloatArray) -> BoolArray:
        """Return which points (n,) lie in the ball where the cut acts."""
        offset = points - self.center
        within: BoolArray = np.einsum("ij,ij->i", offset, offset) < self.radius_mm**2
        return within


@value
class Anatomy:
    """A body {f < 0} in material coordinates, its cuts, and the parts these divide it into.

    Attributes
    ----------
    primitives : tuple of Ellipsoid or Tube
    blend_mm : float
        Length over which primitives melt into each other.
    cuts : tuple of Cut
    seeds : mapping of str to (3,) float64, mm
        For each part a point near its surface and far from the cuts.
    """

    primitives: tuple[Ellipsoid | Tube, ...]
    blend_mm: float
    cuts: tuple[Cut, ...]
    seeds: Mapping[str, Annotated[FloatArray, Axes(3)]]
    _tables: tuple[FloatArray, FloatArray, FloatArray] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Check the names and lay the primitives out for `level`."""
        ellipsoids = [p for p in self.primitives if isinstance(p, Ellipsoid)]
        tubes = [p for p in self.primitives if isinstance(p, Tube)]
        tables = (
            np.array([np.r_[p.center, p.semi_axes] for p in ellipsoids]).reshape(-1, 6),
            np.array([p.frame for p in ellipsoids]).reshape(-1, 3, 3),
            np.array([np.r_[p.start, p.end, p.start_radius, p.end_radius] for p in tubes]).reshape(
                -1, 8
            ),
        )
        object.__setattr__(self, "_tables", tables)
        for cut in self.cuts:
            for ostium in (cut.first, cut.second):
                if ostium is not None and ostium.partition(".")[0] not in self.seeds:
                    raise InputError(
                        f"cut {ostium}: expected an ostium of one of the parts "
                        f"{', '.join(self.seeds)}; name it PART.OSTIUM"
                    )

    def level(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return f (n,), close to a signed distance in mm, and its gradient (n, 3).

        f = -k log sum_i exp(-f_i / k), a smooth minimum of the primitives, k = `blend_mm`.
        """
        return _blended(
            np.ascontiguousarray(points, dtype=np.float64), *self._tables, self.blend_mm
        )

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Return the corners (3,), (3,) of a box that holds the body."""
        corners = [primitive.bounds() for primitive in self.primitives]
        margin = self.blend_mm * np.log(len(corners)) + self.blend_mm
        low = np.min([low for low, _ in corners], axis=0) - margin
        high = np.max([high for _, high in corners], axis=0) + margin
        return low, high

    def part_cuts(self, part: str) -> tuple[tuple[str, float, Cut], ...]:
        """Return (ostium, sign, cut) of each opening of a part; sign * height > 0 is outside it."""
        found = []
        for cut in self.cuts:
            for name, sign in ((cut.first, 1.0), (cut.second, -1.0)):
                if name is not None and name.partition(".")[0] == part:
                    found.append((name.partition(".")[2], sign, cut))
        return tuple(found)


@kernel
def _blended(
    points: FloatArray,
    ellipsoids: FloatArray,
    frames: FloatArray,
    tubes: FloatArray,
    blend: float,
) -> tuple[FloatArray, FloatArray]:
    # -k log sum exp(-f_i / k) and its gradient, the mean of theirs with weights exp(-f_i / k).
    count = len(ellipsoids) + len(tubes)
    value = np.empty(len(points))
    gradient = np.zeros((len(points), 3))
    f = np.empty(count)
    df = np.empty((count, 3))
    for i in range(len(points)):
        least = np.inf
        for k in range(count):
            if k < len(ellipsoids):
                f[k] = _ellipsoid_distance(points[i], ellipsoids[k], frames[k], df[k])
            else:
                f[k] = _tube_distance(points[i], tubes[k - len(ellipsoids)], df[k])
            least = min(least, f[k])
        total = 0.0
        for k in range(count):
            if f[k] - least > 40.0 * blend:  # its weight is below round-off
                continue
            weight = np.exp((least - f[k]) / blend)
            total += weight
            for j in range(3):
                gradient[i, j] += weight * df[k, j]
        value[i] = least - blend * np.log(total)
        for j in range(3):
            gradient[i, j] /= total
    return value, gradient


@kernel
def _ellipsoid_distance(
    point: FloatArray, shape: FloatArray, frame: FloatArray, slope: FloatArray
) -> float:
    k0 = k1 = 0.0
    for j in range(3):
        local = 0.0
        for m in range(3):
            local += (point[m] - shape[m]) * frame[m, j]
        q = local / shape[3 + j]
        slope[j] = q
        k0 += q * q
        k1 += (q / shape[3 + j]) ** 2
    k0 = max(np.sqrt(k0), _SMALLEST_NORM)
    k1 = max(np.sqrt(k1), _SMALLEST_NORM)
    value = k0 * (k0 - 1.0) / k1
    first = (2.0 * k0 - 1.0) / (k0 * k1)
    a = slope[0] / shape[3] * (first - value / (k1 * shape[3]) ** 2)
    b = slope[1] / shape[4] * (first - value / (k1 * shape[4]) ** 2)
    c = slope[2] / shape[5] * (first - value / (k1 * shape[5]) ** 2)
    for j in range(3):
        slope[j] = frame[j, 0] * a + frame[j, 1] * b + frame[j, 2] * c
    return float(value)


@kernel
def _tube_distance(point: FloatArray, tube: FloatArray, slope: FloatArray) -> float:
    along = length = 0.0
    for j in range(3):
        axis = tube[3 + j] - tube[j]
        along += (point[j] - tube[j]) * axis
        length += axis * axis
    share = along / length
    inside = 0.0 < share < 1.0
    share = min(max(share, 0.0), 1.0)
    distance = 0.0
    for j in range(3):
        slope[j] = point[j] - tube[j] - share * (tube[3 + j] - tube[j])
        distance += slope[j] ** 2
    distance = max(np.sqrt(distance), _SMALLEST_NORM)
    growth = tube[7] - tube[6]
    tilt = growth / length if inside else 0.0
    for j in range(3):
        slope[j] = slope[j] / distance - tilt * (tube[3 + j] - tube[j])
    return float(distance - (tube[6] + share * growth))
