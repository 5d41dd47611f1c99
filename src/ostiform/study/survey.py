"""What telling the openings of a population apart needs to know of each shape."""

from collections.abc import Mapping, Sequence
from dataclasses import field
from typing import Annotated

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.study.naming import LoopFacts, loop_facts
from ostiform.study.opened import OpenedShape
from ostiform.study.shape import ShapeId
from ostiform.surface import face_areas
from ostiform.values import Axes, value

_SAMPLES = 400
"""Points that stand for a surface: about 5 mm apart on a left atrium."""


@value
class PartSurvey:
    """One part of one shape, in millimetres and LPS.

    Attributes
    ----------
    center : (3,) float64
        Centroid of the area.
    area : float
        In mm^2.
    diagonal : float
        Of the bounding box.
    samples : (400, 3) float64
        Points spread over the surface by area.
    loops : tuple of LoopFacts
    known : mapping of str to int
        Loops named already, by ostium.
    """

    center: Annotated[FloatArray, Axes(3)]
    area: float
    diagonal: float
    samples: Annotated[FloatArray, Axes(None, 3)]
    loops: tuple[LoopFacts, ...]
    known: Mapping[str, int]


@value
class ShapeSurvey:
    """The parts of one shape, by name, and rough points of its openings from its own files.

    Attributes
    ----------
    id : ShapeId
    parts : mapping of str to PartSurvey
    points : mapping of str to (3,) float64, mm in LPS
        By full ostium name.
    """

    id: ShapeId
    parts: Mapping[str, PartSurvey]
    points: Mapping[str, Annotated[FloatArray, Axes(3)]] = field(default_factory=dict)

    @property
    def diagonal(self) -> float:
        """Diagonal of the box round all samples, mm."""
        return float(np.linalg.norm(np.ptp(self.samples, axis=0)))

    @property
    def samples(self) -> FloatArray:
        """The samples of all parts."""
        return np.concatenate([part.samples for part in self.parts.values()])


def part_survey(
    vertices: FloatArray,
    faces: IntArray,
    loops: Sequence[IntArray],
    known: Mapping[str, int],
) -> PartSurvey:
    """Return the facts of an opened part."""
    areas = face_areas(vertices, faces)  # (F,)
    centroids = vertices[faces].mean(axis=1)  # (F, 3)
    total = float(areas.sum())
    steps = total * (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    chosen = np.minimum(np.searchsorted(np.cumsum(areas), steps), len(faces) - 1)
    return PartSurvey(
        center=areas @ centroids / total if total > 0.0 else vertices.mean(axis=0),
        area=total,
        diagonal=float(np.linalg.norm(np.ptp(vertices, axis=0))),
        samples=centroids[chosen],
        loops=tuple(loop_facts(vertices, loop) for loop in loops),
        known=known,
    )


def shape_survey(opened: OpenedShape) -> ShapeSurvey:
    """Return the facts of an opened shape."""
    return ShapeSurvey(
        opened.id,
        {
            name: part_survey(part.vertices, part.faces, part.loops, part.known)
            for name, part in opened.parts.items()
        },
        opened.points,
    )
