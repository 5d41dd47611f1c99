"""Where the circles of a component start: population means, explicit circles, area shares."""

from collections.abc import Mapping, Sequence
from typing import Annotated

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.domain.checks import cap_of_seam
from ostiform.domain.circle_settings import CircleSetting
from ostiform.domain.outline import MOST_WIDE_RADIUS, ComponentOutline, pole_circle
from ostiform.domain.regions import PartRegion, far_part
from ostiform.domain.types import NORTH, Circle, ConformalHoles
from ostiform.errors import InputError
from ostiform.surface import Seam, rotation_between
from ostiform.values import Axes, value

# Narrow openings (veins): the embedding energy is flat between 2 and 6 degrees and least at 2 to
# 4 for tubes of 4 to 8 radii (design 2).
NARROW_RADIUS = float(np.radians(3.5))

# A seam that leads to a further part gets the share of its region that the parts behind it have.
LEAST_SEAM_RADIUS = float(np.radians(10.0))
MOST_SEAM_RADIUS = float(np.radians(50.0))


@value
class CapDraft:
    """The caps of one component sphere while they are laid out, by curve name.

    A further seam's cap is the side of its circle that is farther from the root.

    Attributes
    ----------
    centers : mapping of str to (3,) float64
    radii : mapping of str to float
    movable : mapping of str to bool
        Whether the layout may move the centre.
    shrinkable : mapping of str to bool
        Whether the layout may change the radius.
    is_seam : mapping of str to bool
    """

    centers: Mapping[str, Annotated[FloatArray, Axes(3)]]
    radii: Mapping[str, float]
    movable: Mapping[str, bool]
    shrinkable: Mapping[str, bool]
    is_seam: Mapping[str, bool]


def started_caps(
    population: Sequence[ComponentOutline],
    positions: Sequence[ConformalHoles],
    pole: str | None,
    own: Mapping[str, CircleSetting],
    regions: Mapping[str, PartRegion],
    rims: Sequence[str],
    further: Sequence[Seam],
) -> CapDraft:
    """Return every cap where the population or the study puts it, before they are moved apart."""
    names = (*rims, *(seam.first for seam in further))
    has_equator = any(region.container is not None for region in regions.values())
    polar = None if has_equator else pole_circle(population, pole)
    fixed = {
        name: np.asarray(setting.center) / np.linalg.norm(setting.center)
        for name, setting in own.items()
        if setting.center is not None
    }
    facing = {seam.first: far_part(seam, regions) for seam in further}
    for seam in further:
        if seam.first in fixed:
            circle = Circle(fixed[seam.first], np.pi / 2)
            fixed[seam.first] = cap_of_seam(seam, circle, facing[seam.first])[0]
    found = {
        name: _mean_direction(name, positions)
        for name in names
        if not (polar is not None and name == pole) and (name not in fixed or positions)
    }
    if polar is not None and pole is not None:
        found[pole] = NORTH
    turn = _turn_to_explicit(found, fixed, pole if polar is not None else None)
    centers = {name: fixed[name] if name in fixed else turn @ found[name] for name in names}
    radii: dict[str, float] = {}
    given = {n: np.radians(s.radius_deg) for n, s in own.items() if s.radius_deg is not None}
    areas = {
        part: float(np.mean([outline.areas[part] for outline in population])) for part in regions
    }
    for name in names:
        if name in given and name in facing:
            seam = next(seam for seam in further if seam.first == name)
            radii[name] = cap_of_seam(seam, Circle(NORTH, given[name]), facing[name])[1]
        elif name in given:
            radii[name] = float(given[name])
        elif name in facing:
            radii[name] = _seam_radius(facing[name], regions, areas)
        elif polar is not None and name == pole:
            radii[name] = polar.radius
        else:
            mean = float(np.mean([shape.radii[name] for shape in positions] or [0.0]))
            radii[name] = float(np.clip(mean, NARROW_RADIUS, MOST_WIDE_RADIUS))
    return CapDraft(
        centers=centers,
        radii=radii,
        movable={name: name not in fixed and not (polar and name == pole) for name in names},
        shrinkable={name: name not in given for name in names},
        is_seam={name: name in facing for name in names},
    )


def _mean_direction(name: str, positions: Sequence[ConformalHoles]) -> FloatArray:
    if not positions:
        raise InputError(
            f"circle {name}: expected a centre in the study or hole positions to take it from, "
            "found neither"
        )
    missing = [index for index, shape in enumerate(positions) if name not in shape.directions]
    if missing:
        raise InputError(
            f"circle {name}: expected a hole position in every shape, found none in shape "
            f"{missing[0]} of {len(positions)}"
        )
    mean = np.mean([shape.directions[name] for shape in positions], axis=0)
    length = float(np.linalg.norm(mean))
    if length < 0.1:
        raise InputError(
            f"circle {name}: expected hole positions that agree over the population, found "
            f"directions that cancel (mean length {length:.2g}): give its centre in the study"
        )
    direction: FloatArray = mean / length
    return direction


def _turn_to_explicit(
    found: Mapping[str, FloatArray], fixed: Mapping[str, FloatArray], pole: str | None
) -> FloatArray:
    """Return the rotation (3, 3) of the automatic centres that suits the explicit ones best.

    It carries +z to an explicit pole; about that axis it minimises the squared distances between
    explicit centres and the positions they would have been given.
    """
    axis = fixed.get(pole, NORTH) if pole is not None else NORTH
    tilt = rotation_between(NORTH, axis)
    both = sorted(set(found) & set(fixed) - {pole})
    if not both:
        return tilt
    own = np.array([tilt @ found[name] for name in both])
    goal = np.array([fixed[name] for name in both])
    across = own - np.outer(own @ axis, axis)
    cosine = float(np.sum(across * goal))
    sine = float(np.sum(np.cross(axis, across) * goal))
    if np.hypot(cosine, sine) < 1e-9 * len(both):
        return tilt
    angle = np.arctan2(sine, cosine)
    x, y, z = axis
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turn: FloatArray = np.eye(3) + np.sin(angle) * skew + (1.0 - np.cos(angle)) * skew @ skew
    return turn @ tilt


def _seam_radius(part: str, regions: Mapping[str, PartRegion], areas: Mapping[str, float]) -> float:
    """Return the radius of the cap of a part behind a further seam, by its share of area.

    Its region is the container of the part it leads from; a component's two halves are
    hemispheres.
    """
    parent = next(
        near for near, region in regions.items() if regions[part].container in region.further_seams
    )
    container = regions[parent].container
    is_root_region = all(container not in region.further_seams for region in regions.values())
    around = np.pi / 2 if is_root_region else _seam_radius(parent, regions, areas)
    behind = sum(areas[name] for name in regions[part].descendants)
    whole = sum(areas[name] for name in regions[parent].descendants)
    share = behind / whole if whole > 0 else 0.5
    radius = np.arccos(1.0 - share * (1.0 - np.cos(around)))
    return float(np.clip(radius, LEAST_SEAM_RADIUS, min(MOST_SEAM_RADIUS, 0.6 * around)))
