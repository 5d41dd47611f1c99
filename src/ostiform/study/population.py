"""Naming the openings of a whole population, and the shapes that do not belong to it.

Names are given once: by the values of caps, by rough points of one or of all shapes, or by the
circles of a domain written in the study. They reach every other shape by geometry (`matching`),
first from the shape that has them, then from the mean of all.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ostiform.study.layout_names import LayoutCircle, names_by_layout
from ostiform.study.matching import (
    Landmarks,
    Match,
    best_match,
    landmarks_of,
    moved_onto,
)
from ostiform.study.parts import internal_factors
from ostiform.study.rough_points import (
    LEAST_DIRECT_MARGIN,
    Naming,
    direct_names,
    misfit_of_points,
    names_by_points,
    stated_names,
)
from ostiform.study.settings import StudySettings
from ostiform.study.shape import ShapeId
from ostiform.study.shape_names import MIRRORED, Names, ShapeNames, noted
from ostiform.study.sizes import LARGEST_MM, other_sizes
from ostiform.study.survey import ShapeSurvey
from ostiform.study.trust import LEAST_MARGIN, trusted_names
from ostiform.surface import component_parts, split_ostium_name

OTHER_OPENING = 5.0
"""So many times the usual perimeter, or less than its inverse, is another opening or a nick."""


@dataclass(frozen=True, slots=True, eq=False)
class PopulationNames:
    """The names of every shape's loops.

    Attributes
    ----------
    names : mapping of ShapeId to ShapeNames
        The shapes that could be named.
    problems : mapping of ShapeId to str
        Why the others could not, one sentence each.
    """

    names: Mapping[ShapeId, ShapeNames]
    problems: Mapping[ShapeId, str]


def named_population(
    settings: StudySettings,
    surveys: Sequence[ShapeSurvey],
    layout: Mapping[str, LayoutCircle] | None = None,
) -> PopulationNames:
    """Name the loops of every shape of a population.

    Shapes of another size (units) and shapes with another number of openings get no names. Loops
    named by caps or seams, and those with rough points of their own shape, keep those names; all
    others are named by geometry, whatever the pose of the shape in its file, if one way to name
    them is clearly better than any other.

    Parameters
    ----------
    settings : StudySettings
    surveys : sequence of ShapeSurvey
    layout : mapping of str to LayoutCircle, optional
        The circles that the study gives its base domain, by full ostium name; they name the
        openings where nothing else does.
    """
    naming = Naming(settings, layout or {})
    problems = _of_other_size(settings, surveys)
    sound = []
    for survey in surveys:
        if survey.id in problems:
            continue
        wrong = _wrong_count(naming, survey)
        if wrong is None:
            sound.append(survey)
        else:
            problems[survey.id] = wrong
    stated = {s.id: names for s in sound if (names := stated_names(naming, s)) is not None}
    trusted = trusted_names(naming, sound, stated)
    problems.update(trusted.problems)
    sound = [trusted.unnamed.get(s.id, s) for s in sound if s.id not in problems]
    stated, named = trusted.stated, dict(trusted.named)
    others = [survey for survey in sound if survey.id not in named]
    if others:
        reference = _reference(naming, sound, stated)
        if isinstance(reference, str):
            problems.update({s.id: reference + _free_loops(naming, s) for s in others})
        else:
            found, doubtful = _matched(naming, others, sound, stated, reference)
            named.update({k: noted(names, trusted.notes.get(k)) for k, names in found.items()})
            problems.update(doubtful)
    named = _mirrored_few(named)
    closing = {s.id: _with_closed(s, named[s.id]) for s in sound if s.id in named}
    problems.update(_odd_openings(naming, surveys, closing))
    return PopulationNames({k: v for k, v in closing.items() if k not in problems}, problems)


def _mirrored_few(named: Mapping[ShapeId, ShapeNames]) -> dict[ShapeId, ShapeNames]:
    """Say of the fewer shapes that they are mirrored, whichever the names came from."""
    mirrored = {shape for shape, names in named.items() if MIRRORED in names.notes}
    if 2 * len(mirrored) <= len(named):
        return dict(named)
    return {
        shape: ShapeNames(names.names, names.closed, tuple(n for n in names.notes if n != MIRRORED))
        if shape in mirrored
        else noted(names, MIRRORED)
        for shape, names in named.items()
    }


def _of_other_size(settings: StudySettings, surveys: Sequence[ShapeSurvey]) -> dict[ShapeId, str]:
    sizes = [survey.diagonal for survey in surveys]
    scale = abs(float(internal_factors(settings)[0]))
    units = settings.units
    problems = {
        survey.id: f"expected a shape of less than {LARGEST_MM / 1000.0:g} m, found "
        f'{size / 1000.0:.3g} m across: check units in the study, as units = "um"'
        for survey, size in zip(surveys, sizes, strict=True)
        if size > LARGEST_MM
    }
    for k, (usual, ratio) in other_sizes(sizes).items():
        word = "smaller" if sizes[k] < usual else "larger"
        problems[surveys[k].id] = (
            f"expected about {usual / scale:.3g} {units} across as the other shapes are, found "
            f"{sizes[k] / scale:.3g} {units}, {ratio:,.0f} times {word}: its file is in other "
            f'units than the study\'s (units = "{units}"), convert it'
        )
    return problems


def _wrong_count(naming: Naming, survey: ShapeSurvey) -> str | None:
    for part, ostia in naming.ostia.items():
        loops = survey.parts[part].loops
        spare = sum(split_ostium_name(c)[0] == part for c in naming.settings.ostia.close)
        if len(ostia) <= len(loops) <= len(ostia) + spare:
            continue
        wanted = f"{len(ostia)} openings ({', '.join(ostia)})" if ostia else "a closed surface"
        more = len(loops) > len(ostia)
        advice = (
            f'name the one to close in ostia.close (as "{part}.NAME"), close or repair the surface'
            if more
            else "open or repair the surface"
        )
        return (
            f"{part}: expected {wanted}, found {len(loops)}{naming.listed(loops)}: {advice}, or "
            "change the ostia of its part"
        )
    return None


def _reference(
    naming: Naming,
    sound: Sequence[ShapeSurvey],
    stated: Mapping[ShapeId, Mapping[str, Mapping[str, int]]],
) -> Landmarks | str:
    """Return the landmarks that names spread from, or why there are none."""
    if stated:
        shape, given = next(iter(stated.items()))
        return landmarks_of(next(survey for survey in sound if survey.id == shape), given)
    best: tuple[float, Landmarks] | None = None
    for survey in sound:
        names = direct_names(naming, survey)
        if names is None:
            continue
        misfit = misfit_of_points(survey, names, naming.points)
        if best is None or misfit < best[0]:
            best = misfit, landmarks_of(survey, names)
    if best is not None:
        return best[1]
    if naming.layout:
        return _laid_out(naming, sound)
    if naming.settings.ostia.points:
        return (
            "expected rough points in [ostia.points] that tell the openings of at least one shape "
            "apart, found none whose points are near its loops: check the units and frame of the "
            "points, or give all openings one"
        )
    return (
        "expected rough points in [ostia.points] (or ostia.shapes of one shape) to tell the "
        "openings apart, found none"
    )


def _laid_out(naming: Naming, sound: Sequence[ShapeSurvey]) -> Landmarks | str:
    """Return the landmarks of the shape whose loops fit the circles of the domain best."""
    groups = component_parts(tuple(naming.ostia), naming.settings.seam_pairs)
    best: tuple[float, Landmarks] | None = None
    for survey in sound:
        found = names_by_layout(
            survey, naming.ostia, groups, naming.settings.seam_pairs, naming.layout
        )
        if found is None or found.margin < LEAST_MARGIN:
            continue
        if best is None or found.margin > best[0]:
            best = found.margin, landmarks_of(survey, found.names)
    if best is not None:
        return best[1]
    return (
        "expected circles in [domain.circles] (one for every opening but those of seams) that tell "
        "the openings of at least one shape apart, found none that fit: give rough points in "
        "[ostia.points]"
    )


def _free_loops(naming: Naming, survey: ShapeSurvey) -> str:
    loops = [
        loop
        for facts in survey.parts.values()
        for k, loop in enumerate(facts.loops)
        if k not in facts.known.values()
    ]
    return f"; its loops{naming.listed(loops)}"


def _matched(
    naming: Naming,
    others: Sequence[ShapeSurvey],
    sound: Sequence[ShapeSurvey],
    stated: Mapping[ShapeId, Mapping[str, Mapping[str, int]]],
    reference: Landmarks,
) -> tuple[dict[ShapeId, ShapeNames], dict[ShapeId, str]]:
    """Name shapes by geometry: from the reference, then from the mean of the clear ones."""
    first = {survey.id: best_match(survey, naming.ostia, reference) for survey in others}
    clear = [landmarks_of(s, stated[s.id]) for s in sound if s.id in stated]
    clear += [
        landmarks_of(s, first[s.id].names)
        for s in others
        if first[s.id].margin >= LEAST_MARGIN and not first[s.id].is_mirrored
    ]
    mean = _mean([moved_onto(item, reference) for item in clear], reference)
    named, problems = {}, {}
    for survey in others:
        match = best_match(survey, naming.ostia, mean)
        settled = _settled(naming, survey, match)
        if isinstance(settled, str):
            problems[survey.id] = settled
        else:
            named[survey.id] = settled
    return named, problems


def _mean(items: Sequence[Landmarks], reference: Landmarks) -> Landmarks:
    if not items:
        return reference
    return Landmarks(
        {name: np.mean([item.points[name] for item in items], axis=0) for name in reference.points},
        {name: float(np.mean([item.radii[name] for item in items])) for name in reference.radii},
        reference.samples,
        reference.area,
    )


def _settled(naming: Naming, survey: ShapeSurvey, match: Match) -> ShapeNames | str:
    """Return the names of a match that is clear, or why it is not."""
    notes = []
    if match.is_mirrored:
        notes.append(MIRRORED)
    if match.as_mirror is not None:
        part, one, two = _differing(match.names, match.as_mirror)
        notes.append(f"{part}: fits no worse as its mirror image, where {two}, not {one}: check it")
    points = naming.points
    direct = names_by_points(naming, survey, points, LEAST_DIRECT_MARGIN) if points else None
    if match.margin >= LEAST_MARGIN:
        if points and direct != match.names:
            notes.append(
                "openings named by their places among each other: the rough points do not fit the "
                "shape as it lies in its file"
            )
        return ShapeNames(match.names, notes=tuple(notes))
    if direct is not None and direct in (match.names, match.rival):
        return ShapeNames(direct, notes=tuple(notes))
    part, one, two = _differing(match.names, match.rival)
    loops = survey.parts[part].loops
    return (
        f"{part}: expected openings that can be told apart, found two ways to name them that fit "
        f"alike ({one} or {two}){naming.listed(loops)}: give rough points of this shape in "
        f'[ostia.shapes."{survey.id}"]'
    )


def _differing(names: Names, rival: Names) -> tuple[str, str, str]:
    """Return the part and the openings that two ways name differently."""
    part = next(p for p in names if names[p] != rival[p])
    ostia = [o for o, k in names[part].items() if rival[part][o] != k]
    one = ", ".join(f"{o} = loop {names[part][o] + 1}" for o in ostia)
    two = ", ".join(f"{o} = loop {rival[part][o] + 1}" for o in ostia)
    return part, one, two


def _with_closed(survey: ShapeSurvey, names: ShapeNames) -> ShapeNames:
    closed = {
        part: tuple(k for k in range(len(facts.loops)) if k not in names.names[part].values())
        for part, facts in survey.parts.items()
    }
    return ShapeNames(names.names, {p: loops for p, loops in closed.items() if loops}, names.notes)


def _odd_openings(
    naming: Naming, surveys: Sequence[ShapeSurvey], named: Mapping[ShapeId, ShapeNames]
) -> dict[ShapeId, str]:
    """Return the shapes with an opening of quite another size than in the other shapes."""
    known = [survey for survey in surveys if survey.id in named]
    if len(known) < 3:
        return {}
    problems: dict[ShapeId, str] = {}
    scale = abs(float(internal_factors(naming.settings)[0]))
    for part, ostia in naming.ostia.items():
        for ostium in ostia:
            sizes = np.array(
                [s.parts[part].loops[named[s.id].names[part][ostium]].perimeter for s in known]
            )
            for k, survey in enumerate(known):
                usual = float(np.median(np.delete(sizes, k)))
                if usual / OTHER_OPENING <= sizes[k] <= usual * OTHER_OPENING:
                    continue
                loop = survey.parts[part].loops[named[survey.id].names[part][ostium]]
                problems.setdefault(
                    survey.id,
                    f"{part}: expected the opening {ostium} about {usual / scale:.3g} "
                    f"{naming.settings.units} round as in the other shapes, found"
                    f"{naming.listed([loop]).removeprefix(':')}: check whether it is closed and a "
                    "hole was taken for it",
                )
    return problems
