"""Which curves of a sequence were drawn in one slice: those in one plane."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.fitting.sequence_types import PhaseItem, PhaseTarget, SliceContours
from ostiform.fitting.types import ContourTarget

FLAT_MM = 0.5
"""Largest distance of a curve from its plane that a drawing program leaves."""

SAME_ANGLE = np.cos(np.radians(10.0))
SAME_MM = 1.5
"""Curves within this of a slice's plane are of that slice."""

NAMELESS = "?"


@dataclass(frozen=True, slots=True, eq=False)
class _Plane:
    name: str
    view: str
    normal: FloatArray
    point: FloatArray


def sliced(target: PhaseItem, view: str, slice_name: str | None) -> tuple[PhaseItem, ...]:
    """Return contours as slices of a view; anything else, and curves that are not flat, as it is.

    Parameters
    ----------
    target : Target or SliceContours
    view : str
    slice_name : str or None
        Of all its curves, where it is known; else `with_slices_named` names them by their planes.
    """
    if not isinstance(target, ContourTarget):
        return (target,)
    flat = [curve for curve in target.curves if _plane_of(curve) is not None]
    bent = [curve for curve in target.curves if _plane_of(curve) is None and len(curve)]
    found: list[PhaseItem] = []
    if slice_name is not None:
        return (SliceContours(slice_name, target.curves, target.part),)
    found += [SliceContours(f"{view}{NAMELESS}", (curve,), target.part) for curve in flat]
    if bent:
        found.append(ContourTarget(tuple(bent), target.part))
    return tuple(found)


def with_slices_named(phases: Sequence[PhaseTarget]) -> tuple[PhaseTarget, ...]:
    """Return phases whose nameless slices have the name of their plane, the same in all phases."""
    planes: list[_Plane] = []
    named = []
    for phase in phases:
        items: list[PhaseItem] = []
        for item in phase.targets:
            if isinstance(item, SliceContours) and item.slice.endswith(NAMELESS):
                view = item.slice.removesuffix(NAMELESS)
                items.append(replace(item, slice=_named(planes, view, item.curves[0])))
            else:
                items.append(item)
        named.append(replace(phase, targets=tuple(items)))
    return tuple(named)


def _named(planes: list[_Plane], view: str, curve: FloatArray) -> str:
    """Return the name of the plane of a curve, a new one where it is in none that is known."""
    middle = curve.mean(axis=0)
    normal = _plane_of(curve)
    assert normal is not None
    for plane in planes:
        is_alike = abs(float(plane.normal @ normal)) > SAME_ANGLE
        if plane.view == view and is_alike and abs(plane.normal @ (middle - plane.point)) < SAME_MM:
            return plane.name
    own = sum(plane.view == view for plane in planes)
    planes.append(_Plane(f"{view} {own + 1}", view, normal, middle))
    return planes[-1].name


def _plane_of(curve: FloatArray) -> FloatArray | None:
    """Return the normal of a flat curve; None of one that is not, or is straight."""
    if len(curve) < 3:
        return None
    offsets = curve - curve.mean(axis=0)
    _, spread, axes = np.linalg.svd(offsets, full_matrices=False)
    if float(np.abs(offsets @ axes[2]).max()) > FLAT_MM or spread[1] < 1e-3 * spread[0]:
        return None
    normal: FloatArray = axes[2]
    return normal
