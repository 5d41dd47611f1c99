"""A shape as its files hold it: repaired and cut open, its openings not named yet."""

from collections.abc import Mapping
from typing import Annotated

from ostiform.arrays import FloatArray
from ostiform.study.parts import OpenPart
from ostiform.study.shape import ShapeId
from ostiform.values import Axes, value


@value
class OpenedShape:
    """All that is kept of the files of a shape.

    Attributes
    ----------
    id : ShapeId
    parts : mapping of str to OpenPart
        In study order, millimetres, LPS; loops at seams that only fit one way are known.
    points : mapping of str to (3,) float64, mm
        Rough points of its openings from its own Markups file, by full ostium name.
    notes : tuple of str
        What is worth saying about its files, one sentence each.
    """

    id: ShapeId
    parts: Mapping[str, OpenPart]
    points: Mapping[str, Annotated[FloatArray, Axes(3)]]
    notes: tuple[str, ...]
