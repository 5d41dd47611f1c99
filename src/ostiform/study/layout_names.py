"""Names from the circles of a base domain: which loops lie as the circles do.

Both are brought into one plane: the sphere of a component from its pole (the seam, else the widest
circle), a shape by the directions of its loops about the centre of the seam, else of its area,
against the longest loop. On either side of a seam the points are scaled to one size, because long
veins crowd on the sphere; what is compared is their places about the axis, up to one turn.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from ostiform.arrays import BoolArray, FloatArray
from ostiform.study.matching import LARGEST_TRIAL, n_ways
from ostiform.study.survey import ShapeSurvey
from ostiform.surface import Seam, split_ostium_name

_NOISE = 0.05
"""Misfits are compared after adding this share of the points' size."""


@dataclass(frozen=True, slots=True, eq=False)
class LayoutCircle:
    """A circle of the base domain on its component's sphere.

    Attributes
    ----------
    center : (3,) float64
        Unit vector.
    radius : float
        In any unit, the same for all circles.
    """

    center: FloatArray
    radius: float


@dataclass(frozen=True, slots=True, eq=False)
class LayoutNames:
    """The names of a shape's loops that fit a layout best, and how much better than any other.

    Attributes
    ----------
    names : mapping of str to dict
        Loop of each ostium, by part.
    margin : float
        1 - (misfit + 0.05) / (that of the second best way + 0.05), misfits as shares of the
        points' size; 1 where there is no other way.
    """

    names: Mapping[str, Mapping[str, int]]
    margin: float


@dataclass(frozen=True, slots=True, eq=False)
class _Sphere:
    """What stands upright on the sphere of a component: where its chart looks at, and what is."""

    origin: FloatArray
    axis: FloatArray
    known: Mapping[str, int]


def names_by_layout(
    survey: ShapeSurvey,
    ostia: Mapping[str, Sequence[str]],
    components: Sequence[Sequence[str]],
    seams: Sequence[Seam],
    layout: Mapping[str, LayoutCircle],
) -> LayoutNames | None:
    """Name the loops of a shape as the circles of a base domain lie.

    Parameters
    ----------
    survey : ShapeSurvey
        With as many loops as ostia in every part.
    ostia : mapping of str to sequence of str
        The ostia of every part.
    components : sequence of sequence of str
        The parts that seams join.
    seams : sequence of Seam
    layout : mapping of str to LayoutCircle
        By full ostium name; of every opening that is no seam's.

    Returns
    -------
    LayoutNames or None
        None where the layout does not tell: a circle is missing, a seam is not known, or there
        are too many ways.
    """
    names: dict[str, dict[str, int]] = {}
    margin = 1.0
    for group in components:
        own = [seam for seam in seams if split_ostium_name(seam.first)[0] in group]
        found = _component_names(survey, {part: ostia[part] for part in group}, own, layout)
        if found is None:
            return None
        names.update({part: dict(loops) for part, loops in found.names.items()})
        margin = min(margin, found.margin)
    return LayoutNames({part: names[part] for part in ostia}, margin)


def _component_names(
    survey: ShapeSurvey,
    ostia: Mapping[str, Sequence[str]],
    seams: Sequence[Seam],
    layout: Mapping[str, LayoutCircle],
) -> LayoutNames | None:
    at_seams = {name for seam in seams for name in (seam.first, seam.second)}
    rims = [f"{p}.{o}" for p, listed in ostia.items() for o in listed if f"{p}.{o}" not in at_seams]
    known = {
        f"{part}.{ostium}": k for part in ostia for ostium, k in survey.parts[part].known.items()
    }
    if any(name not in known for name in at_seams) or any(name not in layout for name in rims):
        return None
    asked = [name for name in rims if name not in known]
    if not asked:
        return LayoutNames(_by_part(ostia, known), 1.0)
    if seams:
        upright = _about_seam(survey, seams[0])
        sphere_axis = np.array([0.0, 0.0, 1.0])
        compared = rims
    else:
        (part,) = ostia
        pole = max(rims, key=lambda name: layout[name].radius)
        upright = _about_longest(survey, part, pole)
        known |= upright.known
        sphere_axis = -layout[pole].center
        compared = [name for name in rims if name != pole]
        asked = [name for name in asked if name not in known]
    fixed = _chart(np.array([layout[name].center for name in compared]), sphere_axis)
    ways = _ways(survey, ostia, asked, known)
    if ways is None or not compared:
        return None
    is_south = np.array([layout[name].center @ sphere_axis < 0.0 for name in compared])
    fixed = _scaled(fixed[None], is_south)[0]
    places = [[_loop_center(survey, name, way[name]) for name in compared] for way in ways]
    moving = _chart((np.array(places) - upright.origin).reshape(-1, 3), upright.axis)
    moving = _scaled(moving.reshape(len(ways), -1), is_south)
    # The best turn makes sum |turn w - z|^2 smallest.
    common = np.abs((moving.conj() * fixed).sum(axis=1))
    squares = (np.abs(moving) ** 2).sum(axis=1) + float((np.abs(fixed) ** 2).sum()) - 2.0 * common
    misfit = np.sqrt(np.maximum(squares, 0.0) / len(compared))
    order = np.argsort(misfit, kind="stable")
    best = {**known, **ways[order[0]]}
    margin = 1.0
    if len(order) > 1:
        margin = 1.0 - float((misfit[order[0]] + _NOISE) / (misfit[order[1]] + _NOISE))
    return LayoutNames(_by_part(ostia, best), margin)


def _by_part(
    ostia: Mapping[str, Sequence[str]], loops: Mapping[str, int]
) -> dict[str, dict[str, int]]:
    return {part: {o: loops[f"{part}.{o}"] for o in listed} for part, listed in ostia.items()}


def _loop_center(survey: ShapeSurvey, name: str, loop: int) -> FloatArray:
    return survey.parts[split_ostium_name(name)[0]].loops[loop].center


def _about_seam(survey: ShapeSurvey, seam: Seam) -> _Sphere:
    first, ostium = split_ostium_name(seam.first)
    second = split_ostium_name(seam.second)[0]
    origin = _loop_center(survey, seam.first, survey.parts[first].known[ostium])
    axis = survey.parts[second].center - survey.parts[first].center
    return _Sphere(origin, axis, {})


def _about_longest(survey: ShapeSurvey, part: str, pole: str) -> _Sphere:
    facts = survey.parts[part]
    longest = facts.known.get(
        split_ostium_name(pole)[1], int(np.argmax([loop.perimeter for loop in facts.loops]))
    )
    axis = facts.center - facts.loops[longest].center
    return _Sphere(facts.center, axis, {pole: longest})


def _ways(
    survey: ShapeSurvey,
    ostia: Mapping[str, Sequence[str]],
    asked: Sequence[str],
    known: Mapping[str, int],
) -> list[dict[str, int]] | None:
    """Return every way to give the free loops to the names asked for, with the known ones."""
    by_part: list[list[dict[str, int]]] = []
    total = 1
    for part in ostia:
        mine = [name for name in asked if split_ostium_name(name)[0] == part]
        taken = {k for name, k in known.items() if split_ostium_name(name)[0] == part}
        free = [k for k in range(len(survey.parts[part].loops)) if k not in taken]
        total *= n_ways(len(free), len(mine))
        if len(free) < len(mine) or total > LARGEST_TRIAL:
            return None
        chosen = permutations(free, len(mine))
        by_part.append([dict(zip(mine, loops, strict=True)) for loops in chosen])
    return [
        {**known, **{name: k for some in choice for name, k in some.items()}}
        for choice in product(*by_part)
    ]


def _chart(points: FloatArray, axis: FloatArray) -> FloatArray:
    """Return points (n, 3) about an axis as complex numbers (n,): half angle and azimuth.

    Those beyond the equator are seen from the other end, at the same azimuth.
    """
    up = axis / np.linalg.norm(axis)
    helper = np.eye(3)[int(np.argmin(np.abs(up)))]
    first = np.cross(up, helper)
    first /= np.linalg.norm(first)
    second = np.cross(up, first)
    length = np.maximum(np.linalg.norm(points, axis=1), 1e-300)
    height = points @ up / length
    from_axis = np.arccos(np.clip(np.abs(height), 0.0, 1.0))
    placed: FloatArray = np.tan(0.5 * from_axis) * np.exp(
        1j * np.arctan2(points @ second, points @ first)
    )
    return placed


def _scaled(points: FloatArray, is_south: BoolArray) -> FloatArray:
    """Return points (m, n) with those of either side scaled to a mean square of one."""
    scaled = points.copy()
    for side in (is_south, ~is_south):
        if side.any():
            size = np.sqrt((np.abs(points[:, side]) ** 2).mean(axis=1, keepdims=True))
            scaled[:, side] = points[:, side] / np.maximum(size, 1e-300)
    return scaled
