"""Which boundary loops of a surface are openings of the model, and which are cuts."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from ostiform.arrays import FloatArray
from ostiform.fitting.data import Data, PreparedSurface
from ostiform.fitting.patches import Patch, curve_distance
from ostiform.fitting.prior import FitPrior
from ostiform.surface import closest_points, surface_tree

REACH = 3.0
"""Standard deviations of what the modes leave within which a loop must lie."""

BEYOND_SHARE = 0.7
"""Share of a loop's vertices that are nearest to a rim, where the loop lies beyond it."""

BEYOND = 0.15
"""Of the model's size: how far beyond."""

FEWEST = 3
"""A loop of fewer vertices is no curve."""


def with_openings_matched(
    prior: FitPrior, data: Data, points: FloatArray
) -> tuple[Data, Mapping[str, str]]:
    """Return data whose unnamed loops near an opening of the placed model are that opening.

    A loop and a rim are matched one to one, least distance first in sum, where they lie within
    three standard deviations of what the modes leave plus an edge of the model. All others are
    taken for cuts, which pull nothing.

    Parameters
    ----------
    prior : FitPrior
    data : Data
    points : (Q, 3) float64, mm
        The model as fitted without the unnamed loops.

    Returns
    -------
    data : Data
    matched : mapping of str to str
        Opening of every matched loop, loops named ``"surface 1, loop 2"``.
    """
    matched: dict[str, str] = {}
    surfaces = []
    taken = {name for surface in data.surfaces for name in surface.rims}
    for number, surface in enumerate(data.surfaces, start=1):
        found = _matched(prior, data, surface, points, taken)
        rims = dict(surface.rims)
        for loop, name in found.items():
            rims[name] = surface.tree.vertices[surface.patch.loops[loop]]
            matched[f"surface {number}, loop {loop + 1}"] = name
        surfaces.append(replace(surface, rims=rims))
    return replace(data, surfaces=tuple(surfaces)), matched


def openings_left(prior: FitPrior, data: Data, points: FloatArray) -> tuple[str, ...]:
    """Return which openings of a fitted model are near a loop that was taken for a cut.

    Parameters
    ----------
    prior : FitPrior
    data : Data
    points : (Q, 3) float64, mm
    """
    taken = {name for surface in data.surfaces for name in surface.rims}
    notes = []
    for number, surface in enumerate(data.surfaces, start=1):
        free, names, cost = _distances(prior, surface, points, taken)
        for row, column in zip(*linear_sum_assignment(cost), strict=True):
            if cost[row, column] <= BEYOND * prior.size:
                notes.append(
                    f"surface {number}, loop {free[row] + 1}: taken for a cut, though "
                    f"{cost[row, column]:.1f} mm from {names[column]} is nearest to no other; name "
                    "it with --openings if it is that opening"
                )
        if free and names and not surface.rims:
            notes.append(
                f"surface {number}: none of its {len(free)} openings came near one of the model's "
                f"{len(names)}: check its pose (--pose unknown tries every rotation)"
            )
    return tuple(notes)


def _distances(
    prior: FitPrior, surface: PreparedSurface, points: FloatArray, taken: set[str]
) -> tuple[list[int], list[str], FloatArray]:
    """Return loops and openings that are still free, and how far they are apart, mm."""
    vertices = surface.tree.vertices
    known = {rim.tobytes() for rim in surface.rims.values()}
    free = [
        k
        for k, loop in enumerate(surface.patch.loops)
        if len(loop) >= FEWEST
        and not any(set(map(bytes, vertices[loop])) == _rows(rim) for rim in known)
    ]
    rims = prior.model.mesh.loops
    names = []
    seen = [frozenset(rims[name].tolist()) for name in surface.rims if name in rims]
    for name, rim in rims.items():
        own = frozenset(rim.tolist())
        is_of_part = surface.part is None or name.startswith(f"{surface.part}.")
        if is_of_part and name not in taken and own not in seen:
            names.append(name)
            seen.append(own)
    cost = np.array(
        [
            [curve_distance(vertices[surface.patch.loops[k]], points[rims[name]]) for name in names]
            for k in free
        ]
    ).reshape(len(free), len(names))
    return free, names, cost


def _matched(
    prior: FitPrior,
    data: Data,
    surface: PreparedSurface,
    points: FloatArray,
    taken: set[str],
) -> dict[int, str]:
    free, names, cost = _distances(prior, surface, points, taken)
    if not free or not names:
        return {}
    reach = np.array([_reach(prior, name) for name in names])
    beyond = _beyond_rims(prior, surface, data.patches[surface.part], points, free, names)
    reach = np.maximum(reach, np.where(beyond > BEYOND_SHARE, BEYOND * prior.size, 0.0))
    rows, columns = linear_sum_assignment(np.minimum(cost / reach, 10.0))
    return {
        free[row]: names[column]
        for row, column in zip(rows, columns, strict=True)
        if cost[row, column] <= reach[row, column]
    }


def _beyond_rims(
    prior: FitPrior,
    surface: PreparedSurface,
    patch: Patch,
    points: FloatArray,
    loops: list[int],
    names: list[str],
) -> FloatArray:
    """Return the share (loops, names) of each loop's vertices that are nearest to each rim."""
    vertices = np.ascontiguousarray(points[: len(prior.model.mean)])
    tree = surface_tree(vertices, patch.faces)
    rims = [prior.model.mesh.loops[name] for name in names]
    shares = np.zeros((len(loops), len(names)))
    for row, k in enumerate(loops):
        found = closest_points(tree, surface.tree.vertices[surface.patch.loops[k]])
        at_end = patch.ends_at(found)
        corner = np.take_along_axis(
            patch.faces[found.faces], found.barycentric.argmax(axis=1)[:, None], axis=1
        )[:, 0]
        shares[row] = [float((at_end & np.isin(corner, rim)).mean()) for rim in rims]
    return shares


def _reach(prior: FitPrior, name: str) -> float:
    amplitude = float(prior.leftover.amplitude[prior.model.mesh.loops[name]].mean())
    return REACH * amplitude * prior.deviation + prior.edge


def _rows(raw: bytes) -> set[bytes]:
    step = 24  # three coordinates in double precision
    return {raw[k : k + step] for k in range(0, len(raw), step)}
