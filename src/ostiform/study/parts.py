"""From the file of one part to an oriented surface with loops, some of them named already."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.errors import InputError, TopologyError
from ostiform.study.markups import Cut, cut_heights
from ostiform.study.naming import loop_facts
from ostiform.study.settings import StudySettings
from ostiform.surface import (
    MendedMesh,
    RawMesh,
    boundary_half_edges,
    boundary_loops,
    connected_components,
    counted,
    crossing_triangles,
    face_areas,
    filled_loops,
    genus,
    lps_factors,
    mended_mesh,
    opened_by_value,
    outward_mesh,
    short_handle_curve,
    split_ostium_name,
    tube_cut,
    without_unreferenced,
)
from ostiform.values import Axes, value

LARGEST_STRAY_SHARE = 0.1
"""Pieces beside the largest are dropped only while they hold less than a tenth of the area."""

_NICK = 0.25
"""A loop beyond those expected is a nick below this share of the shortest expected perimeter."""
_NICK_OF_FEW_EDGES = 0.4
_FEW_EDGES = 8
"""With so few edges it may be somewhat longer: coarse meshes have coarse nicks."""
_NICK_OF_CLOSED = 0.25
"""Where no opening is expected: the share of the square root of the area."""


MIRROR = np.array([-1.0, 1.0, 1.0])
"""Factors from left to right."""


@value
class OpenPart:
    """One part with its loops, some of them named already.

    Attributes
    ----------
    vertices : (V, 3) float64, mm
        In LPS.
    faces : (F, 3) int64
        Counter-clockwise seen from outside.
    loops : tuple of (n,) int64
        The boundary loops.
    known : mapping of str to int
        Loops named already, by ostium.
    repairs : tuple of str
        What was changed on the way, one sentence each.
    """

    vertices: Annotated[FloatArray, Axes("V", 3)]
    faces: Annotated[IntArray, Axes("F", 3)]
    loops: tuple[IntArray, ...]
    known: Mapping[str, int]
    repairs: tuple[str, ...]


def internal_factors(settings: StudySettings) -> FloatArray:
    """Return the factors (3,) from the files' units and frame to millimetres in LPS."""
    return lps_factors(settings.units, settings.frame)


def opened_part(
    settings: StudySettings,
    part: str,
    mesh: RawMesh,
    cuts: Mapping[str, Cut],
    open_rims: Mapping[str, FloatArray],
) -> OpenPart:
    """Mend, open, orient and check the surface of one part.

    Parameters
    ----------
    settings : StudySettings
    part : str
    mesh : RawMesh
        Millimetres in LPS.
    cuts : mapping of str to Cut
        By the ostia of the part.
    open_rims : mapping of str to (n, 3) float64
        Where the mesh is open already, by the ostia of the part.

    Raises
    ------
    InputError
        If the mesh cannot be opened as told, or needs repair where the study allows none.
    TopologyError
        If the part is not one oriented manifold surface of genus 0.
    """
    mended = mended_mesh(_unmended(mesh))
    mended, rims = _without_caps(settings, part, mesh, mended)
    mended = _largest_piece(mended)
    for ostium, cut in cuts.items():
        mended, rims[ostium] = _cut_open(ostium, cut, mended)
    mended = outward_mesh(mended)
    if genus(mended.faces):
        raise TopologyError(
            f"expected a surface without handles, found {handle_sentence(mended)}: surfaces with "
            "handles cannot be embedded yet, close or cut it there first"
        )
    kept, faces = without_unreferenced(mended.faces, len(mended.vertices))
    loops = boundary_loops(faces)
    known = {
        ostium: _loop_of_cap(ostium, loops, np.searchsorted(kept, rim))
        for ostium, rim in rims.items()
    }
    for ostium, rim in open_rims.items():
        known[ostium] = _loop_along(ostium, mended.vertices[kept], loops, rim)
    opened = OpenPart(mended.vertices[kept], faces, loops, known, mended.repairs)
    opened = _without_nicks(opened, len(settings.parts[part].ostia))
    if opened.repairs and not settings.repair:
        raise InputError(
            "expected a surface that needs no repair (repair = false), found one that needs: "
            f"{'; '.join(opened.repairs)}: set repair = true or mend the file"
        )
    return replace(opened, repairs=(*opened.repairs, *_crossings(opened)))


@dataclass(frozen=True, slots=True, eq=False)
class PartFacts:
    """What can be said of a surface that may be unfit for use; None where it cannot be said."""

    vertices: FloatArray
    faces: IntArray
    n_openings: int | None
    genus: int | None
    n_components: int


def surface_facts(mesh: RawMesh) -> PartFacts:
    """Return what can be said of a mesh, mended as far as it can be."""
    mended = _unmended(mesh)
    try:
        mended = mended_mesh(mended)
        n_openings: int | None = len(boundary_loops(mended.faces))
        handles: int | None = genus(mended.faces)
    except TopologyError:
        n_openings, handles = None, None
    n_components = int(connected_components(mended.faces).max(initial=-1)) + 1
    return PartFacts(mended.vertices, mended.faces, n_openings, handles, n_components)


def close_loops(opened: OpenPart, chosen: IntArray, repair: str) -> OpenPart:
    """Return the part with some of its loops (indices) closed."""
    if not len(chosen):
        return opened
    vertices, faces = filled_loops(
        opened.vertices, opened.faces, [opened.loops[k] for k in chosen.tolist()]
    )
    loops = boundary_loops(faces)
    first = {int(loop[0]): k for k, loop in enumerate(loops)}
    known = {name: first[int(opened.loops[k][0])] for name, k in opened.known.items()}
    return replace(
        opened,
        vertices=vertices,
        faces=faces,
        loops=loops,
        known=known,
        repairs=(*opened.repairs, repair),
    )


def reflected_part(opened: OpenPart) -> OpenPart:
    """Return the mirror image of a part, left for right, its faces outward as before."""
    return replace(
        opened,
        vertices=opened.vertices * MIRROR,
        faces=opened.faces[:, ::-1],
        loops=tuple(np.roll(loop[::-1], 1) for loop in opened.loops),
        repairs=(*opened.repairs, "reflected left for right, as the study says"),
    )


def check_frame(settings: StudySettings, mesh: RawMesh) -> None:
    """Refuse a mesh whose file states another frame than the study's.

    Raises
    ------
    InputError
    """
    if mesh.space is not None and mesh.space != settings.frame:
        raise InputError(
            f"expected the frame {settings.frame} of the study, found a file that states "
            f"{mesh.space}: set frame, or convert the file"
        )


def connected_mesh(mesh: RawMesh) -> MendedMesh:
    """Mend a mesh and keep its largest piece, its faces turned outward.

    Raises
    ------
    TopologyError
        If it cannot be mended, or is in several large pieces.
    """
    return outward_mesh(_largest_piece(mended_mesh(_unmended(mesh))))


def handle_sentence(mesh: MendedMesh) -> str:
    """Return how many handles a surface has and where a short curve round one of them lies."""
    handles = genus(mesh.faces)
    curve = short_handle_curve(mesh.vertices, mesh.faces)
    facts = loop_facts(mesh.vertices, curve)
    where = ", ".join(f"{x + 0.0:.1f}" for x in facts.center.round(1))
    return (
        f"genus {handles} ({counted(handles, 'handle')}, a curve of {facts.perimeter:.3g} mm round "
        f"one at [{where}] mm)"
    )


def _unmended(mesh: RawMesh) -> MendedMesh:
    n_unused = len(mesh.vertices) - len(np.unique(mesh.faces))
    unused = f"dropped {counted(n_unused, 'vertex', 'vertices')} of no triangle"
    return MendedMesh(
        mesh.vertices,
        mesh.faces,
        np.arange(len(mesh.faces)),
        (*mesh.notes, *((unused,) if n_unused else ())),
    )


def _without_caps(
    settings: StudySettings, part: str, mesh: RawMesh, mended: MendedMesh
) -> tuple[MendedMesh, dict[str, IntArray]]:
    caps = {
        split_ostium_name(name)[1]: value
        for name, value in settings.caps.items()
        if split_ostium_name(name)[0] == part
    }
    if not caps:
        return mended, {}
    values = face_values(mesh, str(settings.shapes.open["array"]), "shapes.open")
    own = np.where(mended.source >= 0, values[mended.source], np.nan)
    opened = opened_by_value(mended.faces, own, caps)
    is_wall = ~np.isin(own, list(caps.values()))
    without = replace(mended, faces=opened.faces, source=mended.source[is_wall])
    return without, dict(opened.rims)


def face_values(mesh: RawMesh, array: str, key: str) -> FloatArray:
    """Return the values (F,) of a cell array, or of a point array where all corners agree.

    Raises
    ------
    InputError
        If the mesh has no such array of one number each.
    """
    if array in mesh.cell_data:
        values = mesh.cell_data[array]
    elif array in mesh.point_data:
        corners = mesh.point_data[array][mesh.faces].astype(np.float64)
        if corners.ndim == 2:
            agree = (corners == corners[:, :1]).all(axis=1)
            values = np.where(agree, corners[:, 0], np.nan)
        else:
            values = corners
    else:
        found = ", ".join(mesh.cell_data) or "none"
        points = ", ".join(mesh.point_data) or "none"
        raise InputError(
            f"expected the cell array {array} of {key}, found the cell arrays {found} and the "
            f"point arrays {points}"
        )
    if values.ndim != 1 or values.dtype.kind not in "iufb":
        raise InputError(f"expected one number per item in the array {array}, found several")
    return values.astype(np.float64)


def _cut_open(ostium: str, cut: Cut, mesh: MendedMesh) -> tuple[MendedMesh, IntArray]:
    """Return the mesh without what a cut takes off, and the vertices of the new rim."""
    before = np.unique(boundary_half_edges(mesh.faces))
    try:
        opened = tube_cut(
            mesh.vertices, mesh.faces, cut_heights(cut, mesh.vertices), cut.center, cut.reach
        )
    except (InputError, TopologyError) as error:
        raise type(error)(f"cut of {ostium}: {error}") from None
    after = np.unique(boundary_half_edges(opened.faces))
    rim = np.setdiff1d(after, before)
    cut_mesh = MendedMesh(opened.vertices, opened.faces, mesh.source[opened.source], mesh.repairs)
    return cut_mesh, rim


def _largest_piece(mesh: MendedMesh) -> MendedMesh:
    piece = connected_components(mesh.faces)
    if not piece.any():
        return mesh
    area = np.bincount(piece, weights=face_areas(mesh.vertices, mesh.faces))
    largest = int(area.argmax())
    share = 1.0 - area[largest] / area.sum()
    if share > LARGEST_STRAY_SHARE:
        raise TopologyError(
            f"expected one connected surface, found {len(area)} pieces, {100 * share:.0f} % of the "
            "area outside the largest: keep the right one or join them"
        )
    is_stray = piece != largest
    repair = (
        f"dropped {counted(int(is_stray.sum()), 'triangle')} in "
        f"{counted(len(area) - 1, 'stray piece')}"
    )
    return MendedMesh(
        mesh.vertices, mesh.faces[~is_stray], mesh.source[~is_stray], (*mesh.repairs, repair)
    )


def _loop_of_cap(ostium: str, loops: tuple[IntArray, ...], rim: IntArray) -> int:
    found = [k for k, loop in enumerate(loops) if np.isin(loop, rim).all()]
    if len(found) != 1 or len(loops[found[0]]) != len(rim):
        raise TopologyError(
            f"expected the cap of {ostium} to leave one opening, found {len(found)} loops round "
            f"its {len(rim)} rim vertices"
        )
    return found[0]


def _loop_along(
    ostium: str, vertices: FloatArray, loops: tuple[IntArray, ...], rim: FloatArray
) -> int:
    """Return the loop on which the points (n, 3) of a rim lie."""
    away = [
        float(np.median(np.linalg.norm(rim[:, None] - vertices[loop], axis=2).min(axis=1)))
        for loop in loops
    ]
    if not away or min(away) > 1e-6 * max(np.ptp(vertices, axis=0).max(), 1.0):
        raise TopologyError(f"expected the contact of {ostium} to stay open, found it closed")
    return int(np.argmin(away))


def _without_nicks(opened: OpenPart, n_expected: int) -> OpenPart:
    """Close loops beyond those expected that are tiny beside them."""
    perimeters = np.array([loop_facts(opened.vertices, loop).perimeter for loop in opened.loops])
    n_edges = np.array([len(loop) for loop in opened.loops])
    is_free = np.ones(len(perimeters), dtype=np.bool_)
    is_free[list(opened.known.values())] = False
    order = np.flatnonzero(is_free)[np.argsort(perimeters[is_free], kind="stable")]
    extra = order[: max(len(perimeters) - n_expected, 0)]
    others = np.setdiff1d(np.arange(len(perimeters)), extra)
    if n_expected and len(others):
        shortest = float(perimeters[others].min())
        is_tiny = (perimeters[extra] < _NICK * shortest) | (
            (n_edges[extra] <= _FEW_EDGES) & (perimeters[extra] < _NICK_OF_FEW_EDGES * shortest)
        )
    else:
        length = float(np.sqrt(face_areas(opened.vertices, opened.faces).sum()))
        is_tiny = perimeters[extra] < _NICK_OF_CLOSED * length
    nicks = extra[is_tiny]
    sizes = ", ".join(
        f"{n_edges[k]} edges, {perimeters[k]:.2g} mm round, at "
        f"[{', '.join(f'{x:.4g}' for x in loop_facts(opened.vertices, opened.loops[k]).center)}]"
        for k in nicks.tolist()
    )
    return close_loops(opened, nicks, f"closed {counted(len(nicks), 'tiny hole')} ({sizes})")


def _crossings(opened: OpenPart) -> tuple[str, ...]:
    pairs = crossing_triangles(opened.vertices, opened.faces)
    if not len(pairs):
        return ()
    where = opened.vertices[opened.faces[pairs[0, 0]]].mean(axis=0)
    return (
        f"left {counted(len(pairs), 'pair')} of triangles that pass through each other, the first "
        f"at [{', '.join(f'{x:.4g}' for x in where)}] mm",
    )
