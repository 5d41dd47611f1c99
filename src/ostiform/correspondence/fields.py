"""Warps of the component spheres: smooth fields tangent to the circles, and flows (HY 2.3)."""

from dataclasses import dataclass
from typing import Annotated, Protocol

import numpy as np

from ostiform.arrays import FloatArray, IntArray, read_only
from ostiform.correspondence.field_kernels import (
    BOOST,
    BUMP,
    ROTATION,
    TWIST,
    active_fields,
    determinants,
    field_vectors,
)
from ostiform.correspondence.flow_kernels import flow_points, velocities
from ostiform.correspondence.merged_velocity import MergedVelocity, merged_velocity
from ostiform.domain import BaseDomain, Template, tangent_frame
from ostiform.errors import InputError
from ostiform.values import Axes, value

# Widths of the cut-off of the normal component at a circle: twice the circle's radius (near a
# hole the natural coordinate is the logarithm of the distance), never wider than this angle, and
# never reaching another circle, so that every circle stays invariant exactly.
CUT_OFF_RADII = 2.0
WIDEST_CUT_OFF = 0.25
CLEAR_OF_OTHERS = 0.9

# No point travels farther than this in one Runge-Kutta step (radians): then a flow is off by less
# than 2e-7 radians, measured over all flows of a run.
LONGEST_SUBSTEP = 0.05


class OnSpheres(Protocol):
    """Points of which it is known on which sphere and which circle they lie, as of a `Template`."""

    @property
    def sphere(self) -> IntArray:
        """Component sphere of each point, (P,)."""

    @property
    def curve(self) -> IntArray:
        """Row of the circle that each point lies on, (P,); -1 in the interior."""


@value
class FieldBasis:
    """D smooth tangent vector fields on the component spheres, tangent to every circle.

    Attributes
    ----------
    table : (D, 12) float64
        Geometry of each field; see `field_kernels`.
    labels : (D, 4) int64
        Kind (bump, rotation, boost, twist), component sphere, control points on the circle of a
        twist, and 1 where kind, centre and support are those of the row before.
    control : (D,) int64
        Control point the field belongs to; -1 for the global fields of level 1.
    circles : (K, 8) float64
        The circles in the order of `Template.curves`; see `circle_table`.
    """

    table: Annotated[FloatArray, Axes("D", 12)]
    labels: Annotated[IntArray, Axes("D", 4)]
    control: Annotated[IntArray, Axes("D")]
    circles: Annotated[FloatArray, Axes("K", 8)]

    def __len__(self) -> int:
        """Return the number D of fields."""
        return len(self.table)


@dataclass(frozen=True, slots=True, eq=False)
class ActiveFields:
    """The basis fields at points: a sparse (P, D) array of tangent vectors.

    Attributes
    ----------
    starts : (P + 1,) int64
    fields : (A,) int64
        The fields of point p are ``fields[starts[p]:starts[p + 1]]``.
    vectors : (A, 3) float64
        Their tangent vectors at the point, the derivative of the flow by the coefficients.
    """

    starts: IntArray
    fields: IntArray
    vectors: FloatArray


def circle_table(domain: BaseDomain, template: Template) -> FloatArray:
    """Return the circles of a template's curves with the width of their cut-offs.

    Returns
    -------
    circles : (K, 8) float64
        Centre, radius (radians), width of the cut-off (radians), cosine of its outer and inner
        end, index of the component sphere.

    Raises
    ------
    InputError
        If the domain has no circle of a template curve's name.
    """
    found = {
        name: (index, circle)
        for index, sphere in enumerate(domain.spheres)
        for name, circle in sphere.curves.items()
    }
    missing = [name for name in template.curves if name not in found]
    if missing:
        raise InputError(
            f"template: expected curves of the base domain ({', '.join(found)}), found "
            f"{', '.join(missing)}; build the template from the same domain"
        )
    table = np.zeros((len(template.curves), 8))
    for row, name in enumerate(template.curves):
        index, circle = found[name]
        gaps = [
            _gap_between(circle.center, circle.radius, other.center, other.radius)
            for other_name, (other_index, other) in found.items()
            if other_index == index and other_name != name
        ]
        nearest = CLEAR_OF_OTHERS * min(gaps, default=np.pi)
        width = min(CUT_OFF_RADII * circle.radius, WIDEST_CUT_OFF, nearest)
        inner = max(circle.radius - width, 0.0)
        outer = min(circle.radius + width, np.pi)
        table[row] = (*circle.center, circle.radius, width, np.cos(outer), np.cos(inner), index)
    return table


def _gap_between(a: FloatArray, radius_a: float, b: FloatArray, radius_b: float) -> float:
    """Return the least angle between two disjoint circles, nested or not."""
    apart = float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))
    total = radius_a + radius_b
    return max(apart - total, abs(radius_a - radius_b) - apart, 2.0 * np.pi - apart - total, 1e-9)


def global_fields(circles: FloatArray, sphere: int) -> FieldBasis:
    """Return the six conformal fields of a sphere: rotations about and boosts towards each axis.

    Near the circles their normal component is cut off like that of every field; on a component
    without circles the rotations are exact.
    """
    table = np.zeros((6, 12))
    table[:3, 3:6] = np.eye(3)
    table[3:, 3:6] = np.eye(3)
    labels = np.zeros((6, 4), np.int64)
    labels[:3, 0], labels[3:, 0] = ROTATION, BOOST
    labels[:, 1] = sphere
    return FieldBasis(table, labels, np.full(6, -1), circles)


def bump_fields(
    circles: FloatArray,
    sphere: IntArray,
    centers: FloatArray,
    supports: FloatArray,
    control: IntArray,
) -> FieldBasis:
    """Return two radial basis splines (Wendland C2) per interior control point.

    Parameters
    ----------
    circles : (K, 8) float64
        See `circle_table`.
    sphere : (C,) int64
        Component sphere of each control point.
    centers : (C, 3) float64
        Unit vectors.
    supports : (C,) float64
        Chord beyond which the spline vanishes.
    control : (C,) int64
        Index of each control point.
    """
    table = np.zeros((2 * len(centers), 12))
    labels = np.zeros((2 * len(centers), 4), np.int64)
    for row, center in enumerate(centers):
        first, second = tangent_frame(center)
        for side, direction in enumerate((first, second)):
            table[2 * row + side, :9] = (*center, *direction, *first)
            table[2 * row + side, 9] = supports[row]
    labels[:, 0], labels[:, 1] = BUMP, np.repeat(sphere, 2)
    labels[1::2, 3] = 1
    return FieldBasis(table, labels, np.repeat(control, 2), circles)


def twist_fields(
    circles: FloatArray, circle: int, angles: FloatArray, support: float, control: IntArray
) -> FieldBasis:
    """Return fields that slide the points of one circle along it, one per boundary control point.

    Along the circle they interpolate the control values by the trigonometric polynomial through
    them (an odd number m of equally spaced angles; their sum is the rotation of the circle);
    across it they decay with a Wendland C2 bump, on both sides of a seam alike.

    Parameters
    ----------
    circles : (K, 8) float64
    circle : int
        Row of `circles`.
    angles : (m,) float64
        Angles of the control points about the circle's centre, equally spaced, m odd.
    support : float
        Angle from the circle at which the fields vanish, radians.
    control : (m,) int64
    """
    center, radius = circles[circle, :3], circles[circle, 3]
    first, _ = tangent_frame(center)
    table = np.zeros((len(angles), 12))
    table[:, 0:3], table[:, 6:9] = center, first
    table[:, 9], table[:, 10], table[:, 11] = support, angles, radius
    labels = np.zeros((len(angles), 4), np.int64)
    labels[:, 0], labels[:, 1], labels[:, 2] = TWIST, int(circles[circle, 7]), len(angles)
    labels[1:, 3] = 1
    return FieldBasis(table, labels, control, circles)


def join_fields(bases: list[FieldBasis], circles: FloatArray) -> FieldBasis:
    """Return all fields of several bases as one."""
    return FieldBasis(
        np.concatenate([np.zeros((0, 12)), *(basis.table for basis in bases)]),
        np.concatenate([np.zeros((0, 4), np.int64), *(basis.labels for basis in bases)]),
        np.concatenate([np.zeros(0, np.int64), *(basis.control for basis in bases)]),
        circles,
    )


def active(basis: FieldBasis, places: OnSpheres, directions: FloatArray) -> ActiveFields:
    """Return the basis fields at points: the derivative of the flow at zero coefficients.

    Parameters
    ----------
    basis : FieldBasis
    places : OnSpheres
        On which sphere and circle each point lies.
    directions : (P, 3) float64
        Current positions, unit vectors.
    """
    points = read_only(directions)
    starts, fields = active_fields(points, places.sphere, basis.table, basis.labels)
    vectors = field_vectors(
        points,
        places.sphere,
        places.curve,
        starts,
        fields,
        basis.table,
        basis.labels,
        basis.circles,
    )
    return ActiveFields(starts, fields, vectors)


def flow(
    basis: FieldBasis,
    places: OnSpheres,
    directions: FloatArray,
    coefficients: FloatArray,
    *,
    fastest: float | None = None,
    steps: int | None = None,
) -> FloatArray:
    """Return points carried for unit time along the velocity ``sum_d coefficients[d] field_d``.

    Points on a circle stay on it exactly. Classical Runge-Kutta of fourth order on the sphere.

    Parameters
    ----------
    basis : FieldBasis
    places : OnSpheres
    directions : (P, 3) float64
        Unit vectors.
    coefficients : (D,) float64
        Radians per unit time.
    fastest : float, optional
        The greatest speed at the start, if it is known; see `fastest_point`.
    steps : int, optional
        Runge-Kutta steps; by default as many as keep each below `LONGEST_SUBSTEP`.

    Returns
    -------
    moved : (P, 3) float64
    """
    merged = _merged(basis, coefficients)
    if fastest is None:
        fastest = _greatest(merged, places, directions)
    count = steps or max(1, int(np.ceil(fastest / LONGEST_SUBSTEP)))
    # Points speed up on the way, as fields vary over their support, but not beyond twice.
    margin = min(2.0 * fastest, np.pi)
    points = read_only(directions)
    moved: FloatArray = flow_points(points, places.sphere, places.curve, *merged, margin, count)
    return moved


def fastest_point(
    basis: FieldBasis, places: OnSpheres, directions: FloatArray, coefficients: FloatArray
) -> float:
    """Return the greatest speed, radians per unit time, at points (P, 3)."""
    return _greatest(_merged(basis, coefficients), places, directions)


def orientation_share(template: Template, directions: FloatArray) -> float:
    """Return the least ratio of a warped template triangle's determinant to its initial one.

    Positive when no positively oriented triangle of the template was turned over, 1 for the
    identity. Triangles that the template itself holds turned over do not count.
    """
    return float(orientation_shares(template, directions).min(initial=1.0))


def orientation_shares(template: Template, directions: FloatArray) -> FloatArray:
    """Return the ratio (F,) of every template triangle's determinant to its initial one.

    It is 1 for triangles that the template itself holds turned over.
    """
    before = determinants(template.points, template.faces)
    shares = np.ones(len(before))
    np.divide(
        determinants(read_only(directions), template.faces), before, shares, where=before > 0.0
    )
    return shares


def _merged(basis: FieldBasis, coefficients: FloatArray) -> MergedVelocity:
    own = np.asarray(coefficients, dtype=np.float64)
    return merged_velocity(basis.table, basis.labels, basis.circles, own)


def _greatest(merged: MergedVelocity, places: OnSpheres, directions: FloatArray) -> float:
    points = read_only(directions)
    rates = velocities(points, places.sphere, places.curve, *merged)
    return float(np.sqrt((rates**2).sum(axis=1).max(initial=0.0)))
