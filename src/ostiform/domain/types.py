"""The base domain: unit spheres, the circles of the ostia on them, and the seams (HY 2.1)."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from ostiform.arrays import (
    FloatArray,
    IntArray,
    frozen_floats,
)
from ostiform.surface import Seam
from ostiform.values import Axes, value

NORTH = frozen_floats([0.0, 0.0, 1.0], (3,), "north")


@value
class Circle:
    """A circle on the unit sphere: the image of an ostium's rim or of a seam.

    Angles about the circle are counter-clockwise seen from outside, in `tangent_frame(center)`.
    The rim of an ostium (surface on the left, the hole inside the circle) therefore runs with
    *decreasing* angle; a seam (second part on the left and inside) with *increasing* angle.

    Attributes
    ----------
    center : (3,) float64
        Unit vector.
    radius : float
        Angular radius in radians; pi / 2 is a great circle.
    phase : float
        Angle in radians at which arc-length zero of the loop starts.
    """

    center: Annotated[FloatArray, Axes(3)]
    radius: float
    phase: float = 0.0

    def __post_init__(self) -> None:
        """Normalise the centre; a unit vector is kept bit for bit, so that files round-trip."""
        length = float(np.linalg.norm(self.center))
        if abs(length - 1.0) > 4.0 * np.finfo(np.float64).eps:
            center = frozen_floats(self.center / length, (3,), "circle centre")
            object.__setattr__(self, "center", center)

    def points(self, angles: FloatArray) -> FloatArray:
        """Return the points of the circle at angles (n,) in radians, as unit vectors (n, 3)."""
        e1, e2 = tangent_frame(self.center)
        towards = np.cos(angles)[..., None] * e1 + np.sin(angles)[..., None] * e2  # (n, 3)
        points: FloatArray = np.cos(self.radius) * self.center + np.sin(self.radius) * towards
        return points

    def angles(self, points: FloatArray) -> FloatArray:
        """Return the angle about the circle's centre, in (-pi, pi], of unit vectors (n, 3)."""
        e1, e2 = tangent_frame(self.center)
        angles: FloatArray = np.arctan2(points @ e2, points @ e1)
        return angles


def tangent_frame(center: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return e1, e2 that make (e1, e2, center) a right-handed orthonormal frame.

    At the poles e1 is +x; elsewhere e1 is the direction of the projection of +z (towards the
    north pole), so that frames of the same centre always agree.
    """
    axis = np.array([0.0, 0.0, 1.0]) if abs(center[2]) < 1.0 - 1e-9 else np.array([1.0, 0.0, 0.0])
    e1 = axis - (axis @ center) * center
    e1 = e1 / np.sqrt(e1 @ e1)
    (x, y, z), (a, b, c) = center, e1
    return e1, np.array([y * c - z * b, z * a - x * c, x * b - y * a])


@value
class Sphere:
    """The component sphere of one component: where its rims and seams lie.

    Attributes
    ----------
    name : str
        The component's name.
    parts : tuple of str
        Its parts, in study order.
    rims : mapping of str to Circle
        By full ostium name; the open hole is inside the circle.
    seams : mapping of Seam to Circle
        The part of `Seam.second` is inside the circle. A single seam is the equator about +z.
    pole : str or None
        Full name of the ostium the stereographic pole is put in (a rim, or either side of a
        seam); None for a closed component.
    handles : tuple of Seam
        Pairs of `rims` that are the two sides of one cut through a handle.
    up : (3,) float64
        Unit vector in the population's common pose that +z of the sphere stands for.
    """

    name: str
    parts: tuple[str, ...]
    rims: Mapping[str, Circle]
    seams: Mapping[Seam, Circle]
    pole: str | None
    handles: tuple[Seam, ...] = ()
    up: Annotated[FloatArray, Axes(3)] = field(default_factory=lambda: NORTH)

    @property
    def curves(self) -> Mapping[str, Circle]:
        """Every circle by name: rims, then seams (by the full name of `Seam.first`)."""
        return {**self.rims, **{seam.first: circle for seam, circle in self.seams.items()}}


@dataclass(frozen=True, slots=True, eq=False)
class BaseDomain:
    """The base domain of a study: one sphere per component, given once for the population."""

    spheres: tuple[Sphere, ...]


@value
class Template:
    """A triangulation of the base domain, the same for every shape (HY end of 2.2).

    Attributes
    ----------
    points : (P, 3) float64
        Unit vectors on the point's component sphere.
    sphere : (P,) int64
        Index of the component sphere each point lies on.
    part : (P,) int64
        Index into `parts`; a seam point carries the part of `Seam.first`.
    faces : (F, 3) int64
        Counter-clockwise seen from outside.
    face_part : (F,) int64
        Index into `parts`.
    parts : tuple of str
        All parts of the study, in study order.
    curve : (P,) int64
        Index into `curves` of the circle the point lies on exactly, -1 in the interior.
    curves : tuple of str
        Names of the circles: full ostium names; a seam by `Seam.first`.
    loops : mapping of str to (n,) int64
        Points of each ostium's rim in order, surface of that part on the left. A seam point is
        stored once and listed in both parts' loops (``"LV.mitral"`` and ``"LA.mitral"``).
    levels : tuple of TemplateLevel
        Nested coarser triangulations of subsets of the points, coarsest first (HY: the
        multi-resolution property).
    """

    points: Annotated[FloatArray, Axes("P", 3)]
    sphere: Annotated[IntArray, Axes("P")]
    part: Annotated[IntArray, Axes("P")]
    faces: Annotated[IntArray, Axes("F", 3)]
    face_part: Annotated[IntArray, Axes("F")]
    parts: tuple[str, ...]
    curve: Annotated[IntArray, Axes("P")]
    curves: tuple[str, ...]
    loops: Mapping[str, Annotated[IntArray, Axes(None)]]
    levels: tuple["TemplateLevel", ...] = ()


@value
class TemplateLevel:
    """A coarser triangulation of some of a template's points.

    Attributes
    ----------
    index : (Q,) int64
        The template points of the level.
    faces : (F, 3) int64
        Triangles, indices into `index`.
    face_part : (F,) int64
    """

    index: Annotated[IntArray, Axes("P")]
    faces: Annotated[IntArray, Axes("F", 3)]
    face_part: Annotated[IntArray, Axes("F")]


@value
class ConformalHoles:
    """Where the openings of one shape's component lie when its holes are filled conformally.

    All in the frame of the component sphere: the seam (or the pole's circle) about +z, rotated
    about it so that the map agrees best with the shape in the population's aligned pose.

    Attributes
    ----------
    directions : mapping of str to (3,) float64
        Unit vector of each hole's centre, by curve name (rims except the pole, further seams).
    radii : mapping of str to float
        Angular radius of each hole, radians.
    up : (3,) float64
        Unit vector in the population's common pose, from the surface's centroid, in which the map's
        +z lies.
    """

    directions: Mapping[str, Annotated[FloatArray, Axes(3)]]
    radii: Mapping[str, float]
    up: Annotated[FloatArray, Axes(3)] = field(default_factory=lambda: NORTH)
