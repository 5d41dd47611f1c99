"""Naming: each boundary loop of a part is given to one ostium of the study."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.values import Axes, value


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
