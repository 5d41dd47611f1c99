"""Whether the names that shapes were given agree with how the population is built."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ostiform.study.matching import Landmarks, Match, best_match, landmarks_of
from ostiform.study.shape import ShapeId
from ostiform.study.shape_names import Names
from ostiform.study.survey import ShapeSurvey

_REFERENCES = 3
"""Shapes that are tried as the one that most others agree with."""


@dataclass(frozen=True, slots=True, eq=False)
class Contradiction:
    """Two ways to read the openings of a shape.

    Attributes
    ----------
    stated, by_geometry : mapping of str to mapping of str to int
    stated_mm, by_geometry_mm : float
        Root mean square misfit to the shape that most others agree with.
    """

    stated: Names
    by_geometry: Names
    stated_mm: float
    by_geometry_mm: float

    def readings(self) -> tuple[str, str]:
        """Return both readings in words, of the openings that they name differently."""
        rows = [
            (part, ostium, k + 1, self.by_geometry[part][ostium] + 1)
            for part, own in self.stated.items()
            for ostium, k in own.items()
            if self.by_geometry[part][ostium] != k
        ]
        one, two = (
            ", ".join(f"{row[0]}.{row[1]} = loop {row[column]}" for row in rows)
            for column in (2, 3)
        )
        return (
            f"{one}, misfit {self.stated_mm:.3g} mm",
            f"{two}, misfit {self.by_geometry_mm:.3g} mm",
        )


@dataclass(frozen=True, slots=True, eq=False)
class Agreement:
    """Which shapes agree on the names.

    Attributes
    ----------
    reference : ShapeId
        One that most others agree with.
    contradictions : mapping of ShapeId to Contradiction
    mirrored : tuple of ShapeId
        Shapes whose names fit, but as those of its mirror image.
    """

    reference: ShapeId
    contradictions: Mapping[ShapeId, Contradiction]
    mirrored: tuple[ShapeId, ...]


def agreement(
    surveys: Sequence[ShapeSurvey],
    names: Mapping[ShapeId, Names],
    ostia: Mapping[str, Sequence[str]],
    least_margin: float,
) -> Agreement:
    """Compare the names of every shape with those that geometry gives it.

    The geometry is that of one shape that most others agree with; where there is none, every
    shape that contradicts another is among the contradictions.

    Parameters
    ----------
    surveys : sequence of ShapeSurvey
        Loops known by seams alone.
    names : mapping of ShapeId to names
        Of these shapes.
    ostia : mapping of str to sequence of str
    least_margin : float
        By which geometry must tell.
    """
    tried: list[Agreement] = []
    candidates = list(surveys)
    while candidates and len(tried) < _REFERENCES:
        tried.append(_compared(candidates[0], surveys, names, ostia, least_margin))
        against = tried[-1].contradictions
        if 2 * len(against) < len(surveys):
            return tried[-1]
        known = {found.reference for found in tried}
        candidates = [s for s in surveys if s.id in against and s.id not in known]
    every = {shape: one for found in reversed(tried) for shape, one in found.contradictions.items()}
    return replace(tried[0], contradictions=every)


def _compared(
    reference: ShapeSurvey,
    surveys: Sequence[ShapeSurvey],
    names: Mapping[ShapeId, Names],
    ostia: Mapping[str, Sequence[str]],
    least_margin: float,
) -> Agreement:
    landmarks = landmarks_of(reference, names[reference.id])
    against, mirrored = {}, []
    for survey in surveys:
        if survey.id == reference.id:
            continue
        match = best_match(survey, ostia, landmarks)
        if match.margin < least_margin:
            continue
        stated = names[survey.id]
        if all(dict(match.names[part]) == dict(stated[part]) for part in ostia):
            if match.is_mirrored:
                mirrored.append(survey.id)
        else:
            against[survey.id] = _contradiction(survey, stated, match, ostia, landmarks)
    return Agreement(reference.id, against, tuple(mirrored))


def _contradiction(
    survey: ShapeSurvey,
    stated: Names,
    match: Match,
    ostia: Mapping[str, Sequence[str]],
    landmarks: Landmarks,
) -> Contradiction:
    parts = {part: replace(facts, known=stated[part]) for part, facts in survey.parts.items()}
    as_stated = best_match(replace(survey, parts=parts), ostia, landmarks)
    length = float(np.sqrt(landmarks.area))
    return Contradiction(stated, match.names, length * as_stated.residual, length * match.residual)
