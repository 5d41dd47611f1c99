"""Fitting the circles of a component beside each other: limits, gaps, shrinking."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ostiform.arrays import BoolArray, FloatArray, IntArray
from ostiform.domain.cap_start import LEAST_SEAM_RADIUS, NARROW_RADIUS, CapDraft
from ostiform.domain.checks import LEAST_GAP, angle_between
from ostiform.domain.outline import LEAST_WIDE_RADIUS
from ostiform.domain.regions import PartRegion
from ostiform.domain.spread import Caps, azimuth_order, separated, violations
from ostiform.domain.types import NORTH
from ostiform.errors import InputError
from ostiform.surface import Seam, split_ostium_name

# Gaps of the automatic layout: so many times the smaller radius, and never below `LEAST_GAP`.
GAP_IN_RADII = 3.0

LEAST_RADIUS = float(np.radians(1.5))

# Factor of one round of shrinking where circles do not fit, and how far a gap may miss its goal.
SHRINK = 0.9
GAP_ROUNDING = 1e-7


def settled_caps(
    draft: CapDraft, regions: Mapping[str, PartRegion], equator: Seam | None, component: str
) -> CapDraft:
    """Limit wide radii, then move caps apart, shrinking automatic ones until they fit."""
    names = sorted(draft.centers)
    draft = _limited(draft, regions, equator)
    while True:
        caps, everything = _caps(draft, names, regions, equator)
        members = [
            np.array(sorted(everything.index(name) for name in region.curves), dtype=np.int64)
            for region in regions.values()
        ]
        order = np.concatenate(
            [azimuth_order(caps.centers, caps.radii, member) for member in members]
        )
        centers = separated(caps, order)
        missing = violations(caps, centers)
        pairs = np.concatenate([caps.apart, caps.within])
        settled = replace(
            draft,
            centers={
                name: centers[index] if draft.movable[name] else draft.centers[name]
                for index, name in enumerate(names)
            },
        )
        bad = _violated(draft, names, pairs, missing)
        if not bad.any():
            return settled
        tight = {everything[index] for index in pairs[bad].ravel()}
        radii = dict(draft.radii)
        for name in tight & set(names):
            floor = LEAST_SEAM_RADIUS if draft.is_seam[name] else LEAST_RADIUS
            if draft.shrinkable[name]:
                radii[name] = max(SHRINK * radii[name], min(floor, radii[name]))
        if radii == draft.radii:
            worst = int(np.argmax(np.where(bad, missing, -np.inf)))
            one, other = (everything[index] for index in pairs[worst])
            required = np.concatenate([caps.apart_gaps, caps.within_gaps])[worst]
            raise InputError(
                f"circles {one} and {other} of {component}: expected room for a gap of "
                f"{np.degrees(required):.3g} degrees, found at most "
                f"{np.degrees(required - missing[worst]):.3g}: make explicit circles smaller or "
                "move them"
            )
        draft = replace(draft, radii=radii)


def _violated(
    draft: CapDraft, names: Sequence[str], pairs: IntArray, missing: FloatArray
) -> BoolArray:
    """Return which pairs miss their gap and could still be changed; check_sphere has the rest."""
    changeable = np.array(
        [
            any(
                index < len(names)
                and (draft.movable[names[index]] or draft.shrinkable[names[index]])
                for index in pair
            )
            for pair in pairs
        ],
        dtype=bool,
    )
    return changeable & (missing > GAP_ROUNDING)


def _caps(
    draft: CapDraft,
    names: Sequence[str],
    regions: Mapping[str, PartRegion],
    equator: Seam | None,
) -> tuple[Caps, list[str]]:
    """Return the circles with their required gaps, the two hemispheres last, and their names."""
    everything = list(names)
    centers = [draft.centers[name] for name in names]
    radii = [draft.radii[name] for name in names]
    movable = [draft.movable[name] for name in names]
    hemisphere: dict[str, int] = {}
    if equator is not None:
        for side, axis in ((equator.first, -NORTH), (equator.second, NORTH)):
            hemisphere[split_ostium_name(side)[0]] = len(everything)
            everything.append(side)
            centers.append(axis)
            radii.append(np.pi / 2)
            movable.append(False)
    apart: list[tuple[int, int]] = []
    within: list[tuple[int, int]] = []
    for part, region in regions.items():
        bounding = [*region.curves, *(seam.first for seam in region.further_seams)]
        indices = sorted(everything.index(name) for name in bounding)
        apart += itertools.combinations(indices, 2)
        if region.container is not None:
            outer = hemisphere.get(part)
            if outer is None:
                outer = everything.index(region.container.first)
            within += [(index, outer) for index in indices]
    measures = [_gap_measure(draft, name) if name in names else np.inf for name in everything]

    def gap(pair: tuple[int, int]) -> float:
        smaller = min(measures[pair[0]], measures[pair[1]])
        return max(GAP_IN_RADII * smaller, LEAST_GAP)

    caps = Caps(
        centers=np.array(centers).reshape(-1, 3),
        radii=np.array(radii),
        movable=np.array(movable, dtype=bool),
        apart=np.array(apart, dtype=np.int64).reshape(-1, 2),
        within=np.array(within, dtype=np.int64).reshape(-1, 2),
        apart_gaps=np.array([gap(pair) for pair in apart]),
        within_gaps=np.array([gap(pair) for pair in within]),
    )
    return caps, everything


def _gap_measure(draft: CapDraft, name: str) -> float:
    """Return the radius that a circle's gaps are measured in."""
    is_own = draft.shrinkable[name] and not draft.is_seam[name]
    return draft.radii[name] if is_own else min(draft.radii[name], NARROW_RADIUS)


def _limited(draft: CapDraft, regions: Mapping[str, PartRegion], equator: Seam | None) -> CapDraft:
    """Limit wide automatic rims to what leaves gaps of three radii where their centres are."""
    names = sorted(draft.centers)
    caps, everything = _caps(draft, names, regions, equator)
    radii = dict(draft.radii)
    limits = dict.fromkeys(names, np.inf)
    for one, other in caps.apart:
        pair = (everything[one], everything[other])
        apart = angle_between(caps.centers[one], caps.centers[other])
        for name, neighbour in (pair, pair[::-1]):
            if draft.radii[neighbour] > LEAST_WIDE_RADIUS and name in limits:
                fits_beside = (apart - draft.radii[neighbour]) / (1.0 + GAP_IN_RADII)
                limits[name] = min(limits[name], max(fits_beside, apart / (2.0 + GAP_IN_RADII)))
    for inner, outer in caps.within:
        depth = caps.radii[outer] - angle_between(caps.centers[inner], caps.centers[outer])
        limits[everything[inner]] = min(limits[everything[inner]], depth / (1.0 + GAP_IN_RADII))
    for name in names:
        is_rim = draft.shrinkable[name] and not draft.is_seam[name]
        if is_rim and draft.radii[name] > NARROW_RADIUS:
            radii[name] = float(np.clip(limits[name], NARROW_RADIUS, draft.radii[name]))
    return replace(draft, radii=radii)
