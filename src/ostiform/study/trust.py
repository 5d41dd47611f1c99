"""What is made of names that contradict how the population is built."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from ostiform.study.agreement import agreement
from ostiform.study.matching import n_ways
from ostiform.study.rough_points import Naming, direct_names
from ostiform.study.shape import ShapeId
from ostiform.study.shape_names import MIRRORED, ShapeNames, noted
from ostiform.study.survey import ShapeSurvey

LEAST_MARGIN = 0.1
"""The best way to name a shape's loops must fit a tenth better than the second best. Six left
atria of patients have 0.2 to 0.7."""

_MOST_WAYS = 5040
"""Names that were given are compared with those of up to seven openings of a part."""


@dataclass(frozen=True, slots=True)
class Trusted:
    """What is made of the names that shapes were given.

    Attributes
    ----------
    named : mapping of ShapeId to ShapeNames
        Shapes that keep their names.
    stated : mapping of ShapeId to names
        Those among them that others may be named from.
    unnamed : mapping of ShapeId to ShapeSurvey
        Shapes whose names are to be found anew, loops known by seams alone.
    notes, problems : mapping of ShapeId to str
        Of shapes that are named anew, and of those that are left out.
    """

    named: Mapping[ShapeId, ShapeNames]
    stated: dict[ShapeId, dict[str, dict[str, int]]]
    unnamed: Mapping[ShapeId, ShapeSurvey] = field(default_factory=dict)
    notes: Mapping[ShapeId, str] = field(default_factory=dict)
    problems: Mapping[ShapeId, str] = field(default_factory=dict)


def trusted_names(
    naming: Naming,
    sound: Sequence[ShapeSurvey],
    stated: dict[ShapeId, dict[str, dict[str, int]]],
) -> Trusted:
    """Compare the names that shapes were given with each other by geometry.

    Parameters
    ----------
    naming : Naming
    sound : sequence of ShapeSurvey
    stated : dict of ShapeId to names
        Of the shapes that were given names of their own.
    """
    given = dict(stated)
    if stated:
        direct = ((s.id, direct_names(naming, s)) for s in sound if s.id not in stated)
        given |= {shape: names for shape, names in direct if names is not None}
    bare = {s.id: _bare(naming, s) for s in sound if s.id in given}
    plain = {shape: ShapeNames(names) for shape, names in stated.items()}
    if not stated or len(bare) < 2 or not all(_has_ways(naming, s) for s in bare.values()):
        return Trusted(plain, stated)
    found = agreement(tuple(bare.values()), given, naming.ostia, LEAST_MARGIN)
    against = {shape: one for shape, one in found.contradictions.items() if shape in stated}
    order = sorted(stated, key=lambda shape: shape != found.reference)
    agreeing = {shape: stated[shape] for shape in order if shape not in against}
    trust = naming.settings.ostia.trust
    if not agreeing and len(given) == len(stated) and trust is not None:
        agreeing = {found.reference: stated[found.reference]}
        against.pop(found.reference)
    named = {shape: plain[shape] for shape in agreeing}
    named |= {s: noted(named[s], MIRRORED) for s in found.mirrored if s in named}
    how = (
        "the other shapes"
        if agreeing
        else "each other, and no majority of the shapes says which are right"
    )
    told = {
        shape: f"the names given contradict {how}: given {given}; by geometry {seen}"
        for shape, one in against.items()
        for given, seen in (one.readings(),)
    }
    if trust == "names":
        named |= {shape: noted(plain[shape], f"{told[shape]}: kept as given") for shape in told}
        return Trusted(named, agreeing)
    if trust == "geometry":
        notes = {shape: f"{why}: named by geometry" for shape, why in told.items()}
        return Trusted(named, agreeing, {shape: bare[shape] for shape in told}, notes)
    advice = 'mend them, or say which counts by ostia.trust = "names" or "geometry"'
    return Trusted(named, agreeing, problems={s: f"{why}: {advice}" for s, why in told.items()})


def _bare(naming: Naming, survey: ShapeSurvey) -> ShapeSurvey:
    """Return a shape of whose loops only those at seams are known."""
    at_seams = {name for seam in naming.settings.seam_pairs for name in (seam.first, seam.second)}
    parts = {
        part: replace(
            facts, known={o: k for o, k in facts.known.items() if f"{part}.{o}" in at_seams}
        )
        for part, facts in survey.parts.items()
    }
    return replace(survey, parts=parts)


def _has_ways(naming: Naming, survey: ShapeSurvey) -> bool:
    """Return whether there are other ways to name a shape, and not too many to try."""
    ways = [
        n_ways(len(facts.loops) - len(facts.known), len(naming.ostia[part]) - len(facts.known))
        for part, facts in survey.parts.items()
    ]
    return 1 < max(ways) <= _MOST_WAYS
