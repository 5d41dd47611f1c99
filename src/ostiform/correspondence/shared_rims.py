"""Rims that components share: where two surfaces meet at an opening, their points move as one.

Components are brought into correspondence apart, so that along a rim where two of them meet
(endo- and epicardium at a valve) the points of one slide against those of the other. Every point of
the second rim is tied to the place of the first rim, an edge and a share of it, that it is nearest
to on the mean. It lies there in every shape, a linear combination of the same two points, and so it
does in the mean and in every mode.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.correspondence.types import Correspondence
from ostiform.domain import Template
from ostiform.surface import split_ostium_name

_RINGS = 3
"""Rings of triangles beside the second rim that follow it, less and less."""


@dataclass(frozen=True, slots=True, eq=False)
class TiedRim:
    """The points of a rim as combinations of those of another.

    Attributes
    ----------
    first, second : str
    rim : (m,) int64
        Points of the second rim.
    start, end : (m,) int64
        Ends of the edge of the first rim that each lies on.
    share : (m,) float64
        How far along it.
    inner : (k,) int64
        Points beside the second rim.
    follow : (k, m) float64
        How much each of them moves with each point of the rim.
    """

    first: str
    second: str
    rim: IntArray
    start: IntArray
    end: IntArray
    share: FloatArray
    inner: IntArray
    follow: FloatArray


def tied_rims(
    template: Template, mean: FloatArray, pairs: Sequence[tuple[str, str]]
) -> tuple[TiedRim, ...]:
    """Return the rims that are tied, from the mean shape (P, 3) and pairs of full ostium names."""
    tied = []
    for first, second in pairs:
        loop, rim = template.loops[first], template.loops[second]
        edge, share, _ = _nearest_on_loop(mean[loop], mean[rim])
        part = template.parts.index(split_ostium_name(second)[0])
        inner, follow = _followers(template, part, rim)
        start, end = loop[edge], np.roll(loop, -1)[edge]
        tied.append(TiedRim(first, second, rim, start, end, share, inner, follow))
    return tuple(tied)


def with_tied_rims(points: FloatArray, tied: Sequence[TiedRim]) -> FloatArray:
    """Return the points (N, P, 3) of shapes with the second rims on the first ones."""
    moved = np.array(points, dtype=np.float64)
    for one in tied:
        share = one.share[:, None]
        target = (1.0 - share) * moved[:, one.start] + share * moved[:, one.end]
        shift = target - moved[:, one.rim]  # (N, m, 3)
        moved[:, one.inner] += one.follow @ shift
        moved[:, one.rim] = target
    return moved


def with_shared_rims(correspondence: Correspondence, tied: Sequence[TiedRim]) -> Correspondence:
    """Return a correspondence whose shared rims are tied, in input and in aligned coordinates.

    The directions stay as they are: they say where the points were before.
    """
    points = with_tied_rims(correspondence.points, tied)
    linear, shift = correspondence.transforms[:, :3, :3], correspondence.transforms[:, :3, 3]
    aligned = points @ np.swapaxes(linear, 1, 2) + shift[:, None]
    stays = np.ones(points.shape[1], dtype=np.bool_)
    for one in tied:
        stays[one.rim] = stays[one.inner] = False
    aligned[:, stays] = correspondence.aligned[:, stays]  # to the last digit
    return replace(correspondence, points=points, aligned=aligned)


def distances_of_rims(points: FloatArray, template: Template, tied: TiedRim) -> FloatArray:
    """Return how far the second rim of each shape (N,) is from the first, in the mean, in mm.

    Of polygons: rims that are one have up to the bow of an edge of the first.
    """
    loop = template.loops[tied.first]
    return np.array([_nearest_on_loop(own[loop], own[tied.rim])[2].mean() for own in points])


def _nearest_on_loop(
    loop: FloatArray, points: FloatArray
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return edge, share of it and distance (m,) of the nearest place of a loop (L, 3)."""
    along = np.roll(loop, -1, axis=0) - loop
    from_start = points[:, None] - loop  # (m, L, 3)
    square = np.maximum((along**2).sum(axis=1), np.finfo(np.float64).tiny)
    share = np.clip((from_start * along).sum(axis=2) / square, 0.0, 1.0)  # (m, L)
    away = np.linalg.norm(from_start - share[..., None] * along, axis=2)
    edge = away.argmin(axis=1)
    rows = np.arange(len(points))
    return edge, share[rows, edge], away[rows, edge]


def _followers(template: Template, part: int, rim: IntArray) -> tuple[IntArray, FloatArray]:
    """Return the points near a rim, and how they follow it: harmonic, at rest further in."""
    faces = template.faces[template.face_part == part]
    reached = np.zeros(len(template.points), dtype=np.bool_)
    reached[rim] = True
    for _ in range(_RINGS):
        reached[faces[reached[faces].any(axis=1)]] = True
    free = reached & (template.curve < 0)  # points of other rims and seams stay
    inner = np.flatnonzero(free)
    neighbours = _neighbours(faces)
    rank = {int(point): k for k, point in enumerate(inner)}
    on_rim = {int(point): k for k, point in enumerate(rim)}
    system = np.zeros((len(inner), len(inner)))
    right = np.zeros((len(inner), len(rim)))
    for point, k in rank.items():
        system[k, k] = len(neighbours[point])
        for other in neighbours[point]:
            if other in rank:
                system[k, rank[other]] -= 1.0
            elif other in on_rim:
                right[k, on_rim[other]] += 1.0
    return inner, np.asarray(np.linalg.solve(system, right), dtype=np.float64)


def _neighbours(faces: IntArray) -> Mapping[int, set[int]]:
    found: dict[int, set[int]] = {}
    for a, b, c in faces.tolist():
        for one, two in ((a, b), (b, c), (c, a)):
            found.setdefault(one, set()).add(two)
            found.setdefault(two, set()).add(one)
    return found
