"""Nested coarser levels of a template (HY: the multi-resolution property)."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ostiform.arrays import BoolArray, FloatArray, IntArray
from ostiform.domain.delaunay import spherical_delaunay, without_caps
from ostiform.domain.template import face_parts
from ostiform.domain.types import BaseDomain, Template, TemplateLevel
from ostiform.errors import InputError

FEWEST_ON_CURVE = 4
"""Points kept on every circle: enough to see it, and for its edges to be shorter than a
quarter turn."""


def with_levels(
    template: Template,
    domain: BaseDomain,
    counts: Sequence[int],
    positions: FloatArray | None = None,
) -> Template:
    """Return a template with nested coarser levels, coarsest first.

    Every level holds the points of the coarser ones. Each circle keeps a share of its points,
    evenly spread; the others are added by farthest-point order. A level is the spherical
    Delaunay triangulation of its points without the caps of the rims; a point so near to a seam
    that it would break an edge of it waits for a finer level.

    Parameters
    ----------
    template : Template
    domain : BaseDomain
        Of the template.
    counts : sequence of int
        Points of each level, ascending, fewer than the template's.
    positions : (P, 3) float64, optional
        Where the points lie on the (mean) surface: distances are measured there. On the sphere if
        absent.

    Returns
    -------
    Template
        The same, its levels replaced.

    Raises
    ------
    InputError
        If the counts do not ascend, reach the template's, or do not leave room for the circles.
    """
    n_points = len(template.points)
    bounds = [0, *counts, n_points]
    if any(low >= high for low, high in zip(bounds, bounds[1:], strict=False)):
        raise InputError(
            f"levels: expected ascending numbers of points below the template's {n_points}, found "
            f"{', '.join(str(count) for count in counts)}"
        )
    metric = template.points if positions is None else positions
    if positions is None and len(domain.spheres) > 1:  # spheres apart: no distances across
        metric = template.points + 4.0 * template.sphere[:, None]
    chosen = np.zeros(n_points, dtype=np.bool_)
    levels = []
    for count in counts:
        chosen = _chosen(template, domain, metric, chosen, count)
        levels.append(_level(template, domain, chosen))
    return replace(template, levels=tuple(levels))


def _chosen(
    template: Template, domain: BaseDomain, metric: FloatArray, coarser: BoolArray, count: int
) -> BoolArray:
    chosen = coarser.copy()
    share = np.sqrt(count / len(template.points))
    for index in range(len(template.curves)):
        loop = template.loops[template.curves[index]]
        wanted = min(len(loop), max(FEWEST_ON_CURVE, round(share * len(loop))))
        _spread_on_loop(chosen, loop, wanted)
    if chosen.sum() >= count:
        raise InputError(
            f"levels: expected more points than the {int(chosen.sum())} that the circles of the "
            f"openings and seams need, found a level of {count}"
        )
    usable = (template.curve < 0) & ~_encroaching(template, domain, chosen)
    # Points chosen at a coarser level stay; the curve's edges were longer there, so they are clear.
    _add_farthest(metric, template.sphere, chosen, usable, count)
    return chosen


def _spread_on_loop(chosen: BoolArray, loop: IntArray, wanted: int) -> None:
    # Farthest-point order along the loop, by steps: adds the point in the middle of the widest gap.
    if not chosen[loop].any():
        chosen[loop[0]] = True
    while chosen[loop].sum() < wanted:
        here = np.flatnonzero(chosen[loop])
        gaps = np.diff(np.concatenate([here, here[:1] + len(loop)]))
        widest = int(np.argmax(gaps))
        chosen[loop[(here[widest] + gaps[widest] // 2) % len(loop)]] = True


def _encroaching(template: Template, domain: BaseDomain, chosen: BoolArray) -> BoolArray:
    # Interior points inside the ball on an edge of a seam as diameter.
    inside = np.zeros(len(template.points), dtype=np.bool_)
    for index, sphere in enumerate(domain.spheres):
        own = np.flatnonzero(template.sphere == index)
        for seam in sphere.seams:
            loop = template.loops[seam.first]
            kept = template.points[loop[chosen[loop]]]
            following = np.roll(kept, -1, axis=0)
            for start, end in zip(kept, following, strict=True):
                # p is inside when it sees the edge under an obtuse angle.
                seen = np.einsum(
                    "ni,ni->n", template.points[own] - start, template.points[own] - end
                )
                inside[own[seen < 0]] = True
    return inside


def _add_farthest(
    metric: FloatArray, sphere: IntArray, chosen: BoolArray, usable: BoolArray, count: int
) -> None:
    nearest = np.full(len(metric), np.inf)
    for index in np.flatnonzero(chosen).tolist():
        _shorten(nearest, metric, index)
    while chosen.sum() < count:
        free = usable & ~chosen
        if not free.any():
            raise InputError(
                f"levels: expected {count} points clear of the seams, found {int(chosen.sum())}"
            )
        missing = [s for s in np.unique(sphere) if (chosen & (sphere == s)).sum() < 4]
        if missing:  # a triangulation needs four points on every sphere
            free &= sphere == missing[0]
        index = int(np.argmax(np.where(free, nearest, -1.0)))
        chosen[index] = True
        _shorten(nearest, metric, index)


def _shorten(nearest: FloatArray, metric: FloatArray, index: int) -> None:
    offset = metric - metric[index]
    np.minimum(nearest, np.einsum("ni,ni->n", offset, offset), out=nearest)


def _level(template: Template, domain: BaseDomain, chosen: BoolArray) -> TemplateLevel:
    index = np.flatnonzero(chosen)
    rims = np.array(
        [k for k, name in enumerate(template.curves) if _is_rim(domain, name)], dtype=np.int64
    )
    faces, parts = [], []
    offset = 0
    for number, sphere in enumerate(domain.spheres):
        own = np.flatnonzero(template.sphere[index] == number)
        points = template.points[index[own]]
        found = without_caps(spherical_delaunay(points), template.curve[index[own]], rims)
        faces.append(own[found])
        parts.append(offset + face_parts(sphere, points, found))
        offset += len(sphere.parts)
    return TemplateLevel(index, np.concatenate(faces), np.concatenate(parts))


def _is_rim(domain: BaseDomain, name: str) -> bool:
    return any(name in sphere.rims for sphere in domain.spheres)
