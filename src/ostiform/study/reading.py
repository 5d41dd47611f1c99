"""From the files of one shape to its surfaces: oriented, opened, named and sewn at the seams."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import combinations

import numpy as np

from ostiform.arrays import IntArray
from ostiform.errors import InputError, TopologyError
from ostiform.study.markups import Markups
from ostiform.study.naming import loop_facts
from ostiform.study.opened import OpenedShape
from ostiform.study.parts import (
    MIRROR,
    OpenPart,
    PartFacts,
    close_loops,
    opened_part,
    reflected_part,
    surface_facts,
)
from ostiform.study.settings import StudySettings
from ostiform.study.shape import Shape
from ostiform.study.shape_names import ShapeNames
from ostiform.study.sources import part_cuts, part_meshes, shape_markups, stated_points
from ostiform.study.study import ShapeEntry, Study
from ostiform.study.survey import ShapeSurvey, shape_survey
from ostiform.surface import (
    Seam,
    Surface,
    component_parts,
    counted,
    crossing_depth,
    default_tolerance,
    loop_gap,
    median_edge_length,
    sewn_seam,
    split_ostium_name,
)

_CROSSING = 0.5
"""Surfaces that pass through each other by less than this share of an edge are not told."""


def opened_shape(study: Study, entry: ShapeEntry) -> OpenedShape:
    """Read the files of one shape: the only place where they are.

    Positions become millimetres in LPS, faces counter-clockwise seen from outside; flaws of the
    meshes are mended, caps opened and cuts made.

    Raises
    ------
    InputError
        If a file is missing, damaged or of another frame.
    TopologyError
        If a part is not one oriented manifold surface of genus 0.
    """
    settings = study.settings
    try:
        markups = shape_markups(settings, entry)
        opened = _opened_parts(settings, entry, markups)
    except (InputError, TopologyError) as error:
        raise type(error)(f"shape {entry.id}: {error}") from None
    points = stated_points(settings, entry, markups)
    if entry.reflect:
        opened = {part: reflected_part(item) for part, item in opened.items()}
        points = {name: MIRROR * point for name, point in points.items()}
    known = _known_by_seams(settings, opened)
    return OpenedShape(
        entry.id,
        {part: replace(item, known=known[part]) for part, item in opened.items()},
        points,
        entry.notes,
    )


def named_shape(settings: StudySettings, opened: OpenedShape, names: ShapeNames) -> Shape:
    """Return the surfaces of an opened shape with named openings, sewn at the seams.

    Accessory openings are closed, and the rims at seams given the same vertices.

    Raises
    ------
    InputError
        If the rims of a seam do not coincide.
    TopologyError
        If a part cannot be closed or sewn.
    """
    try:
        closed = {p: _with_closed(names, p, item) for p, item in opened.parts.items()}
        surfaces = {
            part: Surface(item.vertices, item.faces, _loops_by_name(item))
            for part, item in closed.items()
        }
        surfaces, seam_repairs = _sewn(settings, surfaces)
        repairs = [f"{part}: {repair}" for part, item in closed.items() for repair in item.repairs]
        crossing = _crossing_components(settings, surfaces)
        said = (*opened.notes, *repairs, *names.notes, *seam_repairs, *crossing)
        return Shape(opened.id, surfaces, settings.seam_pairs, said)
    except (InputError, TopologyError) as error:
        raise type(error)(f"shape {opened.id}: {error}") from None


def survey_shape(study: Study, entry: ShapeEntry) -> ShapeSurvey:
    """Read one shape alone as far as naming its openings asks for."""
    return shape_survey(opened_shape(study, entry))


def part_facts(study: Study, entry: ShapeEntry, part: str) -> PartFacts | None:
    """Return what can be said of a part that is unfit for use; None if it cannot be read."""
    try:
        return surface_facts(part_meshes(study.settings, entry, {}).meshes[part])
    except (InputError, TopologyError):
        return None


def _crossing_components(settings: StudySettings, surfaces: Mapping[str, Surface]) -> list[str]:
    """Say which parts that no seam joins pass through each other."""
    groups = component_parts(settings.part_names, settings.seam_pairs)
    told = []
    for one, two in combinations(surfaces, 2):
        if any(one in group and two in group for group in groups):
            continue
        first, second = surfaces[one], surfaces[two]
        depth, place = crossing_depth(
            (first.vertices, first.faces), (second.vertices, second.faces)
        )
        if depth > _CROSSING * median_edge_length(first.vertices, first.faces):
            where = ", ".join(f"{x + 0.0:.1f}" for x in place.round(1))
            told.append(
                f"{one} and {two} pass through each other, by up to {depth:.1f} mm at [{where}] mm"
            )
    return told


def _opened_parts(
    settings: StudySettings, entry: ShapeEntry, markups: Markups
) -> dict[str, OpenPart]:
    sources = part_meshes(settings, entry, part_cuts(settings, entry, markups))
    opened = {}
    for part, mesh in sources.meshes.items():
        file = entry.files[part]
        own = {
            split_ostium_name(name)[1]: rim
            for name, rim in sources.rims.items()
            if split_ostium_name(name)[0] == part
        }
        try:
            opened[part] = opened_part(settings, part, mesh, sources.cuts[part], own)
        except (InputError, TopologyError) as error:
            raise type(error)(f"{part} ({file}): {error}") from None
    return opened


def _with_closed(names: ShapeNames, part: str, opened: OpenPart) -> OpenPart:
    """Return a part whose loops are known by the given names, accessory ones closed."""
    loops = np.array(names.closed.get(part, ()), dtype=np.int64)
    sizes = ", ".join(
        f"{loop_facts(opened.vertices, opened.loops[k]).perimeter:.3g} mm round"
        for k in loops.tolist()
    )
    return close_loops(
        replace(opened, known=names.names[part]),
        loops,
        f"closed {counted(len(loops), 'accessory opening')} ({sizes})",
    )


def _loops_by_name(opened: OpenPart) -> dict[str, IntArray]:
    return {name: opened.loops[k] for name, k in opened.known.items()}


def _known_by_seams(
    settings: StudySettings, opened: Mapping[str, OpenPart]
) -> dict[str, dict[str, int]]:
    """Name the loops of a seam where just one loop of each of its two parts coincide."""
    known = {part: dict(opened[part].known) for part in opened}
    for seam in settings.seam_pairs:
        (first, first_ostium), (second, second_ostium) = (
            split_ostium_name(name) for name in (seam.first, seam.second)
        )
        rivals = [s for s in settings.seam_pairs if _same_parts(s, seam)]
        if first == second or len(rivals) > 1:
            continue
        pairs = _coincident_pairs(settings, opened[first], opened[second])
        if len(pairs) == 1:
            known[first].setdefault(first_ostium, pairs[0][0])
            known[second].setdefault(second_ostium, pairs[0][1])
    return known


def _same_parts(one: Seam, two: Seam) -> bool:
    parts = [
        {split_ostium_name(seam.first)[0], split_ostium_name(seam.second)[0]} for seam in (one, two)
    ]
    return parts[0] == parts[1]


def _coincident_pairs(
    settings: StudySettings, first: OpenPart, second: OpenPart
) -> list[tuple[int, int]]:
    pairs = []
    for k, one in enumerate(first.loops):
        for l, two in enumerate(second.loops):
            here, there = first.vertices[one], second.vertices[two]
            tolerance = settings.welding.tolerance_mm or default_tolerance(here, there)
            reach = np.ptp(here, axis=0).max() + tolerance
            if np.abs(here.mean(axis=0) - there.mean(axis=0)).max() > reach:
                continue
            if loop_gap(here, there) <= tolerance:
                pairs.append((k, l))
    return pairs


def _sewn(
    settings: StudySettings, surfaces: Mapping[str, Surface]
) -> tuple[dict[str, Surface], list[str]]:
    sewn, repairs = dict(surfaces), []
    for seam in settings.seam_pairs:
        (first, first_ostium), (second, second_ostium) = (
            split_ostium_name(name) for name in (seam.first, seam.second)
        )
        label = f"seam {seam.first} = {seam.second}"
        if first == second:
            raise TopologyError(
                f"{label}: expected a seam between two parts, found one that joins {first} to "
                "itself: surfaces with handles cannot be embedded yet"
            )
        one, two = sewn[first], sewn[second]
        tolerance = settings.welding.tolerance_mm or default_tolerance(
            one.vertices[one.loops[first_ostium]], two.vertices[two.loops[second_ostium]]
        )
        try:
            result = sewn_seam(one, first_ostium, two, second_ostium, tolerance)
        except InputError as error:
            raise InputError(f"{label}: {error}") from None
        sewn[first], sewn[second] = result.first, result.second
        if result.moved_mm > 0.0 or result.n_inserted:
            repairs.append(
                f"{label}: moved rim vertices by up to {result.moved_mm:.3g} mm and inserted "
                f"{result.n_inserted}"
            )
    return sewn, repairs
