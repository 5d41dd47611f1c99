"""What a term of the objective is: its value at a shape's state, and its Gauss-Newton system."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.correspondence.state import Linearised, WarpState


@dataclass(frozen=True, slots=True, eq=False)
class System:
    """Half the gradient of a term, and half its Gauss-Newton matrix in pieces.

    The matrix is ``matrix + sum_q inertia_q |motion of landmark q|^2 - explained explained^T``;
    a piece that is None is zero. The pieces of several terms are added before a matrix is formed.

    Attributes
    ----------
    half_gradient : (D,) float64
        By the coefficients of a flow composed on top.
    matrix : (D, D) float64 or None
    inertia : (Q,) float64 or None
        mm^-2.
    explained : (D, K) float64 or None
        What a form of the landmarks does not charge.
    """

    half_gradient: FloatArray
    matrix: FloatArray | None = None
    inertia: FloatArray | None = None
    explained: FloatArray | None = None


class Term(Protocol):
    """One term of a shape's objective."""

    def value(self, state: WarpState, transform: FloatArray) -> float:
        """Return the term of a shape that a transform (4, 4) aligns."""

    def system(self, at: Linearised) -> System:
        """Return half the gradient and half the Gauss-Newton matrix about a state."""


def summed(systems: Iterable[System]) -> System:
    """Return the system of a sum of terms."""
    every = list(systems)
    explained = [one.explained for one in every if one.explained is not None]
    return System(
        np.sum([one.half_gradient for one in every], axis=0),
        _sum([one.matrix for one in every if one.matrix is not None]),
        _sum([one.inertia for one in every if one.inertia is not None]),
        np.concatenate(explained, axis=1) if explained else None,
    )


def _sum(arrays: list[FloatArray]) -> FloatArray | None:
    if not arrays:
        return None
    total = arrays[0].copy()
    for array in arrays[1:]:
        total += array
    return total
