"""The paper's picture of a seam: two unit spheres that touch along it round their north poles.

HY 2.1 and Fig. 1 (c): each part has its own sphere, trimmed by a cap about its north pole whose
edge is the mitral contour. Stereographically (``z = (x + i y) / (1 - z)`` from the north pole)
the trimmed spheres are the discs ``|z| < R_a`` and ``|w| < R_b``, ``R = cot(rim radius / 2)``.
Glued by ``zeta = z / R_a`` and ``zeta = R_b / w`` they are one sphere, the component sphere, with
the contour as its equator, the first part in z < 0 and the second in z > 0. Both maps are
Moebius maps: they carry circles to circles, but centres and radii do not carry over.
"""

from typing import Literal, TypeAlias

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.domain.checks import cap_of_seam
from ostiform.domain.regions import equator_seam, part_regions
from ostiform.domain.types import Circle, Sphere
from ostiform.errors import InputError
from ostiform.surface import normalised, rotation_between, stereographic

SeamSide: TypeAlias = Literal["first", "second"]

# Angular radius of the contour about the north pole of each part's sphere, as in HY Fig. 1 (c).
DEFAULT_RIM_RADIUS = float(np.radians(30.0))

SOUTH = np.array([0.0, 0.0, -1.0])


def to_part_sphere(
    directions: FloatArray, side: SeamSide, rim_radius: float = DEFAULT_RIM_RADIUS
) -> FloatArray:
    """Carry unit vectors of the component sphere to the unit sphere of one part.

    Parameters
    ----------
    directions : (n, 3) float64
        On the component sphere; the equator goes to the circle of `rim_radius` about the north
        pole, the part's half to what lies outside it.
    side : {"first", "second"}
        Which part of the seam: the first is z < 0, the second z > 0.
    rim_radius : float
        Angular radius of the contour on the part's sphere, radians.

    Raises
    ------
    InputError
        If the side is unknown, or the radius not between 0 and pi.
    """
    factor = 1.0 / np.tan(_checked_rim(rim_radius) / 2.0)
    return _scaled(_turned(directions, side), factor)


def from_part_sphere(
    directions: FloatArray, side: SeamSide, rim_radius: float = DEFAULT_RIM_RADIUS
) -> FloatArray:
    """Carry unit vectors of a part's sphere to the component sphere: undoes `to_part_sphere`."""
    factor = np.tan(_checked_rim(rim_radius) / 2.0)
    return _turned(_scaled(directions, factor), side)


def circle_to_part_sphere(
    circle: Circle, side: SeamSide, rim_radius: float = DEFAULT_RIM_RADIUS
) -> Circle:
    """Carry a circle of the component sphere to a part's sphere, its phase point included."""
    points = to_part_sphere(_points_to_refit(circle), side, rim_radius)
    return _refitted(points)


def circle_from_part_sphere(
    circle: Circle, side: SeamSide, rim_radius: float = DEFAULT_RIM_RADIUS
) -> Circle:
    """Carry a circle of a part's sphere to the component sphere, its phase point included."""
    points = from_part_sphere(_points_to_refit(circle), side, rim_radius)
    return _refitted(points)


def stereographic_view(sphere: Sphere, part: str, directions: FloatArray) -> FloatArray:
    """Project directions of one part's region to the plane, as HY Fig. 2.

    From the centre of the circle that surrounds the part (the seam it lies in, else the pole's
    rim): that circle becomes the unit circle and the part fills the disc inside it. Without
    either, from the north pole with the equator as unit circle. Orientation is as seen from
    outside the surface.

    Parameters
    ----------
    sphere : Sphere
        The component sphere.
    part : str
    directions : (n, 3) float64
        Unit vectors, none at the centre of projection.

    Returns
    -------
    view : (n, 2) float64

    Raises
    ------
    InputError
        If the part is not one of the component's.
    """
    if part not in sphere.parts:
        raise InputError(
            f"view of {sphere.name}: expected one of the parts {', '.join(sphere.parts)}, "
            f"found {part}"
        )
    center, radius = _surrounding(sphere, part)
    turned = directions @ rotation_between(center, SOUTH).T
    # Seen from outside, the plane's second axis is turned over: azimuth runs clockwise from above.
    zeta = np.conj(stereographic(turned)) / np.tan(radius / 2.0)
    return np.stack([zeta.real, zeta.imag], axis=1)


def _surrounding(sphere: Sphere, part: str) -> tuple[FloatArray, float]:
    """Return centre and radius of the smallest cap of circles that holds the part."""
    region = part_regions(sphere.parts, tuple(sphere.rims), tuple(sphere.seams), sphere.pole)[part]
    if region.container is not None:
        return cap_of_seam(region.container, sphere.seams[region.container], part)
    if sphere.pole is not None and equator_seam(tuple(sphere.seams), sphere.pole) is None:
        rim = sphere.rims[sphere.pole]
        opposite: FloatArray = -rim.center
        return opposite, float(np.pi - rim.radius)
    return SOUTH, np.pi / 2


def _checked_rim(rim_radius: float) -> float:
    if not 0.0 < rim_radius < np.pi:
        raise InputError(
            f"contour of the touching spheres: expected a radius between 0 and 180 degrees, found "
            f"{np.degrees(rim_radius):g}"
        )
    return rim_radius


def _turned(directions: FloatArray, side: SeamSide) -> FloatArray:
    """Apply ``zeta -> 1 / zeta`` for the second part: half a turn about x."""
    if side == "first":
        return directions
    if side == "second":
        turned: FloatArray = directions * np.array([1.0, -1.0, -1.0])
        return turned
    raise InputError(f'side of the seam: expected "first" or "second", found "{side}"')


def _scaled(directions: FloatArray, factor: float) -> FloatArray:
    """Apply ``zeta -> factor zeta`` to unit vectors, the poles included.

    With ``|zeta|^2 = (1 + z) / (1 - z)``: the homogeneous pair (1 + z, 1 - z) becomes
    (factor^2 (1 + z), 1 - z), and x, y are scaled by 2 factor over its sum.
    """
    above = factor**2 * (1.0 + directions[..., 2])
    below = 1.0 - directions[..., 2]
    total = above + below
    return normalised(
        np.stack(
            [
                2.0 * factor * directions[..., 0] / total,
                2.0 * factor * directions[..., 1] / total,
                (above - below) / total,
            ],
            axis=-1,
        )
    )


def _points_to_refit(circle: Circle) -> FloatArray:
    """Return a point inside the circle, then three on it, the first at its phase."""
    angles = circle.phase + np.array([0.0, 2.0, 4.0]) * np.pi / 3.0
    return np.vstack([circle.center, circle.points(angles)])


def _refitted(points: FloatArray) -> Circle:
    """Return the circle through three points on it that has the first point, (4, 3), inside."""
    inside, rim = points[0], points[1:]
    normal = normalised(np.cross(rim[1] - rim[0], rim[2] - rim[0]))
    height = float(np.mean(rim @ normal))
    if inside @ normal < height:
        normal, height = -normal, -height
    across = float(np.mean(np.linalg.norm(rim - height * normal, axis=1)))
    unphased = Circle(normal, float(np.arctan2(across, height)))
    return Circle(normal, unphased.radius, float(unphased.angles(rim[:1])[0]))
