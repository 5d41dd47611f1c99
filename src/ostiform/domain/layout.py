"""The layout of the base domain: where the circles of the openings lie (design 2, HY 2.1).

Given once for the whole population: explicit circles are taken as they are, the others start at
the population mean of the conformal hole positions and are moved apart as little as possible.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.domain.cap_spread import settled_caps
from ostiform.domain.cap_start import CapDraft, started_caps
from ostiform.domain.checks import check_sphere
from ostiform.domain.circle_settings import CircleSetting, equator_phase, own_settings
from ostiform.domain.outline import ComponentOutline, chosen_pole
from ostiform.domain.regions import equator_seam, far_part, handle_seams, part_regions
from ostiform.domain.types import NORTH, BaseDomain, Circle, ConformalHoles, Sphere
from ostiform.errors import InputError
from ostiform.surface import Seam, normalised, split_ostium_name

DECIMALS = 9


def lay_out(
    outlines: Sequence[Sequence[ComponentOutline]],
    holes: Sequence[Sequence[ConformalHoles]],
    pole: str | None = None,
    circles: Mapping[str, CircleSetting] | None = None,
) -> BaseDomain:
    """Lay out the base domain of a population.

    Per component: the seam (the pole's, else the first) is the equator about +z, its first part
    in z < 0, its second in z > 0; a component without seams has the pole's circle about +z
    (`pole_circle`). Further seams are circles with their part inside. The other centres are the
    population means of the conformal hole directions. A hole narrower than 3.5 degrees in the
    mean gets 3.5; a wider one its mean conformal radius, at most 15 and at most what leaves gaps
    of three radii where it is, but not below 3.5. Circles are then moved apart as little as
    possible until gaps are 3 times the smaller radius (for a circle of fixed
    radius at most 10.5 degrees) and at least 3 degrees; where that is impossible automatic radii
    shrink, down to 1.5 degrees.

    Phases are zero unless given: the phase only starts a rim, whose rotation the embedding finds.

    Parameters
    ----------
    outlines : sequence of sequence of ComponentOutline
        For each component, its outline in every shape.
    holes : sequence of sequence of ConformalHoles
        For each component, the hole positions of every shape that has them; may be empty for a
        component whose circles are all explicit.
    pole : str, optional
        The ostium that gets the stereographic pole of its component.
    circles : mapping of str to CircleSetting, optional
        Explicit circles by full ostium name, either name for a seam.

    Raises
    ------
    InputError
        If shapes differ in their openings, a name is unknown, explicit circles crowd each other,
        or the circles do not fit on the sphere.
    TopologyError
        If seams form a cycle.
    """
    settings = dict(circles or {})
    if len(outlines) != len(holes):
        raise InputError(
            f"layout: expected hole positions for {len(outlines)} components, found {len(holes)}"
        )
    known = {name for population in outlines for name in _ostium_names(population)}
    for name in (*settings, *(() if pole is None else (pole,))):
        if name not in known:
            raise InputError(
                f"base domain: expected one of the ostia {', '.join(sorted(known)) or '(none)'}, "
                f"found {name}"
            )
    return BaseDomain(
        tuple(
            _sphere(population, positions, chosen_pole(population, pole), settings)
            for population, positions in zip(outlines, holes, strict=True)
        )
    )


def _ostium_names(population: Sequence[ComponentOutline]) -> set[str]:
    if not population:
        raise InputError("layout: expected at least one shape of every component, found none")
    first = population[0]
    for outline in population:
        if (outline.parts, set(outline.rims), set(outline.seams)) != (
            first.parts,
            set(first.rims),
            set(first.seams),
        ):
            raise InputError(
                f"component {first.name}: expected the same parts, openings and seams in every "
                "shape, found different ones: leave the shapes that differ out"
            )
    return {*first.rims, *(name for seam in first.seams for name in (seam.first, seam.second))}


def _sphere(
    population: Sequence[ComponentOutline],
    positions: Sequence[ConformalHoles],
    pole: str | None,
    settings: Mapping[str, CircleSetting],
) -> Sphere:
    outline = population[0]
    handles = handle_seams(tuple(outline.seams))
    seams = tuple(seam for seam in outline.seams if seam not in handles)
    rims = (
        *outline.rims,
        *(name for seam in handles for name in (seam.first, seam.second)),
    )
    regions = part_regions(outline.parts, rims, seams, pole)
    equator = equator_seam(seams, pole)
    further = tuple(seam for seam in seams if seam != equator)
    own = own_settings(settings, rims, further, equator)
    draft = started_caps(population, positions, pole, own, regions, rims, further)
    draft = _tied(draft, handles)
    draft = _rounded(settled_caps(draft, regions, equator, outline.name))
    phases = {
        name: np.radians(own[name].phase_deg or 0.0) if name in own else 0.0
        for name in draft.centers
    }
    placed_seams: dict[Seam, Circle] = {}
    for seam in seams:
        if seam == equator:
            placed_seams[seam] = Circle(NORTH, np.pi / 2, equator_phase(settings, seam))
            continue
        inside_second = far_part(seam, regions) == split_ostium_name(seam.second)[0]
        center, radius = draft.centers[seam.first], draft.radii[seam.first]
        placed_seams[seam] = Circle(
            center if inside_second else -center,
            radius if inside_second else np.pi - radius,
            float(phases[seam.first]),
        )
    sphere = Sphere(
        name=outline.name,
        parts=outline.parts,
        rims={
            name: Circle(draft.centers[name], draft.radii[name], float(phases[name]))
            for name in rims
        },
        seams=placed_seams,
        pole=pole,
        handles=handles,
        up=_mean_direction([own.up for own in positions]),
    )
    check_sphere(sphere)
    return sphere


def _rounded(draft: CapDraft) -> CapDraft:
    """Return the circles to a billionth of a radian.

    Means over the shapes depend on their order in the last bits, which meshing would magnify.
    """
    return replace(
        draft,
        centers={
            name: normalised(np.round(center, DECIMALS)) for name, center in draft.centers.items()
        },
        radii={name: round(radius, DECIMALS) for name, radius in draft.radii.items()},
    )


def _mean_direction(directions: Sequence[FloatArray]) -> FloatArray:
    """Return the direction of the sum, to a billionth as above; +z if there is none."""
    total = np.round(np.sum(directions, axis=0), DECIMALS) if len(directions) else NORTH
    length = float(np.linalg.norm(total))
    return total / length if length > 0.0 else NORTH


def _tied(draft: CapDraft, handles: Sequence[Seam]) -> CapDraft:
    """Give the two sides of every handle one radius, the smaller."""
    radii = dict(draft.radii)
    for seam in handles:
        radii[seam.first] = radii[seam.second] = min(radii[seam.first], radii[seam.second])
    return replace(draft, radii=radii)
