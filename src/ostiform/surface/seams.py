"""Sewing: two rims that run along one curve are given the same vertices, bit for bit."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.errors import InputError
from ostiform.surface.types import Surface

_TOLERANCE_IN_EDGES = 0.25
"""Two rims count as one curve when they are closer than a quarter of an edge: sampling a curve of
radius R with edges of length h misses it by h^2 / (8 R), which is less for any h below 2 R."""


@dataclass(frozen=True, slots=True, eq=False)
class SewnSeam:
    """Two surfaces whose rims at a seam hold the same positions in opposite order.

    Attributes
    ----------
    first, second : Surface
    moved_mm : float
        The largest distance that a vertex was moved.
    n_inserted : int
        How many vertices the two rims were given.
    """

    first: Surface
    second: Surface
    moved_mm: float
    n_inserted: int


def default_tolerance(first: FloatArray, second: FloatArray) -> float:
    """Return the distance within which two closed polylines (n, 3), (m, 3) count as one curve."""
    medians = [float(np.median(_edge_lengths(loop))) for loop in (first, second)]
    return _TOLERANCE_IN_EDGES * max(medians)


def loop_gap(first: FloatArray, second: FloatArray) -> float:
    """Return the largest distance of a vertex of either closed polyline from the other.

    Parameters
    ----------
    first, second : (n, 3), (m, 3) float64

    Returns
    -------
    float
        In the unit of the vertices.
    """
    return max(
        float(_on_polyline(first, second)[2].max()), float(_on_polyline(second, first)[2].max())
    )


def sewn_seam(
    first: Surface, first_ostium: str, second: Surface, second_ostium: str, tolerance: float
) -> SewnSeam:
    """Give the rims of two surfaces at a seam the same vertices.

    Vertices of the two rims that are each other's nearest within the tolerance are matched, and
    the second takes the position of the first. A vertex without a match is inserted into the
    other rim, whose triangle there is divided.

    Parameters
    ----------
    first, second : Surface
        Consistently oriented, so that the two rims run in opposite directions.
    first_ostium, second_ostium : str
        The names of the loops that are one curve.
    tolerance : float, mm

    Raises
    ------
    InputError
        If the rims are further apart than the tolerance, or their vertices do not follow each
        other in one order.
    """
    first_loop, second_loop = first.loops[first_ostium], second.loops[second_ostium][::-1]
    one, two = first.vertices[first_loop], second.vertices[second_loop]  # (n, 3), (m, 3)
    gap = loop_gap(one, two)
    if gap > tolerance:
        raise InputError(
            f"expected two rims closer than {tolerance:.3g} mm everywhere, found them "
            f"{gap:.3g} mm apart: check the files or raise welding.tolerance_mm"
        )
    match = _mutual_nearest(one, two, tolerance)  # (m,)
    moved = two.copy()
    moved[match >= 0] = one[match[match >= 0]]
    unmatched_one = np.setdiff1d(np.arange(len(one)), match)
    unmatched_two = np.flatnonzero(match < 0)
    new_first, order_one = _inserted(one, two, unmatched_two)
    new_second, order_two = _inserted(moved, one, unmatched_one)
    # Label every vertex of the common curve: matched and first's own by first's index.
    labels_one = [label if own else -1 - label for own, label in order_one]
    labels_two = [
        (int(match[label]) if match[label] >= 0 else -1 - label) if own else label
        for own, label in order_two
    ]
    start = labels_two.index(labels_one[0]) if labels_one[0] in labels_two else 0
    if labels_two[start:] + labels_two[:start] != labels_one:
        raise InputError(
            "expected two rims whose vertices follow each other in one order, found them folded "
            "over each other within the tolerance: lower welding.tolerance_mm or extract both "
            "parts from one contour"
        )
    positions = second.vertices.copy()
    positions[second_loop] = moved
    return SewnSeam(
        first=_with_rim_vertices(first, first.vertices, first_ostium, new_first),
        second=_with_rim_vertices(
            second, positions, second_ostium, _reversed(new_second, len(two))
        ),
        moved_mm=float(np.linalg.norm(moved - two, axis=1).max()),
        n_inserted=len(unmatched_one) + len(unmatched_two),
    )


def _edge_lengths(loop: FloatArray) -> FloatArray:
    lengths: FloatArray = np.linalg.norm(np.roll(loop, -1, axis=0) - loop, axis=1)
    return lengths


def _on_polyline(points: FloatArray, loop: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return edge, fraction along it and distance of each point's nearest on a closed polyline."""
    start, edge = loop, np.roll(loop, -1, axis=0) - loop  # (n, 3)
    offset = points[:, None] - start  # (p, n, 3)
    squared = np.maximum((edge**2).sum(axis=1), np.finfo(np.float64).tiny)
    fraction = np.clip((offset * edge).sum(axis=2) / squared, 0.0, 1.0)  # (p, n)
    distance = np.linalg.norm(offset - fraction[..., None] * edge, axis=2)  # (p, n)
    nearest = distance.argmin(axis=1)
    row = np.arange(len(points))
    return nearest, fraction[row, nearest], distance[row, nearest]


def _mutual_nearest(one: FloatArray, two: FloatArray, tolerance: float) -> IntArray:
    """Return for each vertex of `two` its match in `one`, -1 where there is none."""
    distance = np.linalg.norm(two[:, None] - one, axis=2)  # (m, n)
    nearest = distance.argmin(axis=1)
    row = np.arange(len(two))
    is_mutual = distance.argmin(axis=0)[nearest] == row
    return np.where(is_mutual & (distance[row, nearest] <= tolerance), nearest, -1)


def _inserted(
    loop: FloatArray, others: FloatArray, chosen: IntArray
) -> tuple[dict[int, FloatArray], list[tuple[bool, int]]]:
    """Place chosen vertices of another curve on a loop.

    Returns
    -------
    insertions : dict of int to (k, 3)
        The positions to insert after each vertex of the loop, in order.
    order : list of (own, index)
        The resulting curve: own vertices of the loop and chosen ones of the other.
    """
    edges, fractions, _ = _on_polyline(others[chosen], loop)
    insertions: dict[int, FloatArray] = {}
    order: list[tuple[bool, int]] = []
    for k in range(len(loop)):
        here = np.flatnonzero(edges == k)
        here = here[np.argsort(fractions[here], kind="stable")]
        order.append((True, k))
        order.extend((False, int(chosen[i])) for i in here)
        if len(here):
            insertions[k] = others[chosen[here]]
    return insertions, order


def _reversed(insertions: Mapping[int, FloatArray], length: int) -> dict[int, FloatArray]:
    """Return insertions for the loop run the other way: edge k becomes edge n - 2 - k."""
    return {(length - 2 - k) % length: points[::-1] for k, points in insertions.items()}


def _with_rim_vertices(
    surface: Surface,
    positions: FloatArray,
    ostium: str,
    insertions: Mapping[int, FloatArray],
) -> Surface:
    """Divide rim edges at given positions, each triangle into a fan about its opposite corner."""
    loop = surface.loops[ostium].tolist()
    faces = surface.faces.tolist() if insertions else []
    rim = {(u, v): -1 for u, v in zip(loop, loop[1:] + loop[:1], strict=True)}
    for f, face in enumerate(faces):
        for k in range(3):
            if (face[k], face[(k + 1) % 3]) in rim:
                rim[face[k], face[(k + 1) % 3]] = f
    added: list[FloatArray] = []
    new_loop: list[int] = []
    for k, (u, v) in enumerate(zip(loop, loop[1:] + loop[:1], strict=True)):
        new_loop.append(u)
        if k not in insertions:
            continue
        first_new = len(positions) + len(added)
        added.extend(insertions[k])
        between = list(range(first_new, first_new + len(insertions[k])))
        new_loop.extend(between)
        face = rim[u, v]
        opposite = next(w for w in faces[face] if w not in (u, v))
        chain = [u, *between, v]
        fan = [[a, b, opposite] for a, b in zip(chain, chain[1:], strict=False)]
        faces[face] = fan[0]
        if (v, opposite) in rim:
            rim[v, opposite] = len(faces) + len(fan) - 2
        faces.extend(fan[1:])
    return Surface(
        vertices=np.vstack([positions, *added]),
        faces=np.array(faces, dtype=np.int64) if insertions else surface.faces,
        loops={**surface.loops, ostium: np.array(new_loop, dtype=np.int64)},
    )
