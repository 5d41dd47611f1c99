"""From one mesh that holds several joined parts, without labels, to a mesh for each.

The cuts at the seams divide it. Which side is whose follows from the caps that a label marks, else
from the number of openings on either side, else from the places of other cuts, else from the normal
of the plane, which then points into the second part of the seam.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.spatial import cKDTree

from ostiform.arrays import FloatArray, IntArray
from ostiform.errors import InputError, TopologyError
from ostiform.study.markups import Cut, cut_heights
from ostiform.study.parts import face_values
from ostiform.study.settings import StudySettings
from ostiform.surface import (
    CutSurface,
    MendedMesh,
    RawMesh,
    Seam,
    boundary_loops,
    component_parts,
    parted_at,
    split_ostium_name,
    without_unreferenced,
)


def parted_mesh(
    settings: StudySettings, mesh: RawMesh, mended: MendedMesh, cuts: Mapping[str, Cut]
) -> dict[str, RawMesh]:
    """Divide a mesh of several parts at the seams between them.

    Parameters
    ----------
    settings : StudySettings
    mesh : RawMesh
        As the file holds it, mm in LPS.
    mended : MendedMesh
        The same after repair, one connected surface.
    cuts : mapping of str to Cut
        By full ostium name; one for every seam under either of its names.

    Raises
    ------
    InputError
        If a seam has no cut, a cut meets nothing, or the sides cannot be told apart.
    TopologyError
        If a cut does not part the surface in two.
    """
    data = {}
    if settings.caps:
        array = str(settings.shapes.open["array"])
        values = face_values(mesh, array, "shapes.open")
        data = {array: np.where(mended.source >= 0, values[mended.source], np.nan)}
    pieces = {
        tuple(settings.parts): RawMesh(
            mended.vertices, mended.faces, cell_data=data, space=mesh.space, notes=mended.repairs
        )
    }
    for seam in settings.seam_pairs:
        first, second = (split_ostium_name(name)[0] for name in (seam.first, seam.second))
        group = next((g for g in pieces if first in g and second in g), None)
        if group is None:
            raise InputError(
                f"seam {seam.first} = {seam.second}: expected parts that no other seam joins, "
                "found them joined already"
            )
        cut = next((cuts[name] for name in (seam.first, seam.second) if name in cuts), None)
        if cut is None:
            raise InputError(
                f"expected a plane or a closed curve for the seam {seam.first} = {seam.second}, "
                f"found none: name one {seam.first} in [cuts]"
            )
        inner = [s for s in settings.seam_pairs if s != seam]
        sides = _sides_of(group, seam, inner)
        whole = pieces.pop(group)
        try:
            height = cut_heights(cut, whole.vertices)
            parted = parted_at(whole.vertices, whole.faces, height, cut.center, cut.reach)
        except (InputError, TopologyError) as error:
            raise type(error)(f"cut of {seam.first}: {error}") from None
        above = _side_of_caps(settings, whole, parted, sides)
        if above is None:
            above = _side_of_second(settings, parted, seam, sides, cut, cuts)
        for side, parts in ((-above, sides[0]), (above, sides[1])):
            pieces[parts] = _piece(whole, parted, np.flatnonzero(parted.side == side))
    left = next((group for group in pieces if len(group) > 1), None)
    if left is not None:
        raise InputError(
            f"expected a seam between the parts {' and '.join(left)} of one joined mesh, found "
            "none: add it in [[seams]]"
        )
    return {part: pieces[(part,)] for part in settings.parts}


def _sides_of(
    group: Sequence[str], seam: Seam, others: Sequence[Seam]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the parts on the side of the seam's first part, and of its second."""
    inside = [s for s in others if split_ostium_name(s.first)[0] in group]
    inside = [s for s in inside if split_ostium_name(s.second)[0] in group]
    groups = component_parts(tuple(group), inside)
    first, second = (split_ostium_name(name)[0] for name in (seam.first, seam.second))
    one = next(g for g in groups if first in g)
    two = next(g for g in groups if second in g)
    return one, two


def _side_of_second(
    settings: StudySettings,
    parted: CutSurface,
    seam: Seam,
    sides: tuple[tuple[str, ...], tuple[str, ...]],
    cut: Cut,
    cuts: Mapping[str, Cut],
) -> int:
    """Return the side, 1 or -1, that the second part of a seam lies on."""
    at_seams = {name for s in settings.seam_pairs for name in (s.first, s.second)}
    capped = set(settings.caps)
    wanted = [
        sum(
            f"{part}.{o}" not in at_seams | capped | set(cuts)
            for part in parts
            for o in settings.parts[part].ostia
        )
        for parts in sides
    ]
    found = {side: len(boundary_loops(parted.faces[parted.side == side])) - 1 for side in (1, -1)}
    if wanted[0] != wanted[1] and sorted(wanted) == sorted(found.values()):
        return 1 if found[1] == wanted[1] else -1
    nearer = _nearer_cuts(parted, sides, {n: c for n, c in cuts.items() if n not in at_seams})
    if nearer is not None:
        return nearer
    if cut.curve is not None:
        raise InputError(
            f"cut of {seam.first}: expected the openings to tell the two sides of the curve apart, "
            f"found {found[1]} and {found[-1]}: give a plane whose normal points into "
            f"{split_ostium_name(seam.second)[0]}"
        )
    heights = (parted.vertices[parted.faces].mean(axis=1) - cut.center) @ cut.normal
    return 1 if heights[parted.side == 1].mean() > heights[parted.side == -1].mean() else -1


def _side_of_caps(
    settings: StudySettings,
    whole: RawMesh,
    parted: CutSurface,
    sides: tuple[tuple[str, ...], tuple[str, ...]],
) -> int | None:
    """Return the side of the second parts by the caps of their openings, None without any."""
    votes = 0
    for name, value in settings.caps.items():
        part = split_ostium_name(name)[0]
        of_second = 1 if part in sides[1] else -1 if part in sides[0] else 0
        own = whole.cell_data[str(settings.shapes.open["array"])][parted.source] == value
        votes += of_second * int(np.sign(parted.side[own].sum()))
    return None if votes == 0 else int(np.sign(votes))


def _nearer_cuts(
    parted: CutSurface,
    sides: tuple[tuple[str, ...], tuple[str, ...]],
    cuts: Mapping[str, Cut],
) -> int | None:
    """Return the side of the second parts by the places of their own cuts, None without any."""
    votes = 0
    trees = {side: cKDTree(parted.vertices[_used(parted, side)]) for side in (1, -1)}
    for name, cut in cuts.items():
        part = split_ostium_name(name)[0]
        of_second = 1 if part in sides[1] else -1 if part in sides[0] else 0
        is_above = trees[1].query(cut.center)[0] < trees[-1].query(cut.center)[0]
        votes += of_second * (1 if is_above else -1)
    return None if votes == 0 else int(np.sign(votes))


def _used(parted: CutSurface, side: int) -> IntArray:
    return np.unique(parted.faces[parted.side == side])


def _piece(whole: RawMesh, parted: CutSurface, rows: IntArray) -> RawMesh:
    kept, faces = without_unreferenced(parted.faces[rows], len(parted.vertices))
    source = parted.source[rows]
    vertices: FloatArray = parted.vertices[kept]
    data = {name: values[source] for name, values in whole.cell_data.items()}
    return RawMesh(vertices, faces, cell_data=data, space=whole.space, notes=whole.notes)
