"""Point location on the sphere: which triangle holds a direction, and where on a circle it lies.

Open rims are closed by fans of triangles round the centre of their circle, so that a walk from
triangle to triangle is never blocked by a hole and every query lands. A direction that ends in a
fan lies beyond the chords of a rim; it is moved along the great circle through the centre onto
the rim (design 4).
"""

from typing import Annotated

import numpy as np
from scipy.spatial import cKDTree

from ostiform.arrays import FloatArray, IntArray
from ostiform.compiled import kernel
from ostiform.errors import ConvergenceError, InputError
from ostiform.surface.halfedges import twin_half_edges
from ostiform.surface.sphere import normalised
from ostiform.surface.topology import boundary_loops
from ostiform.values import Axes, IndexOf, value

# A query is outside an edge when the sine of its angle off the edge's great circle, times the
# sine of the angle under which the edge is seen, exceeds the rounding of a determinant.
OUTSIDE = 1e-15


@value
class SphereLocator:
    """A triangulation of the sphere prepared for many point locations.

    Attributes
    ----------
    points : (V + L, 3) float64
        The triangulation's vertices, then the apex of each of the L fans that close its holes.
    faces : (F + C, 3) int64
        Its faces, then the C fan triangles (rim vertex, previous rim vertex, apex).
    twins : (3 (F + C),) int64
        Twin of every half-edge.
    n_faces : int
        How many faces are the triangulation's own.
    start : (6 R R,) int64
        Where the walk starts: for every cell of a cube round the sphere, R x R cells a side, a
        face at the point nearest to the cell's centre (by k-d tree).
    """

    points: Annotated[FloatArray, Axes("Q", 3)]
    faces: Annotated[IntArray, Axes("G", 3), IndexOf("Q")]
    twins: Annotated[IntArray, Axes(None)]
    n_faces: int
    start: Annotated[IntArray, Axes(None), IndexOf("G")]


def sphere_locator(directions: FloatArray, faces: IntArray) -> SphereLocator:
    """Prepare a fold-free triangulation of the sphere, holes allowed, for `locate`.

    Parameters
    ----------
    directions : (V, 3) float64
        Unit vectors; each rim runs monotonically round its circle.
    faces : (F, 3) int64
        Positively oriented. Does not check for folds.

    Returns
    -------
    SphereLocator

    Raises
    ------
    InputError
        If there is no face.
    TopologyError
        If the faces are not a consistently oriented manifold.
    """
    if len(faces) == 0:
        raise InputError("faces: expected at least one triangle to locate points in, found none")
    loops = boundary_loops(faces)
    apexes = np.empty((len(loops), 3))
    fans = [faces]
    for k, loop in enumerate(loops):
        rim = directions[loop]
        # Twice the vector area of the rim polygon: its normal, pointing away from the hole because
        # the surface is on the left.
        apexes[k] = -np.cross(rim, np.roll(rim, -1, axis=0)).sum(axis=0)
        apex = np.full(len(loop), len(directions) + k)
        fans.append(np.stack([np.roll(loop, -1), loop, apex], axis=1))
    points = np.concatenate([directions, normalised(apexes)]) if loops else directions
    completed = np.concatenate(fans)
    at_point = np.zeros(len(points), dtype=np.int64)
    # Reversed, so that a rim vertex starts in a face of the surface rather than in a fan.
    order = np.arange(len(completed))[::-1]
    at_point[completed[order].ravel()] = np.repeat(order, 3)
    resolution = int(np.ceil(np.sqrt(len(points) / 6)))  # about one cell per point
    nearest = cKDTree(points).query(_cell_centres(resolution))[1]
    return SphereLocator(
        points=points,
        faces=completed,
        twins=twin_half_edges(completed, len(points)),
        n_faces=len(faces),
        start=at_point[nearest],
    )


def containing_triangles(locator: SphereLocator, queries: FloatArray) -> IntArray:
    """Return which triangle of the completed sphere holds each direction.

    A remembering visibility walk from a triangle nearby, its choices pseudo-random
    from the query's index (deterministic).

    Parameters
    ----------
    locator : SphereLocator
    queries : (n, 3) float64
        Unit vectors.

    Returns
    -------
    triangles : (n,) int64
        Index into ``locator.faces``; fan triangles from ``locator.n_faces`` on.

    Raises
    ------
    ConvergenceError
        If no triangle holds a query, which happens only when the triangulation is folded.
    """
    queries = np.ascontiguousarray(queries, dtype=np.float64)
    if len(queries) == 0:
        return np.zeros(0, dtype=np.int64)
    triangles, lost = _walk(locator.points, locator.faces, locator.twins, queries, locator.start)
    if lost >= 0:
        raise ConvergenceError(
            f"point location: expected a triangle that holds query {int(lost)}, found none: the "
            "triangulation of the sphere is folded"
        )
    found: IntArray = triangles
    return found


def locate(locator: SphereLocator, queries: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the face and the gnomonic barycentric coordinates of each direction.

    The direction is parallel to the combination of the corners with these coordinates
    (``det(b, c, p) : det(c, a, p) : det(a, b, p)``, scaled to sum 1). A direction beyond a rim is
    moved onto the rim: its face is the one at the rim edge, the coordinate of the corner off the
    rim is zero.

    Parameters
    ----------
    locator : SphereLocator
    queries : (n, 3) float64
        Unit vectors.

    Returns
    -------
    face : (n,) int64
    barycentric : (n, 3) float64
        Non-negative, sum 1.

    Raises
    ------
    ConvergenceError
        As `containing_triangles`.
    """
    queries = np.ascontiguousarray(queries, dtype=np.float64)
    triangles = containing_triangles(locator, queries)
    face, barycentric = _barycentric(
        locator.points, locator.faces, locator.twins, locator.n_faces, queries, triangles
    )
    return face, barycentric


def curve_positions(curve_angles: FloatArray) -> tuple[FloatArray, float]:
    """Return the angle travelled along a closed curve on a circle up to each of its vertices.

    Parameters
    ----------
    curve_angles : (n,) float64
        Angle of each vertex in order, radians.

    Returns
    -------
    positions : (n + 1,) float64
        From 0 at the first vertex to 2 pi back there, increasing.
    sign : float
        1 where the curve runs with increasing angle (a seam), -1 with decreasing (a rim).

    Raises
    ------
    InputError
        If the vertices do not run once round the circle in one direction, or two neighbours are
        half a turn or more apart.
    """
    turn = 2.0 * np.pi
    steps = np.roll(curve_angles, -1) - curve_angles  # (n,)
    # Once round, the steps modulo a turn add up to one turn forwards, to n - 1 backwards.
    sign = -1.0 if np.mod(steps, turn).sum() > 1.5 * turn else 1.0
    lengths = np.mod(sign * steps, turn)
    positions = np.concatenate([[0.0], np.cumsum(lengths)])
    once = abs(positions[-1] - turn) < 1e-6 * turn
    if not once or (lengths <= 0.0).any() or (lengths >= np.pi).any():
        raise InputError(
            "curve angles: expected vertices that run once round their circle in one direction, "
            f"less than half a turn apart, found {len(curve_angles)} vertices whose steps add up "
            f"to {positions[-1] / turn:.3g} turns, the longest {lengths.max(initial=0.0):.3g} "
            "radians"
        )
    return positions, sign


def _cell_centres(resolution: int) -> FloatArray:
    # Unit vectors (6 R R, 3) in the order of `_cell`.
    middle = (2.0 * np.arange(resolution) + 1.0) / resolution - 1.0
    u, v = (grid.ravel() for grid in np.meshgrid(middle, middle, indexing="ij"))
    centres = np.empty((6, resolution * resolution, 3))
    for axis in range(3):
        for negative in range(2):
            side = centres[2 * axis + negative]
            side[:, axis] = 1.0 - 2.0 * negative
            side[:, (axis + 1) % 3], side[:, (axis + 2) % 3] = u, v
    return normalised(centres.reshape(-1, 3))


@kernel
def _cell(p: FloatArray, resolution: int) -> int:
    axis = 0
    for d in range(1, 3):
        if abs(p[d]) > abs(p[axis]):
            axis = d
    scale = 0.5 * resolution / abs(p[axis])
    i = int(scale * p[(axis + 1) % 3] + 0.5 * resolution)
    j = int(scale * p[(axis + 2) % 3] + 0.5 * resolution)
    side = 2 * axis + (1 if p[axis] < 0.0 else 0)
    return (side * resolution + min(i, resolution - 1)) * resolution + min(j, resolution - 1)


@kernel(inline="always")
def _sidedness(
    points: FloatArray, a: int, b: int, p: FloatArray
) -> tuple[float, float]:  # det(a, b, p) from differences, which keeps its digits, and its scale
    ax, ay, az = points[a, 0] - p[0], points[a, 1] - p[1], points[a, 2] - p[2]
    bx, by, bz = points[b, 0] - p[0], points[b, 1] - p[1], points[b, 2] - p[2]
    determinant = (
        p[0] * (ay * bz - az * by) + p[1] * (az * bx - ax * bz) + p[2] * (ax * by - ay * bx)
    )
    return determinant, np.sqrt((ax * ax + ay * ay + az * az) * (bx * bx + by * by + bz * bz))


@kernel
def _walk(
    points: FloatArray, faces: IntArray, twins: IntArray, queries: FloatArray, start: IntArray
) -> tuple[IntArray, int]:
    found = np.empty(len(queries), dtype=np.int64)
    resolution = int(np.round(np.sqrt(len(start) / 6)))
    for q in range(len(queries)):
        p = queries[q]
        triangle = start[_cell(p, resolution)]
        came_from = -1  # half-edge of `triangle` that the walk came through
        state = q
        landed = False
        for _ in range(len(faces)):
            state = (state * 1664525 + 1013904223) & 0x7FFFFFFF  # Numerical Recipes' generator
            first = (state >> 16) % 3
            leave = -1
            for i in range(3):
                k = (first + i) % 3
                h = 3 * triangle + k
                if h == came_from:
                    continue
                side, scale = _sidedness(
                    points, faces[triangle, k], faces[triangle, (k + 1) % 3], p
                )
                if side < -OUTSIDE * scale:
                    leave = h
                    break
            if leave < 0:
                landed = True
                break
            came_from = twins[leave]
            triangle = came_from // 3
        if landed:
            landed = _holds(points, faces, triangle, p)
        if not landed:
            triangle = _search(points, faces, p)
            if triangle < 0:
                return found, q
        found[q] = triangle
    return found, -1


@kernel
def _holds(points: FloatArray, faces: IntArray, triangle: int, p: FloatArray) -> bool:
    a, b, c = faces[triangle, 0], faces[triangle, 1], faces[triangle, 2]
    for k in range(3):  # in the triangle's hemisphere, not the opposite one
        v = faces[triangle, k]
        if points[v, 0] * p[0] + points[v, 1] * p[1] + points[v, 2] * p[2] > 0.0:
            break
    else:
        return False
    inside = True
    for u, v in ((a, b), (b, c), (c, a)):
        side, scale = _sidedness(points, u, v, p)
        inside = inside and side >= -10.0 * OUTSIDE * scale
    return inside


@kernel
def _search(points: FloatArray, faces: IntArray, p: FloatArray) -> int:
    for triangle in range(len(faces)):
        if _holds(points, faces, triangle, p):
            return triangle
    return -1


@kernel
def _barycentric(
    points: FloatArray,
    faces: IntArray,
    twins: IntArray,
    n_faces: int,
    queries: FloatArray,
    triangles: IntArray,
) -> tuple[IntArray, FloatArray]:
    face = np.empty(len(queries), dtype=np.int64)
    barycentric = np.zeros((len(queries), 3))
    for q in range(len(queries)):
        p = queries[q]
        t = triangles[q]
        a, b, c = faces[t, 0], faces[t, 1], faces[t, 2]
        w0 = max(_sidedness(points, b, c, p)[0], 0.0)
        w1 = max(_sidedness(points, c, a, p)[0], 0.0)
        w2 = max(_sidedness(points, a, b, p)[0], 0.0)
        if t >= n_faces:  # a fan: its first half-edge is the rim edge seen from the hole
            total = w0 + w1
            share = w0 / total if total > 0.0 else 0.5
            h = twins[3 * t]
            face[q] = h // 3
            barycentric[q, h % 3] = 1.0 - share  # the twin runs from b to a
            barycentric[q, (h % 3 + 1) % 3] = share
        else:
            total = w0 + w1 + w2
            face[q] = t
            if total > 0.0:
                barycentric[q, 0] = w0 / total
                barycentric[q, 1] = w1 / total
                barycentric[q, 2] = w2 / total
            else:
                barycentric[q, :] = 1.0 / 3.0
    return face, barycentric
