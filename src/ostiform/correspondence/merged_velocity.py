"""A velocity with its coefficients: fields summed where that is exact, for the flow kernels."""

from typing import NamedTuple

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.correspondence.field_kernels import BOOST, BUMP, ROTATION, TWIST
from ostiform.domain import tangent_frame


class MergedVelocity(NamedTuple):
    """The velocity of a basis with coefficients, its fields summed where that is exact.

    Attributes
    ----------
    conformal : (S, 6) float64
        Rotation and boost of each sphere.
    bumps : (B, 7) float64
        Centre, vector and support of each control point's spline.
    bump_sphere : (B,) int64
    circles : (K, 16) float64
        Those of `fields.circle_table`; two tangents at the centre, from the first of which angles
        are counted; cosines of the angles from the centre between which twists are felt.
    rings : (G, 3 + 2 J) float64
        Of the twists of a circle that have the same support: this, and their sum as a
        trigonometric polynomial: twice its order, the coefficients of 1, cos, sin, cos of twice
        the angle, ...
    first_ring : (K + 1,) int64
        The rings of circle k are ``first_ring[k]:first_ring[k + 1]``.
    """

    conformal: FloatArray
    bumps: FloatArray
    bump_sphere: IntArray
    circles: FloatArray
    rings: FloatArray
    first_ring: IntArray


def merged_velocity(
    table: FloatArray, labels: IntArray, circles: FloatArray, coefficients: FloatArray
) -> MergedVelocity:
    """Return the velocity ``sum_d coefficients[d] field_d``.

    Parameters
    ----------
    table, labels, circles : (D, 12), (D, 4) and (K, 8)
        See `field_kernels`.
    coefficients : (D,) float64
    """
    kind, sphere = labels[:, 0], labels[:, 1]
    n_spheres = int(max(sphere.max(initial=0), circles[:, 7].max(initial=0.0))) + 1
    vectors = coefficients[:, None] * table[:, 3:6]
    conformal = np.zeros((n_spheres, 6))
    for field, column in ((ROTATION, 0), (BOOST, 3)):
        own = kind == field
        np.add.at(conformal[:, column : column + 3], sphere[own], vectors[own])
    lead, group = _groups(labels, BUMP)
    bumps = table[lead][:, [0, 1, 2, 3, 4, 5, 9]]
    bumps[:, 3:6] = 0.0
    np.add.at(bumps[:, 3:6], group, vectors[kind == BUMP])
    ring, of_twist = _groups(labels, TWIST)
    ring_circle = _circles_of(table[ring], sphere[ring], circles)
    order = np.argsort(ring_circle, kind="stable")
    twists = kind == TWIST
    waves = _waves(coefficients[twists], labels[twists, 2], table[twists, 10], of_twist, len(ring))
    rings = np.column_stack([table[ring, 9], labels[ring, 2] - 1, waves])[order]
    first_ring = np.searchsorted(ring_circle[order], np.arange(len(circles) + 1))
    felt = _felt(circles, ring_circle, table[ring, 9])
    around = np.concatenate([circles, felt], axis=1)
    return MergedVelocity(conformal, bumps, sphere[lead], around, rings, first_ring)


def _groups(labels: IntArray, kind: int) -> tuple[IntArray, IntArray]:
    """Return the first field of every group of a kind, and the group of each field of the kind."""
    own = np.flatnonzero(labels[:, 0] == kind)
    leads = labels[own, 3] == 0
    return own[leads], np.cumsum(leads) - 1


def _circles_of(table: FloatArray, sphere: IntArray, circles: FloatArray) -> IntArray:
    """Return the row of the circle that each twist slides along."""
    same = (table[:, None, :3] == circles[:, :3]).all(axis=2)
    same &= (table[:, None, 11] == circles[:, 3]) & (sphere[:, None] == circles[:, 7])
    return same.argmax(axis=1) if len(circles) else np.zeros(0, np.int64)


def _felt(circles: FloatArray, ring_circle: IntArray, supports: FloatArray) -> FloatArray:
    """Return the tangents at each circle's centre and where its twists are felt, (K, 8)."""
    felt = np.zeros((len(circles), 8))
    widest = np.zeros(len(circles))
    np.maximum.at(widest, ring_circle, supports)
    for row, (circle, width) in enumerate(zip(circles, widest, strict=True)):
        felt[row, :6] = np.concatenate(tangent_frame(circle[:3]))
        far, near = circle[3] + width, circle[3] - width
        felt[row, 6] = np.cos(far) if far < np.pi else -2.0
        felt[row, 7] = np.cos(near) if near > 0.0 else 2.0
    return felt


def _waves(
    coefficients: FloatArray, counts: IntArray, angles: FloatArray, ring: IntArray, n_rings: int
) -> FloatArray:
    """Return the trigonometric polynomials (n_rings, 1 + 2 J) that twists add up to.

    One of m twists is ``1 / m (1 + 2 sum_j cos(j (angle - own angle)))``, j up to (m - 1) / 2.
    """
    most = int((counts.max(initial=1) - 1) // 2)
    waves = np.zeros((n_rings, 1 + 2 * most))
    shares = coefficients / counts
    np.add.at(waves[:, 0], ring, shares)
    for order in range(1, most + 1):
        weights = 2.0 * shares * (2 * order < counts)
        np.add.at(waves[:, 2 * order - 1], ring, weights * np.cos(order * angles))
        np.add.at(waves[:, 2 * order], ring, weights * np.sin(order * angles))
    return waves
