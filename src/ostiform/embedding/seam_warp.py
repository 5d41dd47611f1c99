"""Carry free seam curves exactly onto their circles by a smooth warp (design 3).

About the circle's centre every point has a longitude and a Mercator latitude
``m = artanh(x . center)``. The curve is a graph m = m_c + delta(longitude) over it; the warp
subtracts ``delta B``, B a C2 bump that is one with zero slope and curvature on the curve and
vanishes before the rims. The map's derivative is changed alike on both sides of the seam, so a
map that is C1 across it stays so.
"""

import numpy as np
from scipy.interpolate import PchipInterpolator

from ostiform.arrays import FloatArray, IntArray
from ostiform.domain import Circle, Sphere
from ostiform.embedding.start import snapped
from ostiform.surface import Component, Seam

# Harmonics of the smooth part of the curve; the rest, of the size of the mesh, follows exactly.
MAX_HARMONICS = 12
# The derivative of the bump is at most 1.875 / width: a wider bump keeps latitudes in order.
LEAST_WIDTH = 1.875 / 0.8
# Largest support of the bump, in Mercator latitude (0.9 is 46 degrees off the equator).
LARGEST_SUPPORT = 0.9
# Share of the way to the nearest rim that the support may take.
RIM_SHARE = 0.95


def seams_on_circles(component: Component, sphere: Sphere, directions: FloatArray) -> FloatArray:
    """Return the map with every seam vertex exactly on its circle.

    Triangles may fold where a curve is far from its circle and close to a rim.

    Parameters
    ----------
    component : Component
    sphere : Sphere
    directions : (V, 3) float64
        Rims on their circles, seams free.
    """
    warped = directions
    for seam in component.seams:
        for harmonics in (min(MAX_HARMONICS, len(component.seams[seam]) // 6), None):
            warped = _warped(component, sphere, warped, seam, harmonics)
    return snapped(component, sphere, warped)


def _warped(
    component: Component,
    sphere: Sphere,
    directions: FloatArray,
    seam: Seam,
    harmonics: int | None,
) -> FloatArray:
    circle = sphere.seams[seam]
    longitude, latitude = _mercator(circle, directions)
    level = float(np.arctanh(np.cos(circle.radius)))
    latitude = latitude - level
    others = [rim for rim in component.rims.values()]
    others += [curve for other, curve in component.seams.items() if other != seam]
    room = {
        side: min(
            [LARGEST_SUPPORT]
            + [
                RIM_SHARE * float(np.min(np.abs(latitude[curve])))
                for curve in others
                if side * np.median(latitude[curve]) > 0.0
            ]
        )
        for side in (-1, 1)
    }
    curve = component.seams[seam]
    if harmonics is None:
        offset = _interpolated(longitude[curve], latitude[curve], longitude)
    else:
        offset = _fitted(longitude[curve], latitude[curve], longitude, harmonics)
    above = latitude >= offset
    width = np.where(above, room[1] - offset, room[-1] + offset)  # from the curve to the support
    width = np.maximum(width, LEAST_WIDTH * np.abs(offset))
    t = np.clip(np.abs(latitude - offset) / np.maximum(width, 1e-12), 0.0, 1.0)
    bump = 1.0 - t**3 * (10.0 - 15.0 * t + 6.0 * t**2)
    return _from_mercator(circle, longitude, level + latitude - offset * bump)


def _mercator(circle: Circle, directions: FloatArray) -> tuple[FloatArray, FloatArray]:
    height = np.clip(directions @ circle.center, -1.0 + 1e-15, 1.0 - 1e-15)
    return circle.angles(directions), np.arctanh(height)


def _from_mercator(circle: Circle, longitude: FloatArray, latitude: FloatArray) -> FloatArray:
    ring = Circle(circle.center, 0.5 * np.pi).points(longitude)
    points = np.tanh(latitude)[:, None] * circle.center + ring / np.cosh(latitude)[:, None]
    unit: FloatArray = points / np.linalg.norm(points, axis=1, keepdims=True)
    return unit


def _fitted(
    knots: FloatArray, values: FloatArray, angles: FloatArray, harmonics: int
) -> FloatArray:
    """Trigonometric least-squares fit, weighted by the gaps between the knots."""
    order = np.argsort(knots)
    gaps = np.diff(np.append(knots[order], knots[order[0]] + 2.0 * np.pi))
    weights = np.empty(len(knots))
    weights[order] = np.sqrt(0.5 * (gaps + np.roll(gaps, 1)))
    damping = 1e-3 * np.repeat(np.arange(1, harmonics + 1) ** 2, 2)
    system = np.vstack(
        [
            weights[:, None] * _harmonics(knots, harmonics),
            np.hstack([np.zeros((2 * harmonics, 1)), np.diag(damping)]),
        ]
    )
    right = np.concatenate([weights * values, np.zeros(2 * harmonics)])
    fitted: FloatArray = _harmonics(angles, harmonics) @ np.linalg.lstsq(system, right)[0]
    return fitted


def _harmonics(angles: FloatArray, count: int) -> FloatArray:
    columns = [np.ones_like(angles)]
    for k in range(1, count + 1):
        columns += [np.cos(k * angles), np.sin(k * angles)]
    return np.stack(columns, axis=1)


def _interpolated(knots: FloatArray, values: FloatArray, angles: FloatArray) -> FloatArray:
    """Periodic monotone cubic interpolation, C1, without overshoot."""
    ordered, first = _distinct(knots)
    period = 2.0 * np.pi
    heights = values[first]
    curve = PchipInterpolator(
        np.concatenate([ordered[-3:] - period, ordered, ordered[:3] + period]),
        np.concatenate([heights[-3:], heights, heights[:3]]),
    )
    interpolated: FloatArray = curve(angles)
    return interpolated


def _distinct(knots: FloatArray) -> tuple[FloatArray, IntArray]:
    ordered, first = np.unique(knots, return_index=True)
    return ordered, first
