"""Control points of the warps, and the basis fields they carry (HY 2.3, design 5)."""

from typing import Annotated

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from ostiform.arrays import FloatArray, IntArray
from ostiform.correspondence.fields import (
    FieldBasis,
    bump_fields,
    global_fields,
    join_fields,
    twist_fields,
)
from ostiform.domain import Circle, Template
from ostiform.surface import unique_edges
from ostiform.values import Axes, value

# Support of an interior spline over the mean chord to the three nearest control points of its
# part, and the limits of that support: fields narrower than a few template edges would only
# follow the triangulation, wider ones are covered by the global fields.
SUPPORT_OVER_SPACING = 1.6
NARROWEST, WIDEST = 0.3, 1.4

# Support of the sliding of a circle across it, over the circle's radius, and its limits.
SLIDE_RADII = 4.0
NARROWEST_SLIDE, WIDEST_SLIDE = 0.2, 0.8

# Angles from a circle over which its surroundings turn with it, as far as the next circle lets
# them: the wrong rotation of a rim turns half the way to its neighbours, by a profile that these
# fields together follow.
WIDE_TURNS = (0.15, 0.25, 0.4, 0.65, 1.0)


@value
class ControlPoints:
    """Where the values of the vector fields are given.

    Attributes
    ----------
    directions : (C, 3) float64
        Unit vectors on the component spheres.
    sphere : (C,) int64
    part : (C,) int64
        Index into `Template.parts`; for a boundary point -1.
    curve : (C,) int64
        Index into `Template.curves` of the circle of a boundary point; -1 for an interior point.
    level : (C,) int64
        Level at which the point was inserted.
    support : (C,) float64
        Chord (interior) or angle from the circle (boundary) at which its field vanishes.
    """

    directions: Annotated[FloatArray, Axes("C", 3)]
    sphere: Annotated[IntArray, Axes("C")]
    part: Annotated[IntArray, Axes("C")]
    curve: Annotated[IntArray, Axes("C")]
    level: Annotated[IntArray, Axes("C")]
    support: Annotated[FloatArray, Axes("C")]

    @property
    def n_interior(self) -> int:
        """Number of control points in the interior (the paper ends with 10)."""
        return int((self.curve < 0).sum())

    @property
    def n_boundary(self) -> int:
        """Number of control points on the circles."""
        return int((self.curve >= 0).sum())


def no_control_points() -> ControlPoints:
    """Return the empty set."""
    none = np.zeros(0, np.int64)
    return ControlPoints(np.zeros((0, 3)), none, none, none, none, np.zeros(0))


def joined(first: ControlPoints, second: ControlPoints) -> ControlPoints:
    """Return the points of two sets, in order."""
    return ControlPoints(
        *(
            np.concatenate([getattr(first, name), getattr(second, name)])
            for name in ("directions", "sphere", "part", "curve", "level", "support")
        )
    )


def boundary_control_points(circles: FloatArray, level: int) -> ControlPoints:
    """Return 2 L - 1 equally spaced points on every circle (1 at level 1: its rotation alone).

    An odd number, so that the trigonometric polynomial through their values is unique and the
    fields of a coarser level lie in the span of the finer ones.
    """
    points = no_control_points()
    count = 2 * level - 1
    angles = 2.0 * np.pi * np.arange(count) / count
    for row, circle in enumerate(circles):
        support = float(np.clip(SLIDE_RADII * circle[3], NARROWEST_SLIDE, WIDEST_SLIDE))
        on_circle = ControlPoints(
            _on_circle(circle, angles),
            np.full(count, int(circle[7])),
            np.full(count, -1),
            np.full(count, row),
            np.full(count, level),
            np.full(count, support),
        )
        points = joined(points, on_circle)
    return points


def insert_interior(
    points: ControlPoints, template: Template, mean_shape: FloatArray, level: int
) -> ControlPoints:
    """Return interior control points with 4^(L - 1) more in every part (HY 2.3).

    Each is the template point of the part farthest, along the edges of the mean surface, from
    its openings, its seams and all the control points that the part already has.

    Parameters
    ----------
    points : ControlPoints
        Interior points of the levels before.
    template : Template
        Whose points are the candidates.
    mean_shape : (P, 3) float64, mm
        The current mean at the template's points.
    level : int
        At least 2.
    """
    for part in range(len(template.parts)):
        chosen = _farthest_points(points, template, mean_shape, part, 4 ** (level - 1))
        if not len(chosen):
            continue
        directions = template.points[chosen]
        peers = np.concatenate([points.directions[points.part == part], directions])
        points = joined(
            points,
            ControlPoints(
                directions,
                template.sphere[chosen],
                np.full(len(chosen), part),
                np.full(len(chosen), -1),
                np.full(len(chosen), level),
                _supports(directions, peers),
            ),
        )
    return points


def basis_of(
    interior: ControlPoints, boundary: ControlPoints, circles: FloatArray, n_spheres: int
) -> FieldBasis:
    """Return the fields of control points, after the global ones.

    Those are the six conformal fields of every sphere and, for every circle, the turning of its
    surroundings as a whole.

    The interior points come first in the numbering of `FieldBasis.control`.
    """
    bases = [global_fields(circles, sphere) for sphere in range(n_spheres)]
    bases += [
        twist_fields(circles, row, np.zeros(1), width, np.full(1, -1))
        for row in range(len(circles))
        for width in WIDE_TURNS
    ]
    bases.append(
        bump_fields(
            circles,
            interior.sphere,
            interior.directions,
            interior.support,
            np.arange(len(interior.directions)),
        )
    )
    for row in range(len(circles)):
        mine = np.flatnonzero(boundary.curve == row)
        count = len(mine)
        if count:
            angles = 2.0 * np.pi * np.arange(count) / count
            support = float(boundary.support[mine[0]])
            control = len(interior.directions) + mine
            bases.append(twist_fields(circles, row, angles, support, control))
    return join_fields(bases, circles)


def _on_circle(circle: FloatArray, angles: FloatArray) -> FloatArray:
    return Circle(circle[:3], float(circle[3])).points(angles)


def _supports(directions: FloatArray, peers: FloatArray) -> FloatArray:
    chords = np.sort(np.linalg.norm(directions[:, None] - peers[None], axis=2), axis=1)[:, 1:4]
    if chords.shape[1] == 0:
        return np.full(len(directions), WIDEST)
    supports: FloatArray = np.clip(SUPPORT_OVER_SPACING * chords.mean(axis=1), NARROWEST, WIDEST)
    return supports


def _farthest_points(
    points: ControlPoints, template: Template, mean_shape: FloatArray, part: int, count: int
) -> IntArray:
    """Return template points of a part by farthest-point insertion along the mean surface."""
    faces = template.faces[template.face_part == part]
    edges = unique_edges(faces)[0]
    lengths = np.linalg.norm(mean_shape[edges[:, 0]] - mean_shape[edges[:, 1]], axis=1)
    n_points = len(template.points)
    graph = sparse.csr_array((lengths, (edges[:, 0], edges[:, 1])), shape=(n_points, n_points))
    in_part = np.zeros(n_points, dtype=bool)
    in_part[faces] = True
    candidates = in_part & (template.curve < 0)
    sites = np.flatnonzero(in_part & (template.curve >= 0))
    known = [
        int(np.argmin(np.where(in_part, -(template.points @ direction), np.inf)))
        for direction in points.directions[points.part == part]
    ]
    sources = np.concatenate([sites, np.array(known, dtype=np.int64)])
    if len(sources):
        distance = dijkstra(graph, directed=False, indices=sources, min_only=True)
    else:  # a closed part without control points: the first is the one farthest from its middle
        distance = np.linalg.norm(mean_shape - mean_shape[in_part].mean(axis=0), axis=1)
    chosen: list[int] = []
    while len(chosen) < count:
        scores = np.where(candidates, distance, 0.0)
        farthest = int(np.argmax(scores))
        if not scores[farthest] > 0.0:
            break
        reached: FloatArray = dijkstra(  # type: ignore[call-overload]  # stubs lack csr_array
            graph, directed=False, indices=farthest
        )
        distance = np.minimum(distance, reached) if len(sources) or chosen else reached
        chosen.append(farthest)
    return np.array(chosen, dtype=np.int64)
