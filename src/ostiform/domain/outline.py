"""What the layout of the base domain needs to know of a component: names and sizes."""

from collections.abc import Mapping, Sequence

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.domain.regions import equator_seam
from ostiform.domain.types import Circle
from ostiform.errors import InputError
from ostiform.surface import Component, Seam
from ostiform.values import value

# Limits of the automatic radius of a wide opening (design 2): distortion is flat below 6 degrees
# and grows quickly above 15.
LEAST_WIDE_RADIUS = float(np.radians(4.0))
MOST_WIDE_RADIUS = float(np.radians(15.0))


@value
class ComponentOutline:
    """Names and sizes of one component of one shape.

    Attributes
    ----------
    name : str
    parts : tuple of str
    areas : mapping of str to float
        Surface area of each part, mm^2.
    rims : mapping of str to float
        Perimeter of each open rim, mm.
    seams : mapping of Seam to float
        Length of each seam, mm.
    """

    name: str
    parts: tuple[str, ...]
    areas: Mapping[str, float]
    rims: Mapping[str, float]
    seams: Mapping[Seam, float]


def outlined(component: Component) -> ComponentOutline:
    """Return the names and sizes of a component."""
    corners = component.vertices[component.faces]  # (F, 3, 3)
    areas = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )  # (F,)
    part_areas = np.bincount(component.face_part, areas, len(component.parts))
    return ComponentOutline(
        name=component.name,
        parts=component.parts,
        areas=dict(zip(component.parts, part_areas.tolist(), strict=True)),
        rims={name: _length(component.vertices, rim) for name, rim in component.rims.items()},
        seams={seam: _length(component.vertices, line) for seam, line in component.seams.items()},
    )


def chosen_pole(outlines: Sequence[ComponentOutline], pole: str | None = None) -> str | None:
    """Return the ostium the stereographic pole of a component is put in.

    The one the study names, if it is one of this component's; else the first side of the first
    seam between two parts; else the rim with the longest mean perimeter; None without openings.

    Parameters
    ----------
    outlines : sequence of ComponentOutline
        The component in every shape of the population.
    pole : str, optional
        The study's choice.
    """
    first = outlines[0]
    sides = [name for seam in first.seams for name in (seam.first, seam.second)]
    if pole in sides or pole in first.rims:
        return pole
    seam = equator_seam(tuple(first.seams), None)
    if seam is not None:
        return seam.first
    perimeters = {
        name: float(np.mean([outline.rims[name] for outline in outlines])) for name in first.rims
    }
    return min(perimeters, key=lambda name: (-perimeters[name], name), default=None)


def pole_circle(outlines: Sequence[ComponentOutline], pole: str | None) -> Circle | None:
    """Return the automatic circle about +z that the map of a component starts from.

    The equator if the component has a seam. Without seams the pole's rim gets the circle whose
    cap takes the share of the sphere that a flat disc of the rim's perimeter takes of the closed
    surface, ``(1 - cos rho) / 2 = a / (A + a)``, ``a = perimeter^2 / 4 pi``; population mean of
    the share, rho clipped to 4 to 15 degrees. None for a closed component.
    """
    if equator_seam(tuple(outlines[0].seams), pole) is not None:
        return Circle(np.array([0.0, 0.0, 1.0]), np.pi / 2)
    if pole is None:
        return None
    discs = np.array([outline.rims[pole] for outline in outlines]) ** 2 / (4.0 * np.pi)
    areas = np.array([sum(outline.areas.values()) for outline in outlines])
    if not (areas > 0).all():
        raise InputError(
            f"component {outlines[0].name}: expected a positive surface area in every shape, "
            f"found {areas.min():g}"
        )
    share = float(np.mean(discs / (areas + discs)))
    radius = float(np.clip(np.arccos(1.0 - 2.0 * share), LEAST_WIDE_RADIUS, MOST_WIDE_RADIUS))
    return Circle(np.array([0.0, 0.0, 1.0]), radius)


def _length(vertices: FloatArray, loop: IntArray) -> float:
    positions = vertices[loop]
    return float(np.linalg.norm(np.roll(positions, -1, axis=0) - positions, axis=1).sum())
