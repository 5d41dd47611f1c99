"""Which regions of a solid lie on which side of an interface."""

from collections.abc import Mapping, Sequence

from ostiform.study.label_regions import Interface, Solid


def first_steps(solid: Solid) -> dict[int, dict[int, int]]:
    """Return the neighbour of every region on the way to every other."""
    beside = _neighbours(solid)
    return {
        start: {region: step for step in nexts for region in _reached(beside, step, without=start)}
        for start, nexts in beside.items()
    }


def side_of(solid: Solid, item: Interface) -> list[int]:
    """Return the regions on the side of an interface's first."""
    return _reached(_neighbours(solid), item.first, without=item.second)


def _neighbours(solid: Solid) -> dict[int, list[int]]:
    beside: dict[int, list[int]] = {k: [] for k in range(len(solid.names))}
    for item in solid.interfaces:
        beside[item.first].append(item.second)
        beside[item.second].append(item.first)
    return beside


def _reached(beside: Mapping[int, Sequence[int]], start: int, without: int) -> list[int]:
    found, front = [start], [start]
    while front:
        k = front.pop()
        for other in beside[k]:
            if other != without and other not in found:
                found.append(other)
                front.append(other)
    return found
