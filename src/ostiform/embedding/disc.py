"""One part of a component as a disc with holes, and its fold-free map into the plane (HY 2.1).

A part is seen from one of its openings, the outer one, as a disc in the stereographic plane of
that opening's circle: filling the other openings by cones, Tutte's theorem makes the map an
embedding. The holes are then carried to their circles by a smooth flow and opened.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ostiform.arrays import FloatArray, IntArray
from ostiform.domain import Circle
from ostiform.surface import (
    factorize,
    rotation_between,
    uniform_laplacian,
)

# Rim edges shorter than this share of the mean count as that long: very short ones would need
# triangles as thin on the sphere, at length zero two vertices would share a point.
LEAST_STEP = 0.02

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True, slots=True, eq=False)
class Opening:
    """An opening of a part and the circle its loop is mapped to.

    Attributes
    ----------
    name : str
    loop : (n,) int64
        Surface on the left.
    circle : Circle
        The hole is inside the circle.
    """

    name: str
    loop: IntArray
    circle: Circle


@dataclass(frozen=True, slots=True, eq=False)
class Disc:
    """A part with at least one opening.

    Attributes
    ----------
    vertices : (V, 3) float64, mm
    faces : (F, 3) int64
    outer : Opening
        The opening that the stereographic pole is in.
    holes : tuple of Opening
    """

    vertices: FloatArray
    faces: IntArray
    outer: Opening
    holes: tuple[Opening, ...]


def arc_length_angles(vertices: FloatArray, loop: IntArray) -> FloatArray:
    """Return the arc-length angles (n,) of a loop in [0, 2 pi), zero at its first vertex."""
    steps = np.linalg.norm(vertices[np.roll(loop, -1)] - vertices[loop], axis=1)
    steps = np.maximum(steps, LEAST_STEP * steps.mean())
    angles: FloatArray = 2.0 * np.pi * np.concatenate([[0.0], np.cumsum(steps)[:-1]]) / steps.sum()
    return angles


def pole_frame(circle: Circle) -> FloatArray:
    """Return the rotation (3, 3) that carries the centre of a circle to +z."""
    return rotation_between(circle.center, np.array([0.0, 0.0, 1.0]))


def plane_circle(circle: Circle, frame: FloatArray) -> tuple[complex, float]:
    """Return centre and radius of the stereographic image of a circle, rotated by `frame`.

    The circle must not go through the pole; the pole must be outside it.
    """
    cap = Circle(frame @ circle.center, circle.radius)
    # the circle's points nearest to and farthest from the pole are mirror images about its axis
    polar = np.arctan2(np.hypot(cap.center[0], cap.center[1]), cap.center[2])
    azimuth = np.exp(1j * np.arctan2(cap.center[1], cap.center[0]))
    near = 1.0 / np.tan(0.5 * (polar - circle.radius))
    far = 1.0 / np.tan(0.5 * (polar + circle.radius))
    return complex(0.5 * (near + far) * azimuth), float(0.5 * abs(near - far))


def cone_filled(
    faces: IntArray, n_vertices: int, loops: Sequence[IntArray]
) -> tuple[IntArray, IntArray]:
    """Close loops by a new vertex each.

    Parameters
    ----------
    faces : (F, 3) int64
    n_vertices : int
    loops : sequence of (n,) int64
        Surface on the left.

    Returns
    -------
    faces : (F + sum n, 3) int64
    apexes : (n_loops,) int64
        The new vertices, numbered from `n_vertices`.
    """
    apexes = n_vertices + np.arange(len(loops))
    cones = [
        np.stack([np.roll(loop, -1), loop, np.full(len(loop), apex)], axis=1)
        for loop, apex in zip(loops, apexes, strict=True)
    ]
    return np.concatenate([faces, *cones]), apexes


def disc_solution(
    laplacian: sparse.csr_array, fixed: IntArray, values: ComplexArray
) -> ComplexArray:
    """Return the solution (n,) of ``laplacian x = 0`` with given values at the fixed vertices."""
    free = np.ones(laplacian.shape[0], dtype=bool)
    free[fixed] = False
    rows = laplacian[np.flatnonzero(free)]
    upper = sparse.triu(rows[:, np.flatnonzero(free)]).tocsc()
    upper.sort_indices()
    right = -(rows[:, fixed] @ np.stack([values.real, values.imag], axis=1))  # (n_free, 2)
    inner = factorize(sparse.csc_array(upper)).solve(right)
    solution = np.empty(laplacian.shape[0], dtype=np.complex128)
    solution[fixed] = values
    solution[free] = inner[:, 0] + 1j * inner[:, 1]
    return solution


def tutte_disc(disc: Disc, outer_angles: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """Return Tutte's embedding of a disc whose holes are filled by cones (HY 2.1).

    With uniform weights and the outer loop on a convex curve every interior vertex is the mean of
    its neighbours: no triangle folds (Tutte 1963, Floater 1997).

    Parameters
    ----------
    disc : Disc
    outer_angles : (n,) float64
        Azimuth of the outer loop's vertices about the pole, decreasing.

    Returns
    -------
    zeta : (V,) complex128
        In the stereographic plane of the outer circle.
    apexes : (n_holes,) complex128
        Where the holes' cones have their apex.
    """
    filled, _ = cone_filled(disc.faces, len(disc.vertices), [hole.loop for hole in disc.holes])
    n_all = len(disc.vertices) + len(disc.holes)
    radius = 1.0 / np.tan(0.5 * disc.outer.circle.radius)
    zeta = disc_solution(
        uniform_laplacian(filled, n_all), disc.outer.loop, radius * np.exp(1j * outer_angles)
    )
    return zeta[: len(disc.vertices)], zeta[len(disc.vertices) :]
