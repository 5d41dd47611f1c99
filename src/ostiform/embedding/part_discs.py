"""The parts of a component as discs, each seen from the opening that leads to the root."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.domain import Circle, Sphere
from ostiform.embedding.disc import Disc, Opening
from ostiform.errors import InputError
from ostiform.surface import Component, Seam, split_ostium_name, without_unreferenced


@dataclass(frozen=True, slots=True, eq=False)
class PartOpening:
    """One opening of a part, in component indices.

    Attributes
    ----------
    name : str
        Full ostium name.
    loop : (n,) int64
        Component vertices, this part on the left.
    seam : Seam or None
        The seam it is one side of.
    """

    name: str
    loop: IntArray
    seam: Seam | None


@dataclass(frozen=True, slots=True, eq=False)
class PartDisc:
    """A part as a disc with holes.

    Attributes
    ----------
    part : str
    disc : Disc
        Its vertices and faces, numbered within the part.
    vertices : (n,) int64
        Component vertex of each of the disc's.
    parent : str or None
        Part beyond the outer opening whose seam fixes where the outer loop is; None for the root.
    """

    part: str
    disc: Disc
    vertices: IntArray
    parent: str | None


def part_openings(component: Component, part: str) -> tuple[PartOpening, ...]:
    """Return all openings of a part, rims first, then sides of seams."""
    openings = [
        PartOpening(name, rim, None)
        for name, rim in component.rims.items()
        if split_ostium_name(name)[0] == part
    ]
    for seam, curve in component.seams.items():
        sides = ((seam.first, np.concatenate([curve[:1], curve[:0:-1]])), (seam.second, curve))
        openings += [
            PartOpening(name, loop, seam)
            for name, loop in sides
            if split_ostium_name(name)[0] == part
        ]
    return tuple(openings)


def root_seam(seams: Sequence[Seam], pole: str | None) -> Seam:
    """Return the seam whose circle is the equator: the pole's, else the first."""
    return next((seam for seam in seams if pole in (seam.first, seam.second)), seams[0])


def part_discs(component: Component, sphere: Sphere) -> tuple[PartDisc, ...]:
    """Return the parts as discs, a part after the one that its outer opening leads to.

    With seams, the root is the side of the root seam with more openings, seen from that seam, and
    the part beyond it comes next; without, the only part is seen from the pole.

    Raises
    ------
    InputError
        If the component has no opening and no seam, or the sphere's pole is not a rim of it.
    """
    if component.seams:
        return _seamed_discs(component, sphere)
    openings = part_openings(component, component.parts[0])
    if not openings:
        raise InputError(
            f"{component.name}: expected at least one opening or seam to project from, found none"
        )
    pole = sphere.pole or max(sphere.rims, key=lambda name: sphere.rims[name].radius)
    if pole not in component.rims:
        raise InputError(
            f"{component.name}: expected the pole to be one of its openings "
            f"{', '.join(component.rims)}, found {pole}"
        )
    return (_part_disc(component, sphere, component.parts[0], pole, None),)


def _seamed_discs(component: Component, sphere: Sphere) -> tuple[PartDisc, ...]:
    root = root_seam(tuple(component.seams), sphere.pole)
    sides = {split_ostium_name(name)[0]: name for name in (root.first, root.second)}
    start = max(sides, key=lambda part: len(part_openings(component, part)))
    beyond = next(part for part in sides if part != start)
    discs = [
        _part_disc(component, sphere, start, sides[start], None),
        _part_disc(component, sphere, beyond, sides[beyond], start),
    ]
    reached = [start, beyond]
    for part in reached:  # grows: a walk over the tree of parts
        for opening in part_openings(component, part):
            if opening.seam is None:
                continue
            seam = opening.seam
            other = seam.second if opening.name == seam.first else seam.first
            child = split_ostium_name(other)[0]
            if child not in reached:
                reached.append(child)
                discs.append(_part_disc(component, sphere, child, other, part))
    return tuple(discs)


def _part_disc(
    component: Component, sphere: Sphere, part: str, outer: str, parent: str | None
) -> PartDisc:
    mine = component.faces[component.face_part == component.parts.index(part)]
    vertices, faces = without_unreferenced(mine, len(component.vertices))
    local = np.full(len(component.vertices), -1, dtype=np.int64)
    local[vertices] = np.arange(len(vertices))
    openings = {
        opening.name: Opening(opening.name, local[opening.loop], _hole_circle(sphere, opening))
        for opening in part_openings(component, part)
    }
    disc = Disc(
        np.ascontiguousarray(component.vertices[vertices]),
        faces,
        openings[outer],
        tuple(opening for name, opening in openings.items() if name != outer),
    )
    return PartDisc(part, disc, vertices, parent)


def _hole_circle(sphere: Sphere, opening: PartOpening) -> Circle:
    """The circle with the hole (what is not this part) inside."""
    if opening.seam is None:
        return sphere.rims[opening.name]
    circle = sphere.seams[opening.seam]
    if opening.name == opening.seam.first:
        return circle
    center: FloatArray = -circle.center
    return Circle(center, np.pi - circle.radius)
