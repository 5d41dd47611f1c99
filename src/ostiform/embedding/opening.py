"""Carry the holes of a flat disc to their circles and open them (design 3, step 2).

The flow is a diffeomorphism; the opening is a homeomorphism of each hole's cell: the logarithm of
the distance to the hole's centre is mapped linearly (constant dilatation, a Teichmueller-like
stretch) and the angle is blended from the rim's arc length to the identity at the cell's border.
What little folds, folds because triangles stay straight.
"""

from dataclasses import dataclass, replace

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.compiled import kernel
from ostiform.domain import Circle
from ostiform.embedding.disc import (
    ComplexArray,
    Disc,
    arc_length_angles,
    plane_circle,
    pole_frame,
    tutte_disc,
)
from ostiform.surface import inverse_stereographic, stereographic, vertex_areas

# Share of the gap between a hole and the outer circle that the hole's cell takes.
CELL_SHARE = 0.9

# Width of the layer below the border where the stretch sets in, as a share of the depth.
SMOOTHING_SHARE = 0.4

# Most RK4 steps of the flow, and least width of its kernels as a share of the holes' distance from
# the centre.
MAX_FLOW_STEPS = 600
LEAST_WIDTH = 0.01

# Holes whose kernels keep this share of their width at the ends go straight; else one of the bows
# is tried.
CLEARANCE = 0.4
BOWS = (0.7, -0.7, 1.4, -1.4)

# A disc is spread where its middle has to be enlarged more than this, or is further from the
# centre than this share of the radius.
CROWDED = 3.0
OFF_CENTRE = 0.4
LARGEST_SHIFT = 0.95
# Largest share of the disc's radius that the middle may have, before and after.
LARGEST_CORE = 0.6


@dataclass(frozen=True, slots=True, eq=False)
class OpenedDisc:
    """The steps from Tutte's embedding to a map with every rim on its circle.

    Attributes
    ----------
    tutte : (V, 3) float64
        Unit vectors: the hole-filled embedding, an embedding.
    opened : (V, 3) float64
        Holes on their circles, rims at the angles that they have in the plane.
    arc_length : (V, 3) float64
        The same with the rims at arc length, the best rotation, no winding.
    """

    tutte: FloatArray
    opened: FloatArray
    arc_length: FloatArray


def opened_disc(disc: Disc, outer_directions: FloatArray | None = None) -> OpenedDisc:
    """Map a part to the outside of its circles.

    Parameters
    ----------
    disc : Disc
    outer_directions : (n, 3) float64, optional
        Where the outer loop is; by arc length on its circle, turned so that the holes come
        closest to their circles, by default.
    """
    frame = pole_frame(disc.outer.circle)
    outer_radius = 1.0 / np.tan(0.5 * disc.outer.circle.radius)
    images = [plane_circle(hole.circle, frame) for hole in disc.holes]
    targets = np.array([center for center, _ in images], dtype=np.complex128)
    radii = np.array([radius for _, radius in images])
    if outer_directions is None:
        azimuth = -arc_length_angles(disc.vertices, disc.outer.loop)
    else:
        turned = outer_directions @ frame.T
        azimuth = np.arctan2(turned[:, 1], turned[:, 0])
    tutte, apexes = tutte_disc(disc, azimuth)
    zeta, apexes = _spread(disc, tutte, apexes, outer_radius)
    if outer_directions is None and len(apexes):
        turn = np.exp(1j * np.angle(np.sum(targets * np.conj(apexes))))
        tutte, zeta, apexes = tutte * turn, zeta * turn, apexes * turn
    elif len(apexes):
        zeta, apexes = _swirled(zeta, apexes, targets, outer_radius)
    zeta, apexes = _flowed(zeta, apexes, targets, outer_radius)
    opened = zeta.copy()
    arc_length = zeta.copy()
    reach = [float(np.abs(zeta[h.loop] - a).max()) for h, a in zip(disc.holes, apexes, strict=True)]
    extents = np.maximum(radii, np.array(reach))
    on_circle: list[ComplexArray] = []
    for number, hole in enumerate(disc.holes):
        offsets = zeta - apexes[number]
        border = _cell_radius(number, targets, extents, outer_radius)
        inside = np.flatnonzero(np.abs(offsets) < border)
        inside = np.union1d(inside, hole.loop)
        rim = np.searchsorted(inside, hole.loop)
        radius = radii[number]
        share, distance, angle = _log_radial(offsets[inside], border, rim, radius)
        opened[inside] = targets[number] + distance * np.exp(1j * angle)
        circle = Circle(frame @ hole.circle.center, hole.circle.radius)
        shift = _arc_length_shift(disc, hole.loop, circle, angle[rim], targets[number], radius)
        bent = angle + (1.0 - share) ** 2 * _periodic(angle, angle[rim], shift)
        arc_length[inside] = targets[number] + distance * np.exp(1j * bent)
        on_circle.append(targets[number] + radius * np.exp(1j * (angle[rim] + shift)))
    # last, because cells of crowded holes overlap
    for hole, points, center in zip(disc.holes, on_circle, targets, strict=True):
        arc_length[hole.loop] = points
        steps = np.angle(np.roll(opened[hole.loop] - center, -1) / (opened[hole.loop] - center))
        if (steps <= 0.0).any():  # not star-shaped: the rim's own angles would fold it
            opened[hole.loop] = points
    return OpenedDisc(
        *(inverse_stereographic(plane) @ frame for plane in (tutte, opened, arc_length))
    )


def _spread(
    disc: Disc, zeta: ComplexArray, apexes: ComplexArray, radius: float
) -> tuple[ComplexArray, ComplexArray]:
    """Bring the bulk of a surface that Tutte's map has crowded somewhere to the disc's middle.

    Behind a tube the rest of the surface is exponentially small, behind one side of a long outer
    loop it is close to the border. The automorphism of the disc that takes its median to the
    centre is followed by an enlargement, until half of the surface is in either hemisphere; the
    annulus from there to the outer circle takes up the difference: the logarithm of the distance
    is mapped linearly, the angle is blended to that of the outer loop, which stays where it is.
    """
    weights = vertex_areas(disc.vertices, disc.faces)
    middle = complex(_weighted_median(zeta.real, weights), _weighted_median(zeta.imag, weights))
    shift = middle / radius
    shift *= min(1.0, LARGEST_SHIFT / max(abs(shift), 1e-12))
    border = zeta[disc.outer.loop]
    centred, on_border = (
        _disc_shifted(points, shift, radius) for points in (np.append(zeta, apexes), border)
    )
    turn = np.exp(1j * np.angle(np.mean(border / on_border)))
    centred, on_border = centred * turn, on_border * turn
    half = _weighted_median(np.abs(centred[: len(zeta)]), weights)
    core = min(4.0 * half, LARGEST_CORE * radius)
    scale = min(1.0 / half, LARGEST_CORE * radius / core)
    if scale < CROWDED and abs(shift) < OFF_CENTRE:
        return zeta, apexes
    scale = max(scale, 1.0)
    away = np.maximum(np.abs(centred), 1e-300)
    angle = np.angle(centred)
    share = np.clip(np.log(away / core) / np.log(radius / core), 0.0, 1.0)
    outside = scale * core * (radius / (scale * core)) ** share
    bent = angle + share**2 * _periodic(
        angle, np.angle(on_border), _continuous(np.angle(border / on_border))
    )
    moved = np.where(away < core, scale * away, outside) * np.exp(1j * bent)
    moved[disc.outer.loop] = border
    return moved[: len(zeta)], moved[len(zeta) :]


def _disc_shifted(points: ComplexArray, shift: complex, radius: float) -> ComplexArray:
    """Apply the automorphism of the disc of a radius that takes ``shift * radius`` to zero."""
    unit = points / radius
    shifted: ComplexArray = radius * (unit - shift) / (1.0 - np.conj(shift) * unit)
    return shifted


def _continuous(differences: FloatArray) -> FloatArray:
    """Unwrap angle differences along a loop, of two angles that both go round once."""
    unwrapped = np.unwrap(differences)
    continuous: FloatArray = unwrapped - 2.0 * np.pi * np.round(unwrapped.mean() / (2.0 * np.pi))
    return continuous


def _weighted_median(values: FloatArray, weights: FloatArray) -> float:
    order = np.argsort(values, kind="stable")
    share = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(share, 0.5 * share[-1])]])


def _swirled(
    zeta: ComplexArray, apexes: ComplexArray, targets: ComplexArray, radius: float
) -> tuple[ComplexArray, ComplexArray]:
    """Turn the inside of a disc towards the targets, smoothly to nothing at its border."""
    angle = float(np.angle(np.sum(targets * np.conj(apexes))))
    inner = min(0.85, 1.05 * float(np.abs(apexes).max()) / radius)

    def swirl(z: ComplexArray) -> ComplexArray:
        t = np.clip((np.abs(z) / radius - inner) / (1.0 - inner), 0.0, 1.0)
        plateau = 1.0 - t**3 * (10.0 - 15.0 * t + 6.0 * t**2)
        turned: ComplexArray = z * np.exp(1j * angle * plateau)
        return turned

    return swirl(zeta), swirl(apexes)


def _flowed(
    zeta: ComplexArray, starts: ComplexArray, targets: ComplexArray, radius: float
) -> tuple[ComplexArray, ComplexArray]:
    """Carry the holes along their paths to their targets, the rest of the disc with them (RK4)."""
    if not len(starts):
        return zeta, starts
    paths = _clear_paths(starts, targets, radius)
    moves = np.abs(targets - starts) * np.sqrt(1.0 + paths.bow**2)
    steps = int(np.clip(np.ceil(moves.max() / (0.2 * paths.clearance)), 10, MAX_FLOW_STEPS))
    moved = np.concatenate([zeta, starts])
    for step in range(steps):
        t, dt = step / steps, 1.0 / steps
        middle = paths.at(t + 0.5 * dt)
        k1 = _velocity(moved, *paths.at(t), radius)
        k2 = _velocity(moved + 0.5 * dt * k1, *middle, radius)
        k3 = _velocity(moved + 0.5 * dt * k2, *middle, radius)
        k4 = _velocity(moved + dt * k3, *paths.at(t + dt), radius)
        moved = moved + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return moved[: len(zeta)], moved[len(zeta) :]


@dataclass(frozen=True, slots=True, eq=False)
class _Paths:
    """Ways of holes from start to target, bowed to the left by a share of their length.

    `clearance` is the least width of a hole's kernel on the way.
    """

    starts: ComplexArray
    targets: ComplexArray
    bow: float
    clearance: float = 0.0

    def at(self, t: float) -> tuple[ComplexArray, ComplexArray]:
        """Return positions and velocities at a time in [0, 1]."""
        moves = self.targets - self.starts
        return (
            self.starts + moves * (t + 1j * self.bow * t * (1.0 - t)),
            moves * (1.0 + 1j * self.bow * (1.0 - 2.0 * t)),
        )


def _clear_paths(starts: ComplexArray, targets: ComplexArray, radius: float) -> _Paths:
    """Straight paths, unless holes come close on them and bows keep them further apart.

    Holes that change places all pass on the left.
    """
    best = _with_clearance(_Paths(starts, targets, 0.0), radius)
    ends = min(_widths(starts, radius).min(), _widths(targets, radius).min())
    if best.clearance > CLEARANCE * ends:
        return best
    for bow in BOWS:
        other = _with_clearance(_Paths(starts, targets, bow), radius)
        if other.clearance > 1.5 * best.clearance:
            best = other
    return best


def _with_clearance(paths: _Paths, radius: float) -> _Paths:
    clearance = min(float(_widths(paths.at(t)[0], radius).min()) for t in np.linspace(0.0, 1.0, 33))
    return replace(paths, clearance=clearance)


def _widths(centers: ComplexArray, radius: float) -> FloatArray:
    """Widths of the flow's kernels: within reach of the next hole and of the border."""
    gaps = np.abs(centers[:, None] - centers[None, :]) + np.diag(np.full(len(centers), np.inf))
    nearest = np.minimum(gaps.min(axis=1), radius)
    widths = 0.6 * np.minimum(nearest, radius - np.abs(centers))
    floored: FloatArray = np.maximum(widths, LEAST_WIDTH * min(radius, np.abs(centers).max()))
    return floored


def _velocity(
    points: ComplexArray, centers: ComplexArray, speeds: ComplexArray, radius: float
) -> ComplexArray:
    """Velocity field that has the given speeds at the centres and vanishes at the border."""
    widths = _widths(centers, radius)
    weights = np.ones((len(centers), len(centers)), dtype=np.complex128)
    for k in range(len(centers)):
        unit = np.zeros(len(centers), dtype=np.complex128)
        unit[k] = 1.0
        weights[:, k] = _kernel_sum(centers, centers, widths, unit, radius)
    coefficients = np.linalg.lstsq(weights, speeds, rcond=1e-6)[0]
    velocity: ComplexArray = _kernel_sum(
        points, centers, widths, coefficients.astype(np.complex128), radius
    )
    return velocity


@kernel
def _kernel_sum(
    points: ComplexArray,
    centers: ComplexArray,
    widths: FloatArray,
    coefficients: ComplexArray,
    radius: float,
) -> ComplexArray:
    values = np.zeros(len(points), dtype=np.complex128)
    for i in range(len(points)):
        x, y = points[i].real, points[i].imag
        fade = max(1.0 - (x * x + y * y) / (radius * radius), 0.0)
        if fade == 0.0:
            continue
        for k in range(len(centers)):
            u, v = x - centers[k].real, y - centers[k].imag
            exponent = 0.5 * (u * u + v * v) / (widths[k] * widths[k])
            if exponent < 40.0:
                values[i] += np.exp(-exponent) * fade * coefficients[k]
    return values


def _cell_radius(number: int, centers: ComplexArray, extents: FloatArray, radius: float) -> float:
    """Radius of a disc around a hole that reaches no other hole's disc and not the outer circle.

    The gap to each is shared; where holes overlap (`extents` are their largest radii), so do the
    discs, and the folds are left to the untangling.
    """
    center, extent = centers[number], extents[number]
    limit = extent + CELL_SHARE * (radius - abs(center) - extent)
    for other in range(len(centers)):
        if other != number:
            gap = abs(centers[other] - center) - extent - extents[other]
            limit = min(limit, extent + 0.5 * CELL_SHARE * gap)
    return float(max(limit, 1.05 * extent))


def _log_radial(
    offsets: ComplexArray, border: float, rim: IntArray, radius: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Stretch a hole's cell so that its rim, at any distance, comes to a circle about its centre.

    The depth below the border is measured in the logarithm of the distance to the centre. The new
    depth F has the slope F' = k + (1 - k) exp(-depth / width): 1 at the border, where the map
    joins the identity smoothly, and soon the constant k that brings the rim to its circle.

    Returns
    -------
    share : (n,) float64
        Share of the depth from rim (0) to border (1).
    distance : (n,) float64
        New distance to the centre.
    angle : (n,) float64
        Angle about the centre, not changed.
    """
    angle = np.angle(offsets)
    log_distance = np.log(np.maximum(np.abs(offsets), 1e-300))
    log_rim = _periodic(angle, angle[rim], log_distance[rim])
    log_border = np.log(border)
    full = np.maximum(log_border - log_rim, 1e-9)
    depth = np.clip(log_border - log_distance, 0.0, full)
    depth[rim] = full[rim]
    wanted = np.maximum(log_border - np.log(radius), 1e-9)
    width = SMOOTHING_SHARE * np.minimum(full, wanted)
    eased = width * -np.expm1(-depth / width)
    eased_full = width * -np.expm1(-full / width)
    slope = (wanted - eased_full) / (full - eased_full)
    new_depth = eased + slope * (depth - eased)
    distance = np.exp(log_border - new_depth)
    distance[rim] = radius
    share: FloatArray = 1.0 - depth / full
    return share, distance, angle


def _periodic(angles: FloatArray, knots: FloatArray, values: FloatArray) -> FloatArray:
    """Interpolate linearly a function of the angle given at knots in any order."""
    interpolated: FloatArray = np.interp(angles, knots, values, period=2.0 * np.pi)
    return interpolated


def _arc_length_shift(
    disc: Disc,
    loop: IntArray,
    circle: Circle,
    angles: FloatArray,
    center: complex,
    radius: float,
) -> FloatArray:
    """Return how far each rim vertex must turn, in the plane, to be at arc length.

    Arc length is measured on the sphere; the rotation is the one that moves the vertices least,
    and turns no vertex round the circle once more (no Dehn twist).
    """
    plane = center + radius * np.exp(1j * angles)
    natural = circle.angles(inverse_stereographic(plane))
    arc = -arc_length_angles(disc.vertices, loop)
    turn = np.angle(np.mean(np.exp(1j * (natural - arc))))
    placed = stereographic(circle.points(arc + turn)) - center
    return _continuous(np.angle(placed) - angles)
