"""Matching the openings of one shape to named ones, whatever its pose.

Every way to give the open loops to the names is tried: the landmarks that it implies (centroids
of parts, centres of loops) are superposed rigidly on the reference, and the superposed surfaces
are compared. The best way counts only if it beats the second best by a margin.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np
from scipy.spatial import cKDTree

from ostiform.arrays import FloatArray, IntArray
from ostiform.study.survey import ShapeSurvey

LARGEST_TRIAL = 50_000
"""Ways tried for one part: eight openings of eight loops are 40,320."""

_CANDIDATES = 24
"""Ways whose surfaces are compared."""

_OUT_OF_REACH = 9.0
_OPEN_SHARE = 0.01
"""Nor are ways whose landmarks alone misfit three times worse than the best, and by more than a
tenth of the square root of the area; the second best is always compared."""

_CLOSEST_POINT_ROUNDS = 3

_NOISE = 0.01
"""Misfits are compared after adding this share of the square root of the area, 1 mm for an atrium:
what differs by less tells nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class Landmarks:
    """A shape with every opening named, as the reference that others are matched to.

    Attributes
    ----------
    points : mapping of str to (3,) float64, mm
        By part (``"LA"``) and full ostium name (``"LA.RSPV"``).
    radii : mapping of str to float, mm
        Perimeter over two pi, by full ostium name.
    samples : (n, 3) float64, mm
        Of the surface.
    area : float, mm^2
    """

    points: Mapping[str, FloatArray]
    radii: Mapping[str, float]
    samples: FloatArray
    area: float


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """The best way to name the loops of a shape, and how much better it is than any other.

    Attributes
    ----------
    names : mapping of str to dict
        Loop of each ostium, by part.
    residual : float
        Root mean square misfit, as a share of the square root of the area.
    margin : float
        1 - (residual + 0.01) / that of the second best way; 1 where there is no other way.
    rival : mapping of str to dict
        The second best way.
    is_mirrored : bool
        Whether the shape fits far better as its mirror image.
    as_mirror : mapping of str to dict, or None
        Other names that it has as its mirror image, where that fits better, if not far better.
    """

    names: Mapping[str, Mapping[str, int]]
    residual: float
    margin: float
    rival: Mapping[str, Mapping[str, int]]
    is_mirrored: bool
    as_mirror: Mapping[str, Mapping[str, int]] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class _Trial:
    """The ways to name one part, all others being named or left out."""

    moving: FloatArray  # (n, L, 3)
    fixed: FloatArray  # (L, 3)
    radius_misfit: FloatArray  # (n,) mean square
    ways: tuple[dict[str, int], ...]


_MIRRORED_BELOW = 0.9
"""A shape is taken for its mirror image where that misfits less than this share, both after adding
`_NOISE`. Of generated atria, sound ones have 1.02 to 2.2 and mirrored ones 0.46 to 0.98; six sound
left atria of patients 1.4 to 1.6."""


def landmarks_of(survey: ShapeSurvey, names: Mapping[str, Mapping[str, int]]) -> Landmarks:
    """Return the landmarks of a shape whose openings are named."""
    points, radii = {}, {}
    for part, facts in survey.parts.items():
        points[part] = facts.center
        for ostium, k in names.get(part, {}).items():
            points[f"{part}.{ostium}"] = facts.loops[k].center
            radii[f"{part}.{ostium}"] = facts.loops[k].perimeter / (2.0 * np.pi)
    area = sum(facts.area for facts in survey.parts.values())
    return Landmarks(points, radii, survey.samples, area)


def moved_onto(landmarks: Landmarks, reference: Landmarks) -> Landmarks:
    """Return landmarks scaled to the reference's area and superposed on it rigidly."""
    names = [name for name in reference.points if name in landmarks.points]
    scale = float(np.sqrt(reference.area / landmarks.area))
    moving = scale * np.array([[landmarks.points[name] for name in names]])
    fixed = np.array([reference.points[name] for name in names])
    rotation, shift = _superposing(moving, fixed, mirrored=False)
    everything = scale * np.array(list(landmarks.points.values()))
    return Landmarks(
        dict(zip(landmarks.points, everything @ rotation[0].T + shift[0], strict=True)),
        {name: scale * radius for name, radius in landmarks.radii.items()},
        scale * landmarks.samples @ rotation[0].T + shift[0],
        reference.area,
    )


def best_match(
    survey: ShapeSurvey, ostia: Mapping[str, Sequence[str]], reference: Landmarks
) -> Match:
    """Name the loops of a shape as those of a reference.

    Parameters
    ----------
    survey : ShapeSurvey
        With as many loops as ostia in every part, or more.
    ostia : mapping of str to sequence of str
        The ostia of every part.
    reference : Landmarks
        With all openings named.
    """
    tree = cKDTree(reference.samples)
    proper = _matched(survey, ostia, reference, tree, None)
    mirror = _matched(survey, ostia, reference, tree, proper.residual)
    if mirror.residual + _NOISE < _MIRRORED_BELOW * (proper.residual + _NOISE):
        return mirror
    if mirror.residual < proper.residual and mirror.names != proper.names:
        return replace(proper, as_mirror=mirror.names)
    return proper


def _matched(
    survey: ShapeSurvey,
    ostia: Mapping[str, Sequence[str]],
    reference: Landmarks,
    tree: cKDTree,
    mirrored_below: float | None,
) -> Match:
    """Match a shape, or its mirror image where that is of interest below a residual."""
    mirrored = mirrored_below is not None
    area = sum(facts.area for facts in survey.parts.values())
    scale = float(np.sqrt(reference.area / area))
    names: dict[str, dict[str, int]] = {part: dict(f.known) for part, f in survey.parts.items()}
    rival = {part: dict(named) for part, named in names.items()}
    margin, residual = 1.0, 0.0
    # Parts with fewest ways first: what they fix helps to tell the others apart.
    order_of_parts = sorted(ostia, key=lambda p: len(ostia[p]) - len(survey.parts[p].known))
    for part in order_of_parts:
        trial = _trial(survey, names, part, ostia[part], reference, scale)
        enough = np.inf
        if mirrored_below is not None and part == order_of_parts[-1]:
            enough = mirrored_below**2 * reference.area
        costs = _costs(trial, scale * survey.samples, reference, tree, mirrored, enough)
        order = np.argsort(costs, kind="stable")
        names[part] = trial.ways[order[0]]
        residual = float(np.sqrt(costs[order[0]] / reference.area))
        if len(order) > 1:
            least = _NOISE * np.sqrt(reference.area)
            own = 1.0 - float(
                (np.sqrt(costs[order[0]]) + least) / (np.sqrt(costs[order[1]]) + least)
            )
            if own < margin:
                margin = own
                rival = {**names, part: trial.ways[order[1]]}
    return Match(names, residual, margin, rival, mirrored)


def _trial(
    survey: ShapeSurvey,
    names: Mapping[str, Mapping[str, int]],
    part: str,
    ostia: Sequence[str],
    reference: Landmarks,
    scale: float,
) -> _Trial:
    """Return every way to name a part, with the landmarks that it implies."""
    steady, fixed = [], []
    for other, facts in survey.parts.items():
        steady.append(facts.center)
        fixed.append(reference.points[other])
        for ostium, k in names[other].items():
            steady.append(facts.loops[k].center)
            fixed.append(reference.points[f"{other}.{ostium}"])
    facts = survey.parts[part]
    known = names[part]
    asked = [ostium for ostium in ostia if ostium not in known]
    free = [k for k in range(len(facts.loops)) if k not in known.values()]
    listed = list(permutations(free, len(asked)))
    chosen = np.array(listed, dtype=np.int64).reshape(len(listed), len(asked))  # (n, m)
    centers = np.array([loop.center for loop in facts.loops]).reshape(-1, 3)
    radii = np.array([loop.perimeter for loop in facts.loops]) / (2.0 * np.pi)
    fixed += [reference.points[f"{part}.{ostium}"] for ostium in asked]
    wanted = np.array([reference.radii[f"{part}.{ostium}"] for ostium in asked])
    moving = np.concatenate(
        [np.broadcast_to(np.array(steady), (len(chosen), len(steady), 3)), centers[chosen]], axis=1
    )
    misfit = ((scale * radii[chosen] - wanted) ** 2).sum(axis=1) / moving.shape[1]
    ways = tuple({**known, **dict(zip(asked, row, strict=True))} for row in chosen.tolist())
    ordered = tuple({name: way[name] for name in ostia} for way in ways)
    return _Trial(scale * moving, np.array(fixed), misfit, ordered)


def _costs(
    trial: _Trial,
    samples: FloatArray,
    reference: Landmarks,
    tree: cKDTree,
    mirrored: bool,
    enough: float,
) -> FloatArray:
    """Return the mean square misfit (n,) of every way; infinite where it is out of the running.

    Where the landmarks alone misfit by `enough` whatever the way, surfaces are not compared.
    """
    rotation, shift = _superposing(trial.moving, trial.fixed, mirrored)
    placed = np.einsum("nij,nlj->nli", rotation, trial.moving) + shift[:, None]
    costs = ((placed - trial.fixed) ** 2).sum(axis=2).mean(axis=1) + trial.radius_misfit
    if float(costs.min()) > enough:
        landmarks_only: FloatArray = costs
        return landmarks_only
    total = np.full(len(costs), np.inf)
    order = np.argsort(costs, kind="stable")[:_CANDIDATES]
    limit = max(_OUT_OF_REACH * float(costs.min()), _OPEN_SHARE * reference.area)
    best = second = np.inf
    for k in order[(costs[order] <= limit) | (np.arange(len(order)) < 2)].tolist():
        if costs[k] > second:
            break  # the landmarks alone misfit more than the two best ways do in all
        total[k] = costs[k] + _surface_misfit(rotation[k], shift[k], samples, reference, tree)
        best, second = sorted((best, second, total[k]))[:2]
    return total


def _surface_misfit(
    rotation: FloatArray,
    shift: FloatArray,
    samples: FloatArray,
    reference: Landmarks,
    tree: cKDTree,
) -> float:
    """Return the mean square distance of the samples of two surfaces, both ways."""
    for _ in range(_CLOSEST_POINT_ROUNDS):
        placed = samples @ rotation.T + shift
        nearest = tree.query(placed)[1]
        turn, step = _superposing(placed[None], reference.samples[nearest], mirrored=False)
        rotation, shift = turn[0] @ rotation, turn[0] @ shift + step[0]
    placed = samples @ rotation.T + shift
    there = np.asarray(tree.query(placed)[0])
    back = np.asarray(cKDTree(placed).query(reference.samples)[0])
    return float(0.5 * ((there**2).mean() + (back**2).mean()))


def _superposing(
    moving: FloatArray, fixed: FloatArray, mirrored: bool
) -> tuple[FloatArray, FloatArray]:
    """Return rotations (n, 3, 3), or rotations with a reflection, and shifts (n, 3)."""
    from_center, to_center = moving.mean(axis=1), fixed.mean(axis=0)
    correlation = np.einsum("lj,nli->nji", fixed - to_center, moving - from_center[:, None])
    u, _, vt = np.linalg.svd(correlation)
    sign = np.where(np.linalg.det(u @ vt) < 0.0, -1.0, 1.0)
    u[:, :, 2] *= (-sign if mirrored else sign)[:, None]
    rotation = u @ vt
    shift = to_center - np.einsum("nij,nj->ni", rotation, from_center)
    return rotation, shift


def n_ways(n_free: int, n_asked: int) -> int:
    """Return how many ways there are to give some of the loops to names."""
    ways = 1
    for k in range(n_asked):
        ways *= n_free - k
    return ways


def direct_way(centers: FloatArray, points: FloatArray) -> tuple[IntArray, float, float]:
    """Give loops to rough points of the same frame.

    Parameters
    ----------
    centers : (n, 3) float64
        Of the loops.
    points : (m, 3) float64
        At most n.

    Returns
    -------
    chosen : (m,) int64
        Loop of each point.
    residual : float
        Root mean square distance.
    margin : float
        1 - residual / that of the second best way; 1 where there is no other.
    """
    ways = np.array(list(permutations(range(len(centers)), len(points))), dtype=np.int64)
    ways = ways.reshape(-1, len(points))
    squared = ((centers[ways] - points) ** 2).sum(axis=2).mean(axis=1)
    order = np.argsort(squared, kind="stable")
    residual = float(np.sqrt(squared[order[0]]))
    if len(order) < 2:
        return ways[order[0]], residual, 1.0
    second = float(np.sqrt(squared[order[1]]))
    return ways[order[0]], residual, 1.0 - residual / max(second, 1e-300)
