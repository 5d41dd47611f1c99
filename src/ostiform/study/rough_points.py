"""Names from rough points in the frame of a shape's own file, and from caps and seams."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.study.layout_names import LayoutCircle
from ostiform.study.matching import LARGEST_TRIAL, direct_way, n_ways
from ostiform.study.naming import LoopFacts, listed_loops
from ostiform.study.parts import internal_factors
from ostiform.study.settings import StudySettings
from ostiform.study.survey import PartSurvey, ShapeSurvey

LEAST_DIRECT_MARGIN = 0.3
"""Rough points in the frame of the files, which need no alignment, must fit so much better one
way than any other."""


@dataclass(frozen=True, slots=True)
class Naming:
    """What naming works with: the settings, and what they say of each shape."""

    settings: StudySettings
    layout: Mapping[str, LayoutCircle]

    @property
    def ostia(self) -> dict[str, tuple[str, ...]]:
        """The ostia of every part."""
        return {part: listed.ostia for part, listed in self.settings.parts.items()}

    @property
    def points(self) -> dict[str, FloatArray]:
        """The rough points of the population, mm in LPS."""
        factors = internal_factors(self.settings)
        stated = self.settings.ostia.points
        return {name: factors * np.array(point) for name, point in stated.items()}

    def listed(self, loops: Sequence[LoopFacts]) -> str:
        """Return loops in words, in the units and frame of the files."""
        factors = internal_factors(self.settings)
        scale = abs(float(factors[0]))
        return listed_loops(
            [LoopFacts(f.center / factors, f.perimeter / scale, f.n_vertices) for f in loops],
            self.settings.units,
        )


def stated_names(naming: Naming, survey: ShapeSurvey) -> dict[str, dict[str, int]] | None:
    """Return the names of a shape whose openings are told apart without any other shape."""
    return names_by_points(naming, survey, survey.points, 0.0)


def names_by_points(
    naming: Naming, survey: ShapeSurvey, points: Mapping[str, FloatArray], least_margin: float
) -> dict[str, dict[str, int]] | None:
    """Return names from rough points in the shape's own frame, or None if they do not tell."""
    names: dict[str, dict[str, int]] = {}
    for part, ostia in naming.ostia.items():
        found = _part_by_points(survey.parts[part], part, ostia, points, least_margin)
        if found is None:
            return None
        names[part] = found
    return names


def _part_by_points(
    facts: PartSurvey,
    part: str,
    ostia: Sequence[str],
    points: Mapping[str, FloatArray],
    least_margin: float,
) -> dict[str, int] | None:
    named = dict(facts.known)
    asked = [ostium for ostium in ostia if ostium not in named]
    free = [k for k in range(len(facts.loops)) if k not in named.values()]
    guided = [ostium for ostium in asked if f"{part}.{ostium}" in points]
    unguided = [ostium for ostium in asked if ostium not in guided]
    if len(asked) > 1 or len(free) > len(asked):
        if len(unguided) > (len(free) == len(asked)):
            return None
        if n_ways(len(free), len(guided)) > LARGEST_TRIAL:
            return None
        centers = np.array([facts.loops[k].center for k in free])
        rough = np.array([points[f"{part}.{ostium}"] for ostium in guided])
        chosen, _, margin = direct_way(centers, rough)
        if margin < least_margin:
            return None
        named.update({ostium: free[k] for ostium, k in zip(guided, chosen.tolist(), strict=True)})
    left = [k for k in free if k not in named.values()]
    unnamed = [ostium for ostium in asked if ostium not in named]
    named.update(dict(zip(unnamed, left, strict=False)))
    return {ostium: named[ostium] for ostium in ostia}


def direct_names(naming: Naming, survey: ShapeSurvey) -> dict[str, dict[str, int]] | None:
    """Return names from the population's points, where they lie near the shape and tell."""
    points = naming.points
    names = names_by_points(naming, survey, points, LEAST_DIRECT_MARGIN) if points else None
    if names is None or misfit_of_points(survey, names, points) >= survey.diagonal / 2.0:
        return None
    return names


def misfit_of_points(
    survey: ShapeSurvey,
    names: Mapping[str, Mapping[str, int]],
    points: Mapping[str, FloatArray],
) -> float:
    """Return the root mean square distance of loops from their rough points."""
    squares = [
        float(((facts.loops[k].center - points[f"{part}.{ostium}"]) ** 2).sum())
        for part, facts in survey.parts.items()
        for ostium, k in names[part].items()
        if f"{part}.{ostium}" in points
    ]
    return float(np.sqrt(np.mean(squares))) if squares else 0.0
