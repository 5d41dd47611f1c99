"""Cutting a surface along the zero curve of a height given at its vertices.

The curve becomes a chain of edges. Vertices that lie almost on it are moved onto it along an edge,
so that no slivers remain; nothing else is moved.
"""

from typing import Annotated

import numpy as np

from ostiform.arrays import BoolArray, FloatArray, IntArray
from ostiform.errors import InputError, TopologyError
from ostiform.surface.operators import face_areas
from ostiform.surface.topology import graph_labels, half_edges, unique_edges
from ostiform.values import Axes, value

_SNAP_SHARE = 0.25
"""A vertex this near to the curve, as a share of the edge that crosses it, is moved onto it."""


@value
class CutSurface:
    """A surface with a curve among its edges.

    Attributes
    ----------
    vertices : (V, 3) float64
        The given ones first.
    faces : (F, 3) int64
    source : (F,) int64
        The given face that each lies on.
    side : (F,) int64
        1 where the height is positive, -1 where it is negative.
    height : (V,) float64
        Zero on the curve that was cut, and only there.
    """

    vertices: Annotated[FloatArray, Axes("V", 3)]
    faces: Annotated[IntArray, Axes("F", 3)]
    source: Annotated[IntArray, Axes("F")]
    side: Annotated[IntArray, Axes("F")]
    height: Annotated[FloatArray, Axes("V")]


def cut_along_zero(
    vertices: FloatArray, faces: IntArray, height: FloatArray, chosen: BoolArray | None = None
) -> CutSurface:
    """Return the surface with the zero curve of a height among its edges.

    Parameters
    ----------
    vertices : (V, 3) float64
    faces : (F, 3) int64
    height : (V,) float64
        Linear along edges.
    chosen : (F,) bool, optional
        The faces that may be cut: all those that one closed curve crosses, or none of them.
    """
    allowed = np.ones(len(faces), dtype=np.bool_) if chosen is None else chosen
    height = np.where(height == 0.0, np.finfo(np.float64).tiny, height)
    vertices, height = _snapped(vertices, faces, height, allowed)
    sign = np.sign(height).astype(np.int64)
    corners = sign[faces]  # (F, 3)
    crossing = allowed & (corners.min(axis=1) < 0) & (corners.max(axis=1) > 0)
    points, pieces, parents, sides = _split(vertices, faces, np.flatnonzero(crossing), sign, height)
    kept = np.flatnonzero(~crossing)
    own = np.sign(corners[kept].sum(axis=1))
    return CutSurface(
        np.vstack([vertices, points]),
        np.concatenate([faces[kept], pieces]),
        np.concatenate([kept, parents]),
        np.concatenate([own, sides]),
        np.concatenate([height, np.zeros(len(points))]),
    )


def tube_cut(
    vertices: FloatArray, faces: IntArray, height: FloatArray, center: FloatArray, reach: float
) -> CutSurface:
    """Cut one tube off a surface: as `parted_at`, the smaller piece by area dropped."""
    cut = parted_at(vertices, faces, height, center, reach)
    area = face_areas(cut.vertices, cut.faces)
    larger = 1 if area[cut.side > 0].sum() >= area[cut.side < 0].sum() else -1
    kept = np.flatnonzero(cut.side == larger)
    return CutSurface(cut.vertices, cut.faces[kept], cut.source[kept], cut.side[kept], cut.height)


def parted_at(
    vertices: FloatArray, faces: IntArray, height: FloatArray, center: FloatArray, reach: float
) -> CutSurface:
    """Part a surface in two where a height is zero, and leave what else the zero set meets.

    The zero set meets the surface in closed curves; the one whose centre is nearest to the given
    point is cut.

    Parameters
    ----------
    vertices : (V, 3) float64
    faces : (F, 3) int64
        One connected surface.
    height : (V,) float64
    center : (3,) float64
        Where the tube is meant to be cut.
    reach : float
        The curve's centre must be within this distance of `center`.

    Returns
    -------
    CutSurface
        `side` is 1 and -1 for the faces of the two pieces, whatever the height far from the cut.

    Raises
    ------
    InputError
        If no closed curve is near.
    TopologyError
        If the curve does not cut the surface in two.
    """
    height = np.where(height == 0.0, np.finfo(np.float64).tiny, height)
    bands = _closed_bands(faces, height)
    away = [
        float(np.linalg.norm(_curve_center(vertices, faces[band], height) - center))
        for band in bands
    ]
    nearest = min(away, default=np.inf)
    if nearest > reach:
        found = "none" if not bands else f"the nearest {nearest:.3g} away"
        raise InputError(
            f"expected the cut to meet the surface in a closed curve within {reach:.3g} of its "
            f"centre, found {found}: check its centre, frame and units"
        )
    return _parted_in(vertices, faces, height, bands[away.index(nearest)])


def parted_along(vertices: FloatArray, faces: IntArray, height: FloatArray) -> CutSurface:
    """Part a surface in two along the longest closed curve on which a height is zero.

    Parameters and errors are those of `parted_at`.
    """
    height = np.where(height == 0.0, np.finfo(np.float64).tiny, height)
    bands = _closed_bands(faces, height)
    if not bands:
        raise InputError("expected a closed curve between the two, found none")
    return _parted_in(vertices, faces, height, max(bands, key=len))


def _closed_bands(faces: IntArray, height: FloatArray) -> list[IntArray]:
    """Return the faces that each closed curve of the zero set crosses."""
    above = height[faces] > 0.0  # (F, 3)
    crossing = np.flatnonzero(above.any(axis=1) & ~above.all(axis=1))
    _, edge, count = unique_edges(faces)
    edge = edge.reshape(-1, 3)
    is_cut_edge = above != np.roll(above, -1, axis=1)  # (F, 3)
    rows, slots = np.nonzero(is_cut_edge[crossing])
    keys = edge[crossing[rows], slots]
    order = np.argsort(keys, kind="stable")
    same = np.flatnonzero(keys[order][1:] == keys[order][:-1])
    label = graph_labels(rows[order[same]], rows[order[same + 1]], len(crossing))
    bands = [crossing[label == k] for k in range(int(label.max(initial=-1)) + 1)]
    # Others end at an opening.
    return [band for band in bands if (count[edge[band][is_cut_edge[band]]] == 2).all()]


def _parted_in(
    vertices: FloatArray, faces: IntArray, height: FloatArray, band: IntArray
) -> CutSurface:
    chosen = np.zeros(len(faces), dtype=np.bool_)
    chosen[band] = True
    return _with_pieces(cut_along_zero(vertices, faces, height, chosen))


def _curve_center(vertices: FloatArray, band: IntArray, height: FloatArray) -> FloatArray:
    start, end = band.reshape(-1), np.roll(band, -1, axis=1).reshape(-1)
    crosses = (height[start] > 0.0) != (height[end] > 0.0)
    start, end = start[crosses], end[crosses]
    share = height[start] / (height[start] - height[end])
    points = vertices[start] + share[:, None] * (vertices[end] - vertices[start])
    center: FloatArray = points.mean(axis=0)
    return center


def _with_pieces(cut: CutSurface) -> CutSurface:
    """Give the faces of either piece the side that the piece has along the curve."""
    _, edge, _ = unique_edges(cut.faces)
    order = np.argsort(edge, kind="stable")
    same = np.flatnonzero(edge[order][1:] == edge[order][:-1])
    one, two = order[same] // 3, order[same + 1] // 3
    ends_of = half_edges(cut.faces)[order[same]]  # (n, 2)
    is_curve = (cut.height[ends_of] == 0.0).all(axis=1) & (cut.side[one] != cut.side[two])
    label = graph_labels(one[~is_curve], two[~is_curve], len(cut.faces))
    along = np.concatenate([one[is_curve], two[is_curve]])
    pieces = np.unique(label[along])
    if len(pieces) != 2:
        raise TopologyError(
            f"expected a cut that parts the surface in two, found {len(pieces)} pieces along it: "
            "move the cut along its tube"
        )
    above = label[along[cut.side[along] > 0][0]]
    side = np.where(label == above, 1, -1)
    return CutSurface(cut.vertices, cut.faces, cut.source, side, cut.height)


def _snapped(
    vertices: FloatArray, faces: IntArray, height: FloatArray, allowed: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Move vertices that are almost on the curve onto it, along the edge that crosses nearest."""
    band = faces[allowed]
    start, end = band.reshape(-1), np.roll(band, -1, axis=1).reshape(-1)
    crosses = (height[start] > 0.0) != (height[end] > 0.0)
    one = np.concatenate([start[crosses], end[crosses]])
    two = np.concatenate([end[crosses], start[crosses]])
    share = height[one] / (height[one] - height[two])  # (n,)
    order = np.argsort(share, kind="stable")
    near = order[share[order] < _SNAP_SHARE]
    vertices, height = vertices.copy(), height.copy()
    on_curve = np.zeros(len(vertices), dtype=np.bool_)
    movable = np.unique(one[near])
    ring = _rings(faces[np.isin(faces, movable).any(axis=1)], set(movable.tolist()))
    for k in near.tolist():
        v = int(one[k])
        # A triangle with all corners on the curve would belong to neither side.
        if on_curve[v] or any(on_curve[a] and on_curve[b] for a, b in ring[v]):
            continue
        before = height[v]
        height[v] = 0.0
        beside = {w for edge in ring[v] for w in edge if on_curve[w]}
        if not all(_passes_once(ring[w], height) for w in (v, *beside)):
            height[v] = before
            continue
        vertices[v] = vertices[v] + share[k] * (vertices[two[k]] - vertices[v])
        on_curve[v] = True
    return vertices, height


def _passes_once(link: list[tuple[int, int]], height: FloatArray) -> bool:
    """Return whether a curve through a vertex would pass it once, by what lies round it."""
    around = {v for edge in link for v in edge}
    for sign in (1.0, -1.0):
        own = sum(sign * height[v] > 0.0 for v in around)
        joined = sum(sign * height[a] > 0.0 and sign * height[b] > 0.0 for a, b in link)
        if own - joined != 1:
            return False
    return True


def _rings(faces: IntArray, wanted: set[int]) -> dict[int, list[tuple[int, int]]]:
    ring: dict[int, list[tuple[int, int]]] = {v: [] for v in wanted}
    for a, b, c in faces.tolist():
        for v, pair in ((a, (b, c)), (b, (c, a)), (c, (a, b))):
            if v in ring:
                ring[v].append(pair)
    return ring


def _split(
    vertices: FloatArray, faces: IntArray, crossing: IntArray, sign: IntArray, height: FloatArray
) -> tuple[FloatArray, IntArray, IntArray, IntArray]:
    """Return new points and the pieces of the crossed faces with their parents and sides."""
    edges: dict[tuple[int, int], int] = {}
    points: list[FloatArray] = []
    pieces: list[tuple[int, int, int]] = []
    parents: list[int] = []
    sides: list[int] = []

    def middle(a: int, b: int) -> int:
        low, high = min(a, b), max(a, b)
        if (low, high) not in edges:
            edges[low, high] = len(vertices) + len(points)
            share = height[low] / (height[low] - height[high])
            points.append(vertices[low] + share * (vertices[high] - vertices[low]))
        return edges[low, high]

    for parent in crossing.tolist():
        a, b, c = faces[parent].tolist()
        signs = sign[[a, b, c]].tolist()
        if 0 in signs:
            a, b, c = _rotated((a, b, c), signs.index(0))
            m = middle(b, c)
            new = [((a, b, m), int(sign[b])), ((a, m, c), int(sign[c]))]
        else:
            lone = next(k for k in range(3) if signs.count(signs[k]) == 1)
            a, b, c = _rotated((a, b, c), lone)
            p, q = middle(a, b), middle(a, c)
            new = [((a, p, q), int(sign[a]))]
            from_p = np.linalg.norm(points[p - len(vertices)] - vertices[c])
            from_q = np.linalg.norm(points[q - len(vertices)] - vertices[b])
            rest = [(p, b, c), (p, c, q)] if from_p < from_q else [(p, b, q), (q, b, c)]
            new += [(piece, int(sign[b])) for piece in rest]
        for piece, side in new:
            pieces.append(piece)
            parents.append(parent)
            sides.append(side)
    return (
        np.array(points).reshape(-1, 3),
        np.array(pieces, dtype=np.int64).reshape(-1, 3),
        np.array(parents, dtype=np.int64),
        np.array(sides, dtype=np.int64),
    )


def _rotated(corners: tuple[int, int, int], first: int) -> tuple[int, int, int]:
    a, b, c = corners[first:] + corners[:first]
    return a, b, c
