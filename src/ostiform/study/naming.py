"""Naming: each boundary loop of a part is given to one ostium of the study."""

from collections.abc import Mapping, Sequence
from typing import Annotated

import numpy as np
from scipy.optimize import linear_sum_assignment

from ostiform.arrays import FloatArray, IntArray
from ostiform.errors import InputError
from ostiform.values import Axes, value

_FARTHEST_IN_DIAGONALS = 0.5
"""A rough point further from its loop than half the part's bounding-box diagonal is no guide: it
is in another frame or unit."""


@value
class LoopFacts:
    """What tells loops apart, in the units and frame of the vertices they were taken from.

    Attributes
    ----------
    center : (3,) float64
        Mean along the loop.
    perimeter : float
    n_vertices : int
    """

    center: Annotated[FloatArray, Axes(3)]
    perimeter: float
    n_vertices: int


def loop_facts(vertices: FloatArray, loop: IntArray) -> LoopFacts:
    """Return the centre along the length, the perimeter and the vertex count of a closed loop."""
    start = vertices[loop]  # (n, 3)
    end = np.roll(start, -1, axis=0)
    lengths = np.linalg.norm(end - start, axis=1)  # (n,)
    perimeter = float(lengths.sum())
    if perimeter == 0.0:
        return LoopFacts(start.mean(axis=0), 0.0, len(loop))
    center = (lengths[:, None] * 0.5 * (start + end)).sum(axis=0) / perimeter
    return LoopFacts(center, perimeter, len(loop))


def named_loops(
    ostia: Sequence[str],
    loops: Sequence[LoopFacts],
    known: Mapping[str, int],
    points: Mapping[str, FloatArray],
    diagonal: float,
    units: str = "mm",
) -> dict[str, int]:
    """Assign loops to ostia, one to one.

    Loops already known (from a cap's value or a seam) keep their names. The others go to the
    rough points so that the sum of the distances from loop centre to point is smallest; one
    ostium without a point takes the loop that is left.

    Parameters
    ----------
    ostia : sequence of str
        The ostia of the part, in study order.
    loops : sequence of LoopFacts
    known : mapping of str to int
        Loops named already.
    points : mapping of str to (3,) float64
        Rough positions by ostium, in the units and frame of the loops.
    diagonal : float
        Diagonal of the part's bounding box.
    units : str
        For the messages.

    Returns
    -------
    dict of str to int
        Index of each ostium's loop, in study order.

    Raises
    ------
    InputError
        If the numbers differ, points are missing, or a point is nowhere near a loop.
    """
    if len(loops) != len(ostia):
        wanted = f"{len(ostia)} openings ({', '.join(ostia)})" if ostia else "a closed surface"
        raise InputError(
            f"expected {wanted}, found {len(loops)}{listed_loops(loops, units)}: open, close or "
            "repair the surface, or change the ostia of its part"
        )
    named = dict(known)
    open_names = [name for name in ostia if name not in known]
    open_loops = [k for k in range(len(loops)) if k not in known.values()]
    guided = [name for name in open_names if name in points]
    if len(open_names) - len(guided) > 1:
        missing = [name for name in open_names if name not in points]
        raise InputError(
            f"expected rough points in [ostia.points] to tell {', '.join(missing)} apart, found "
            f"none for these loops{listed_loops([loops[k] for k in open_loops], units)}"
        )
    if len(open_names) > 1:
        _check_points(guided, points, [loops[k] for k in open_loops], diagonal, units)
        centers = np.array([loops[k].center for k in open_loops])  # (n, 3)
        rough = np.array([points[name] for name in guided])  # (m, 3)
        distance = np.linalg.norm(rough[:, None] - centers, axis=2)  # (m, n)
        for row, column in zip(*linear_sum_assignment(distance), strict=True):
            named[guided[row]] = open_loops[column]
    left = [k for k in range(len(loops)) if k not in named.values()]
    named.update(zip([name for name in ostia if name not in named], left, strict=True))
    return {name: named[name] for name in ostia}


def _check_points(
    guided: Sequence[str],
    points: Mapping[str, FloatArray],
    loops: Sequence[LoopFacts],
    diagonal: float,
    units: str,
) -> None:
    for name in guided:
        nearest = min(float(np.linalg.norm(loop.center - points[name])) for loop in loops)
        if nearest > _FARTHEST_IN_DIAGONALS * diagonal:
            raise InputError(
                f"expected the rough point of {name} near an opening, found the nearest "
                f"{nearest:.3g} {units} away from it{listed_loops(loops, units)}: check its "
                "units and frame"
            )


def listed_loops(loops: Sequence[LoopFacts], units: str) -> str:
    """Return where loops are and how long, in words; empty where there are none."""
    if not loops:
        return ""
    return ": " + "; ".join(
        f"loop {k} at {_place(loop)} {units}, perimeter {loop.perimeter:.3g} {units}, "
        f"{loop.n_vertices} vertices"
        for k, loop in enumerate(loops, start=1)
    )


def _place(loop: LoopFacts) -> str:
    """Return the centre in words; what is nothing beside the perimeter is 0."""
    center = np.where(np.abs(loop.center) > 1e-6 * loop.perimeter, loop.center, 0.0)
    return f"[{', '.join(f'{x:.4g}' for x in center)}]"
