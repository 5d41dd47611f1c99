"""The names of one shape's loops."""

from collections.abc import Mapping
from dataclasses import field

from ostiform.values import value

Names = Mapping[str, Mapping[str, int]]
"""Loop of each ostium, by part."""

MIRRORED = (
    "fits the other shapes far better as its mirror image: check the orientation and the frame of "
    "its file, or name its subject in shapes.reflect"
)


@value
class ShapeNames:
    """The names of a shape's loops.

    Attributes
    ----------
    names : mapping of str to mapping of str to int
        Loop of each ostium, by part.
    closed : mapping of str to tuple of int
        Loops to close, by part.
    notes : tuple of str
        What is worth saying about how they were found, one sentence each.
    """

    names: Mapping[str, Mapping[str, int]]
    closed: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def noted(names: ShapeNames, note: str | None) -> ShapeNames:
    """Return names with one more note."""
    return names if note is None else ShapeNames(names.names, names.closed, (*names.notes, note))
