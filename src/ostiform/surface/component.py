"""Welding: parts joined by seams become one mesh per connected set of parts, and back."""

from collections.abc import Mapping, Sequence

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.errors import InputError, TopologyError
from ostiform.surface.topology import (
    connected_components,
    genus,
    unique_edges,
)
from ostiform.surface.types import Component, Seam, Surface


def split_ostium_name(name: str) -> tuple[str, str]:
    """Return the part and the ostium of a full name ``"PART.OSTIUM"``.

    Raises
    ------
    InputError
        If the name is not of that form.
    """
    part, dot, ostium = name.partition(".")
    if not (part and dot and ostium):
        raise InputError(f'expected an ostium written "PART.OSTIUM", found "{name}"')
    return part, ostium


def component_parts(parts: Sequence[str], seams: Sequence[Seam]) -> tuple[tuple[str, ...], ...]:
    """Return the sets of parts that seams join, each in study order, ordered by first part.

    Raises
    ------
    InputError
        If a seam names a part that does not exist.
    """
    label = {part: index for index, part in enumerate(parts)}
    for seam in seams:
        ends = [split_ostium_name(name)[0] for name in (seam.first, seam.second)]
        for part in ends:
            if part not in label:
                raise InputError(
                    f"seam {seam.first} = {seam.second}: expected one of the parts "
                    f"{', '.join(parts)}, found {part}"
                )
        low, high = sorted((label[ends[0]], label[ends[1]]))
        label = {part: low if index == high else index for part, index in label.items()}
    return tuple(
        tuple(part for part in parts if label[part] == index)
        for index in sorted(set(label.values()))
    )


def welded_components(parts: Mapping[str, Surface], seams: Sequence[Seam]) -> tuple[Component, ...]:
    """Weld the two rims of every seam and return one mesh per connected set of parts.

    Vertices keep their order, part after part; a seam's vertices are those of its first part.
    Each seam's curve runs as the loop of its second part does (that part on the left) and starts
    where that loop starts.

    Parameters
    ----------
    parts : mapping of str to Surface
        In study order.
    seams : sequence of Seam
        The two loops of each hold the same positions bit for bit, in opposite directions.

    Returns
    -------
    tuple of Component
        Ordered by first part.

    Raises
    ------
    InputError
        If a seam names a loop that does not exist, or its two loops do not coincide.
    TopologyError
        If a seam joins a part to itself, seams form a cycle, or a component is not one connected
        surface of genus 0.
    """
    _refuse_handles(tuple(parts), seams)
    return tuple(
        _welded(
            {name: parts[name] for name in group},
            [seam for seam in seams if split_ostium_name(seam.first)[0] in group],
        )
        for group in component_parts(tuple(parts), seams)
    )


def _refuse_handles(parts: tuple[str, ...], seams: Sequence[Seam]) -> None:
    joined: list[Seam] = []
    for seam in seams:
        first, second = (split_ostium_name(name)[0] for name in (seam.first, seam.second))
        if first == second:
            raise TopologyError(
                f"seam {seam.first} = {seam.second}: expected a seam between two parts, found one "
                f"that joins {first} to itself: surfaces with handles cannot be embedded yet"
            )
        if any({first, second} <= set(group) for group in component_parts(parts, joined)):
            raise TopologyError(
                f"seam {seam.first} = {seam.second}: expected seams that do not form a cycle, "
                f"found {first} and {second} already joined by other seams: surfaces with handles "
                "cannot be embedded yet"
            )
        joined.append(seam)


def _welded(parts: Mapping[str, Surface], seams: Sequence[Seam]) -> Component:
    names = tuple(parts)
    component_name = "+".join(names)
    offsets = dict(
        zip(
            names,
            np.cumsum([0, *(len(surface.vertices) for surface in parts.values())])[:-1].tolist(),
            strict=True,
        )
    )
    vertices = np.concatenate([surface.vertices for surface in parts.values()])  # (V, 3)
    welded = np.arange(len(vertices))
    curves: dict[Seam, IntArray] = {}
    for seam in seams:
        first = _global_loop(parts, offsets, seam.first)
        second = _global_loop(parts, offsets, seam.second)
        welded[second] = first[_coincident(vertices, first, second, seam)]
        curves[seam] = second
    sewn = {name for seam in seams for name in (seam.first, seam.second)}
    rims = {
        f"{name}.{ostium}": offsets[name] + loop
        for name, surface in parts.items()
        for ostium, loop in surface.loops.items()
        if f"{name}.{ostium}" not in sewn
    }
    faces = np.concatenate([welded[offsets[n] + surface.faces] for n, surface in parts.items()])
    face_part = np.repeat(np.arange(len(names)), [len(surface.faces) for surface in parts.values()])
    vertices, faces, face_part = _without_double_chords(vertices, faces, face_part, names)
    _refuse_other_topology(component_name, faces)
    kept = np.flatnonzero(welded == np.arange(len(welded)))
    kept = np.concatenate([kept, np.arange(len(welded), len(vertices))])
    index = np.full(len(vertices), -1, dtype=np.int64)
    index[kept] = np.arange(len(kept))
    return Component(
        name=component_name,
        parts=names,
        vertices=vertices[kept],
        faces=index[faces],
        face_part=face_part,
        rims={name: index[welded[loop]] for name, loop in rims.items()},
        seams={seam: index[welded[curve]] for seam, curve in curves.items()},
    )


def _global_loop(parts: Mapping[str, Surface], offsets: Mapping[str, int], name: str) -> IntArray:
    part, ostium = split_ostium_name(name)
    loops = parts[part].loops
    if ostium not in loops:
        raise InputError(
            f"expected an opening {ostium} on {part} for a seam, found {', '.join(loops) or 'none'}"
        )
    return offsets[part] + loops[ostium]


def _coincident(vertices: FloatArray, first: IntArray, second: IntArray, seam: Seam) -> IntArray:
    """Return for each vertex of the second loop its place in the first, (n,) int64."""
    place = {vertices[v].tobytes(): k for k, v in enumerate(first.tolist())}
    found = np.array([place.get(vertices[v].tobytes(), -1) for v in second.tolist()], np.int64)
    n_common = int((found >= 0).sum())
    if len(first) != len(second) or n_common < len(second) or len(place) < len(first):
        raise InputError(
            f"seam {seam.first} = {seam.second}: expected two loops of the same positions, found "
            f"{len(first)} and {len(second)} vertices with {n_common} in common: weld them first"
        )
    if ((found - np.roll(found, -1)) % len(first) != 1).any():
        raise InputError(
            f"seam {seam.first} = {seam.second}: expected two loops that run in opposite "
            "directions, found the same vertices in another order: check the orientation of the "
            "parts"
        )
    return found


def _without_double_chords(
    vertices: FloatArray, faces: IntArray, face_part: IntArray, parts: Sequence[str]
) -> tuple[FloatArray, IntArray, IntArray]:
    """Split, at their midpoints, interior edges that two parts have between the same vertices.

    Two rims with a chord between the same two seam vertices would weld to an edge of four faces.
    """
    while True:
        edges, index, count = unique_edges(faces)
        doubled = [
            (edge, np.flatnonzero(index == edge) // 3) for edge in np.flatnonzero(count == 4)
        ]
        doubled = [(edge, users) for edge, users in doubled if len(set(face_part[users])) == 2]
        if not doubled:
            return vertices, faces, face_part
        edge, users = doubled[0]
        pair = users[face_part[users] == face_part[users].max()]
        one, two = edges[edge]
        middle = len(vertices)
        vertices = np.vstack([vertices, 0.5 * (vertices[one] + vertices[two])])
        halves = np.where(faces[pair] == two, middle, faces[pair])
        faces = np.vstack([faces, halves])
        faces[pair] = np.where(faces[pair] == one, middle, faces[pair])
        face_part = np.concatenate([face_part, face_part[pair]])


def _refuse_other_topology(name: str, faces: IntArray) -> None:
    n_pieces = int(connected_components(faces).max(initial=-1)) + 1
    if n_pieces != 1:
        raise TopologyError(
            f"component {name}: expected one connected surface, found {n_pieces} pieces: remove "
            "the stray ones"
        )
    handles = genus(faces)
    if handles:
        raise TopologyError(
            f"component {name}: expected a surface without handles, found genus {handles}: "
            "surfaces with handles cannot be embedded yet, close them first"
        )
