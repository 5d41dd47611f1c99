"""Which circles of a component sphere share a region, and which lie inside which.

Seams cut a component sphere into one region per part. Seen from the root (the part or the two
parts at the pole) every other part lies inside one seam's circle, its *container*; the circles of
a part, those of its ostia and of the seams that lead further, lie inside its container and
outside one another.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ostiform.errors import TopologyError
from ostiform.surface import Seam, split_ostium_name


@dataclass(frozen=True, slots=True)
class PartRegion:
    """The region of one part on its component sphere.

    Attributes
    ----------
    container : Seam or None
        The seam the part lies inside of, seen from the root; None for the part of a component
        without seams.
    curves : tuple of str
        The rims that bound the part.
    further_seams : tuple of Seam
        The seams that lead from it to parts farther from the root.
    descendants : tuple of str
        The part itself and every part that is reached through it.
    """

    container: Seam | None
    curves: tuple[str, ...]
    further_seams: tuple[Seam, ...]
    descendants: tuple[str, ...]


def handle_seams(seams: Sequence[Seam]) -> tuple[Seam, ...]:
    """Return the seams that join a part to itself."""
    return tuple(
        seam
        for seam in seams
        if split_ostium_name(seam.first)[0] == split_ostium_name(seam.second)[0]
    )


def equator_seam(seams: Sequence[Seam], pole: str | None) -> Seam | None:
    """Return the seam whose circle is the equator: the pole's, else the first between parts."""
    handles = handle_seams(seams)
    between = [seam for seam in seams if seam not in handles]
    for seam in between:
        if pole in (seam.first, seam.second):
            return seam
    return between[0] if between else None


def far_part(seam: Seam, regions: Mapping[str, PartRegion]) -> str:
    """Return the part of a seam, not the equator, that is farther from the root."""
    first, second = split_ostium_name(seam.first)[0], split_ostium_name(seam.second)[0]
    return second if regions[second].container == seam else first


def part_regions(
    parts: Sequence[str], rims: Sequence[str], seams: Sequence[Seam], pole: str | None
) -> dict[str, PartRegion]:
    """Return the region of every part of a component.

    Parameters
    ----------
    parts : sequence of str
    rims : sequence of str
        Full names of the ostia that stay open, both sides of handles included.
    seams : sequence of Seam
        Those between different parts.
    pole : str or None

    Raises
    ------
    TopologyError
        If seams form a cycle, which is a handle of the joined surface, or leave a part out.
    """
    equator = equator_seam(seams, pole)
    containers: dict[str, Seam | None] = {}
    leading: dict[str, list[Seam]] = {part: [] for part in parts}
    if equator is None:
        containers[parts[0]] = None
    else:
        for name in (equator.first, equator.second):
            containers[split_ostium_name(name)[0]] = equator
    reached = list(containers)
    remaining = [seam for seam in seams if seam != equator]
    for near in reached:
        for seam in tuple(remaining):
            ends = [split_ostium_name(name)[0] for name in (seam.first, seam.second)]
            if near not in ends:
                continue
            far = ends[1] if ends[0] == near else ends[0]
            if far in containers:
                raise TopologyError(
                    f"seam {seam.first} = {seam.second}: expected seams that do not form a cycle, "
                    f"found {near} and {far} already joined by other seams: surfaces with handles "
                    "cannot be embedded yet"
                )
            containers[far] = seam
            leading[near].append(seam)
            reached.append(far)
            remaining.remove(seam)
    left_out = [part for part in parts if part not in containers]
    if left_out:
        raise TopologyError(
            f"component {'+'.join(parts)}: expected parts joined by seams, found none that leads "
            f"to {', '.join(left_out)}"
        )
    descendants: dict[str, tuple[str, ...]] = {}
    for part in reversed(reached):
        beyond = [name for seam in leading[part] for name in descendants[_other_part(seam, part)]]
        descendants[part] = (part, *beyond)
    return {
        part: PartRegion(
            container=containers[part],
            curves=tuple(name for name in rims if split_ostium_name(name)[0] == part),
            further_seams=tuple(leading[part]),
            descendants=descendants[part],
        )
        for part in parts
    }


def _other_part(seam: Seam, part: str) -> str:
    first, second = split_ostium_name(seam.first)[0], split_ostium_name(seam.second)[0]
    return second if first == part else first
