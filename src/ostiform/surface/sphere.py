"""Geometry on the unit sphere: projections, spherical triangles and their exact orientation.

A triangle (a, b, c) of unit vectors is positively oriented when it is counter-clockwise seen from
outside the sphere, that is when ``det(a, b, c) > 0``.
"""

import igl.predicates
import numpy as np
from numpy.typing import NDArray

from ostiform.arrays import FloatArray, IntArray
from ostiform.errors import InputError


def normalised(vectors: FloatArray) -> FloatArray:
    """Return vectors (..., 3) scaled to unit length.

    Raises
    ------
    InputError
        If a vector has length zero or is not finite.
    """
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)  # (..., 1)
    usable = np.isfinite(lengths) & (lengths > 0)
    if not usable.all():
        raise InputError(
            f"vectors: expected finite vectors longer than zero, found {int((~usable).sum())} that "
            f"have no direction, the first at position {int(np.argmin(usable.ravel()))}"
        )
    unit: FloatArray = vectors / lengths
    return unit


def stereographic(directions: FloatArray) -> NDArray[np.complex128]:
    """Return the stereographic projection from the north pole of unit vectors.

    ``zeta = (x + i y) / (1 - z)``: the south pole goes to 0, the equator to the unit circle, a
    circle of angular radius rho about the north pole to ``|zeta| = cot(rho / 2)``. Azimuth is
    kept, so a triangle that is counter-clockwise seen from outside the sphere becomes clockwise.

    Parameters
    ----------
    directions : (n, 3) float64
        Unit vectors; the north pole itself has no finite image.

    Returns
    -------
    zeta : (n,) complex128

    Raises
    ------
    InputError
        If a direction is the north pole.
    """
    x, y, z = directions[..., 0], directions[..., 1], directions[..., 2]
    # 1 - z loses all digits near the pole; (x^2 + y^2) / (1 + z) equals it on the sphere.
    squared = x**2 + y**2
    height = np.where(z > 0, squared / (1.0 + np.abs(z)), 1.0 - z)  # (n,)
    if (height <= 0).any():
        raise InputError(
            f"directions: expected no vector at the north pole, found "
            f"{int((height <= 0).sum())}, the first at position "
            f"{int(np.argmax((height <= 0).ravel()))}"
        )
    zeta: NDArray[np.complex128] = x / height + 1j * (y / height)
    return zeta


def inverse_stereographic(zeta: NDArray[np.complex128]) -> FloatArray:
    """Return the unit vectors (n, 3) whose `stereographic` projections are ``zeta`` (n,)."""
    squared = zeta.real**2 + zeta.imag**2
    scale = 2.0 / (1.0 + squared)
    directions: FloatArray = np.stack(
        [scale * zeta.real, scale * zeta.imag, 1.0 - scale], axis=-1
    )  # (n, 3)
    return directions


def triangle_determinants(directions: FloatArray, faces: IntArray) -> FloatArray:
    """Return ``det(a, b, c)`` (F,) of every triangle, positive when counter-clockwise outside.

    In floating point: signs of nearly degenerate triangles need `exact_orientations`.
    """
    a, b, c = (directions[faces[:, corner]] for corner in range(3))  # (F, 3)
    determinants: FloatArray = np.einsum("fi,fi->f", a, np.cross(b, c))
    return determinants


def spherical_areas(directions: FloatArray, faces: IntArray) -> FloatArray:
    """Return the signed areas (F,) of spherical triangles, positive when counter-clockwise.

    ``tan(area / 2) = det(a, b, c) / (1 + a.b + b.c + c.a)`` (Van Oosterom & Strackee 1983), in
    steradians, between -2 pi and 2 pi.
    """
    a, b, c = (directions[faces[:, corner]] for corner in range(3))  # (F, 3)
    determinants = np.einsum("fi,fi->f", a, np.cross(b, c))
    denominators = (
        1.0
        + np.einsum("fi,fi->f", a, b)
        + np.einsum("fi,fi->f", b, c)
        + np.einsum("fi,fi->f", c, a)
    )
    areas: FloatArray = 2.0 * np.arctan2(determinants, denominators)
    return areas


def exact_orientations(directions: FloatArray, faces: IntArray) -> NDArray[np.int8]:
    """Return the sign of ``det(a, b, c)`` of every triangle, exact for the stored numbers.

    Shewchuk's adaptive predicate of the tetrahedron (a, b, c, origin): 1 counter-clockwise seen
    from outside, 0 degenerate, -1 flipped.

    Parameters
    ----------
    directions : (V, 3) float64
    faces : (F, 3) int64

    Returns
    -------
    orientations : (F,) int8
    """
    if len(faces) == 0:
        return np.zeros(0, dtype=np.int8)
    axes = np.eye(3)[:, None, :]  # det(e1, e2, e3) = 1 tells which sign the predicate calls +1
    positive = int(igl.predicates.orient3d(axes[0], axes[1], axes[2], np.zeros((1, 3)))[0])
    a, b, c = (np.ascontiguousarray(directions[faces[:, corner]]) for corner in range(3))  # (F, 3)
    signs = igl.predicates.orient3d(a, b, c, np.zeros_like(a))  # (F,)
    orientations: NDArray[np.int8] = (np.asarray(signs) * positive).astype(np.int8)
    return orientations


def count_flipped(directions: FloatArray, faces: IntArray) -> int:
    """Return how many triangles are flipped or degenerate by `exact_orientations`."""
    return int(np.count_nonzero(exact_orientations(directions, faces) <= 0))


def rotation_between(source: FloatArray, target: FloatArray) -> FloatArray:
    """Return the smallest rotation (3, 3) that carries one direction to another.

    Parameters
    ----------
    source, target : (3,) float64
        Any length; ``rotation @ source`` is parallel to ``target``. Opposite directions are
        turned by pi about an axis perpendicular to both, the same one every time.

    Returns
    -------
    rotation : (3, 3) float64
    """
    a = normalised(source)
    b = normalised(target)
    # Two reflections make a rotation: first across the plane between a and m, then m and b.
    middle = a + b
    if np.linalg.norm(middle) < 1e-8:  # opposite to within rounding of a square root
        axis = np.cross(a, np.eye(3)[np.argmin(np.abs(a))])
        axis = axis / np.linalg.norm(axis)
        half_turn: FloatArray = 2.0 * np.outer(axis, axis) - np.eye(3)
        return half_turn
    middle = middle / np.linalg.norm(middle)
    about_middle = 2.0 * np.outer(middle, middle) - np.eye(3)  # half turn: a -> b
    about_source = 2.0 * np.outer(a, a) - np.eye(3)  # half turn that keeps a
    rotation: FloatArray = about_middle @ about_source
    return rotation


def spherical_fibonacci(count: int) -> FloatArray:
    """Return ``count`` nearly evenly spread unit vectors (count, 3) on a golden-angle spiral."""
    if count < 1:
        raise InputError(f"count: expected at least one point on the sphere, found {count}")
    index = np.arange(count) + 0.5
    height = 1.0 - 2.0 * index / count
    azimuth = np.pi * (1.0 + np.sqrt(5.0)) * index
    radius = np.sqrt(1.0 - height**2)
    points: FloatArray = np.stack(
        [radius * np.cos(azimuth), radius * np.sin(azimuth), height], axis=1
    )  # (count, 3)
    return points
