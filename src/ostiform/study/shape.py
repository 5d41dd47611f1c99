"""One shape of a study: the parts of one subject at one phase, before and after naming."""

from collections.abc import Mapping
from dataclasses import dataclass

from ostiform.surface import Seam, Surface
from ostiform.values import value

NO_PHASE = ""
"""The phase of subjects without phases: none is invented for them."""


@dataclass(frozen=True, slots=True, order=True)
class ShapeId:
    """Who and when: names exactly as in the study, and the time as a fraction of the cycle."""

    subject: str
    phase: str
    time: float

    def __str__(self) -> str:
        """Return ``subject/phase``, or ``subject`` alone where it has no phases."""
        return f"{self.subject}/{self.phase}" if self.phase else self.subject


@value
class Shape:
    """The parts of one subject at one phase, in input coordinates.

    Attributes
    ----------
    id : ShapeId
    parts : mapping of str to Surface
        In study order, millimetres, LPS. Both sides of a seam hold the same positions.
    seams : tuple of Seam
    repairs : tuple of str
        What reading changed, one sentence each; empty where the files were used as they are.
    """

    id: ShapeId
    parts: Mapping[str, Surface]
    seams: tuple[Seam, ...]
    repairs: tuple[str, ...] = ()
