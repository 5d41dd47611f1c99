"""Whether a base domain can be embedded into: circles apart from each other, on their sides."""

import itertools

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.domain.regions import far_part, part_regions
from ostiform.domain.types import BaseDomain, Circle, Sphere
from ostiform.errors import InputError
from ostiform.surface import Seam, split_ostium_name

# Two circles closer than this leave triangles so thin between them that the worst distortion
# exceeds a hundred (design 2; measured: 0.4 to 1.7 degrees apart gave 387).
LEAST_GAP = float(np.radians(3.0))

# Rounding of angles that were written in degrees and of centres that were normalised.
ANGLE_ROUNDING = 1e-6


def check_domain(domain: BaseDomain) -> None:
    """Refuse a domain whose circles overlap, crowd each other or lie on the wrong side of a seam.

    Circles that bound the same part must be at least 3 degrees apart, and lie at least 3 degrees
    inside the seam their part lies in.

    Raises
    ------
    InputError
        With the first violation: both circles, the gap found and the gap required.
    TopologyError
        If the seams of a component form a cycle.
    """
    names = [name for sphere in domain.spheres for name in sphere.curves]
    doubled = sorted({name for name in names if names.count(name) > 1})
    if doubled:
        raise InputError(f"base domain: expected every circle once, found {doubled[0]} twice")
    for sphere in domain.spheres:
        check_sphere(sphere)


def check_sphere(sphere: Sphere) -> None:
    """Refuse one component sphere; errors as in `check_domain`."""
    for name, circle in sphere.curves.items():
        most = np.pi if name not in sphere.rims else np.pi / 2
        if not 0.0 < circle.radius < most:
            raise InputError(
                f"circle {name}: expected a radius between 0 and {np.degrees(most):g} degrees, "
                f"found {np.degrees(circle.radius):g}"
            )
    _check_pole_and_handles(sphere)
    regions = part_regions(sphere.parts, tuple(sphere.rims), tuple(sphere.seams), sphere.pole)
    for part, region in regions.items():
        holes = {
            name: (sphere.rims[name].center, sphere.rims[name].radius) for name in region.curves
        }
        for seam in region.further_seams:
            holes[seam.first] = cap_of_seam(seam, sphere.seams[seam], far_part(seam, regions))
        for (one, hole), (other, second) in itertools.combinations(holes.items(), 2):
            gap = angle_between(hole[0], second[0]) - hole[1] - second[1]
            _refuse_gap(one, other, gap)
        if region.container is None:
            continue
        seam = region.container
        container = cap_of_seam(seam, sphere.seams[seam], part)
        for name, hole in holes.items():
            gap = container[1] - hole[1] - angle_between(hole[0], container[0])
            _refuse_gap(name, seam.first, gap, f" with {name} on {part}'s side")


def cap_of_seam(seam: Seam, circle: Circle, part: str) -> tuple[FloatArray, float]:
    """Return centre (3,) and angular radius of the side of a seam's circle that one part is on."""
    if split_ostium_name(seam.second)[0] == part:
        return circle.center, circle.radius
    opposite: FloatArray = -circle.center
    return opposite, float(np.pi - circle.radius)


def angle_between(one: FloatArray, other: FloatArray) -> float:
    """Return the angle in radians between two unit vectors, accurate near 0 and pi."""
    return float(2.0 * np.arctan2(np.linalg.norm(one - other), np.linalg.norm(one + other)))


def _refuse_gap(one: str, other: str, gap: float, side: str = "") -> None:
    if gap < LEAST_GAP - ANGLE_ROUNDING:
        found = f"{-np.degrees(gap):.3g} of overlap" if gap < 0 else f"{np.degrees(gap):.3g}"
        raise InputError(
            f"circles {one} and {other}: expected a gap of at least {np.degrees(LEAST_GAP):g} "
            f"degrees{side}, found {found}: move them apart, make one smaller, or leave them to "
            "the automatic layout"
        )


def _check_pole_and_handles(sphere: Sphere) -> None:
    sides = [name for seam in sphere.seams for name in (seam.first, seam.second)]
    known = [*sphere.rims, *sides]
    if sphere.pole is not None and sphere.pole not in known:
        raise InputError(
            f"pole of {sphere.name}: expected one of {', '.join(known) or 'no ostium'}, "
            f"found {sphere.pole}"
        )
    for handle in sphere.handles:
        missing = [name for name in (handle.first, handle.second) if name not in sphere.rims]
        if missing:
            raise InputError(
                f"handle {handle.first} = {handle.second}: expected a circle for both sides, "
                f"found none for {missing[0]}"
            )
