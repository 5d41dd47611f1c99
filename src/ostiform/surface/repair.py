"""Repair of meshes as people have them, before anything is known about their openings.

Each repair is safe: it changes connectivity that cannot be meant, moves no vertex, and is told in
one sentence with a count. What cannot be mended safely is left as it is, for the checks of
`topology` to refuse.
"""

from typing import Annotated

import numpy as np
from scipy.spatial import cKDTree

from ostiform.arrays import FloatArray, IntArray
from ostiform.surface.fans import MOST_FANS, with_single_fans
from ostiform.surface.operators import median_edge_length
from ostiform.surface.topology import (
    boundary_half_edges,
    connected_components,
    consistently_oriented,
    enclosed_volume,
    graph_labels,
    non_manifold_edges,
    non_manifold_vertices,
    unique_edges,
)
from ostiform.values import Axes, value

_SAME_PLACE_IN_EDGES = 1e-5
"""Rim vertices closer than this share of the median edge are one: float32 files resolve 1e-5 mm
at 100 mm, where edges are about 1 mm."""

_LARGEST_SHEET_SHARE = 0.01
"""Extra sheets at edges of three or more faces are removed only below this share of the area."""


@value
class MendedMesh:
    """A mesh after repair.

    Attributes
    ----------
    vertices : (V, 3) float64
    faces : (F, 3) int64
    source : (F,) int64
        The face of the input that each face was; -1 for a new one.
    repairs : tuple of str
        What was changed, one sentence each, with its count.
    """

    vertices: Annotated[FloatArray, Axes("V", 3)]
    faces: Annotated[IntArray, Axes("F", 3)]
    source: Annotated[IntArray, Axes("F")]
    repairs: tuple[str, ...]


def counted(count: int, noun: str, plural: str | None = None) -> str:
    """Return a count with its noun in the right number."""
    return f"{count} {noun if count == 1 else plural or noun + 's'}"


def without_useless_faces(mesh: MendedMesh) -> MendedMesh:
    """Drop triangles that use a vertex twice and triangles over the same vertices as another."""
    ordered = np.sort(mesh.faces, axis=1)
    is_degenerate = (ordered[:, 0] == ordered[:, 1]) | (ordered[:, 1] == ordered[:, 2])
    _, first = np.unique(ordered, axis=0, return_index=True)
    is_first = np.zeros(len(mesh.faces), dtype=np.bool_)
    is_first[first] = True
    n_repeated = int((~is_first & ~is_degenerate).sum())
    repairs = [
        f"dropped {counted(count, f'{kind} triangle')}"
        for count, kind in ((int(is_degenerate.sum()), "degenerate"), (n_repeated, "repeated"))
        if count
    ]
    return _with_faces(mesh, np.flatnonzero(is_first & ~is_degenerate), repairs)


def mended_mesh(mesh: MendedMesh) -> MendedMesh:
    """Mend the connectivity of a mesh as far as this is safe.

    In order: rim vertices at one place become one (so a soup of triangles becomes a surface);
    degenerate and repeated triangles are dropped; thin extra sheets at edges of three or more
    faces are dropped; faces of each piece are turned to agree with most of it; two openings that
    meet at a vertex are parted by one triangle; a vertex where two sheets only touch is split.
    Unused vertices stay.

    Parameters
    ----------
    mesh : MendedMesh

    Returns
    -------
    MendedMesh
        Consistently oriented; not necessarily connected, nor manifold where there is too much
        to mend.

    Raises
    ------
    TopologyError
        If edges of three or more faces cannot be mended, or the surface has one side only.
    """
    mesh = without_useless_faces(_with_rims_merged(mesh))
    mesh = _turned_alike(_without_extra_sheets(mesh))
    return _with_single_fans(mesh)


def outward_mesh(mesh: MendedMesh) -> MendedMesh:
    """Turn the faces of a consistently oriented mesh outward, piece by piece.

    Raises
    ------
    TopologyError
        If the faces are not consistently oriented, or two boundaries meet at a vertex.
    """
    piece = connected_components(mesh.faces)
    inward = np.array(
        [
            enclosed_volume(mesh.vertices, mesh.faces[piece == label]) < 0.0
            for label in range(int(piece.max(initial=-1)) + 1)
        ],
        dtype=np.bool_,
    )[piece]
    if not inward.any():
        return mesh
    turned = np.where(inward[:, None], mesh.faces[:, [0, 2, 1]], mesh.faces)
    repair = f"turned {counted(int(inward.sum()), 'triangle')} of an inside-out surface outward"
    return MendedMesh(mesh.vertices, turned, mesh.source, (*mesh.repairs, repair))


def _turned_alike(mesh: MendedMesh) -> MendedMesh:
    """Turn the faces of each piece that disagree with most of its others."""
    alike = consistently_oriented(mesh.faces)
    is_turned = (alike != mesh.faces).any(axis=1)
    if not is_turned.any():
        return mesh
    piece = connected_components(alike)
    share = np.bincount(piece, weights=is_turned) / np.bincount(piece)
    is_turned ^= share[piece] > 0.5
    faces = np.where(is_turned[:, None], mesh.faces[:, [0, 2, 1]], mesh.faces)
    n_turned = int(is_turned.sum())
    repair = f"turned {counted(n_turned, 'triangle')} to agree with the others"
    return MendedMesh(mesh.vertices, faces, mesh.source, (*mesh.repairs, repair))


def _with_faces(mesh: MendedMesh, kept: IntArray, repairs: list[str]) -> MendedMesh:
    if len(kept) == len(mesh.faces) and not repairs:
        return mesh
    return MendedMesh(mesh.vertices, mesh.faces[kept], mesh.source[kept], (*mesh.repairs, *repairs))


def _with_rims_merged(mesh: MendedMesh) -> MendedMesh:
    """Merge rim vertices at one place, each group into its first."""
    rim = np.unique(boundary_half_edges(mesh.faces))
    scale = median_edge_length(mesh.vertices, mesh.faces)
    if not len(rim) or not scale > 0.0:
        return mesh
    pairs = cKDTree(mesh.vertices[rim]).query_pairs(
        _SAME_PLACE_IN_EDGES * scale, output_type="ndarray"
    )
    if not len(pairs):
        return mesh
    place = np.arange(len(mesh.vertices))
    place[rim] = rim[_first_of_group(graph_labels(pairs[:, 0], pairs[:, 1], len(rim)))]
    # Only rims that close on each other are joined: openings that merely touch stay apart.
    edges = np.sort(boundary_half_edges(place[mesh.faces[_proper(place[mesh.faces])]]), axis=1)
    before = np.sort(place[boundary_half_edges(mesh.faces)], axis=1)
    span = len(place)
    closed = ~np.isin(before[:, 0] * span + before[:, 1], edges[:, 0] * span + edges[:, 1])
    joined = np.zeros(span, dtype=np.bool_)
    joined[before[closed]] = True
    target = np.where(joined[place], place, np.arange(span))
    n_merged = int((target != np.arange(span)).sum())
    if not n_merged:
        return mesh
    repair = f"merged {counted(n_merged, 'vertex', 'vertices')} lying on others"
    return MendedMesh(mesh.vertices, target[mesh.faces], mesh.source, (*mesh.repairs, repair))


def _first_of_group(label: IntArray) -> IntArray:
    """Return for each item (n,) the first item that has its label."""
    _, first, inverse = np.unique(label, return_index=True, return_inverse=True)
    group: IntArray = first[inverse.reshape(-1)]
    return group


def _proper(faces: IntArray) -> IntArray:
    return np.flatnonzero((faces != np.roll(faces, 1, axis=1)).all(axis=1))


def _without_extra_sheets(mesh: MendedMesh) -> MendedMesh:
    """Drop the smallest sheets that meet at edges of three or more faces."""
    if not len(non_manifold_edges(mesh.faces)):
        return mesh
    kept = np.arange(len(mesh.faces))
    corners = mesh.vertices[mesh.faces]
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    budget = _LARGEST_SHEET_SHARE * float(area.sum())
    n_edges = len(non_manifold_edges(mesh.faces))
    while True:
        faces = mesh.faces[kept]
        _, edge, count = unique_edges(faces)
        crowded = (count[edge] > 2).reshape(-1, 3).any(axis=1)
        if not crowded.any():
            break
        # Cut along the edges of many faces, the mesh falls into sheets.
        key = np.where(count[edge] > 2, len(count) + np.arange(len(edge)), edge)
        sheet = _joined_by_keys(key, len(faces))
        areas = np.bincount(sheet, weights=area[kept])
        smallest = min(np.unique(sheet[crowded]), key=lambda label: (areas[label], label))
        budget -= float(areas[smallest])
        if budget < 0.0:
            return mesh
        kept = kept[sheet != smallest]
    n_dropped = len(mesh.faces) - len(kept)
    return _with_faces(
        mesh,
        kept,
        [
            f"dropped {counted(n_dropped, 'triangle')} of extra sheets at "
            f"{counted(n_edges, 'edge')} of three or more triangles"
        ],
    )


def _joined_by_keys(key: IntArray, n_faces: int) -> IntArray:
    """Label (F,) faces connected through half-edges (3F,) of equal key."""
    order = np.argsort(key, kind="stable")
    owner = order // 3
    same = np.flatnonzero(key[order][1:] == key[order][:-1])
    return graph_labels(owner[same], owner[same + 1], n_faces)


def _with_single_fans(mesh: MendedMesh) -> MendedMesh:
    if len(non_manifold_vertices(mesh.faces)) > MOST_FANS:
        return mesh
    parted = with_single_fans(mesh.vertices, mesh.faces)
    repairs = []
    if parted.n_parted:
        repairs.append(
            f"parted openings that meet at {counted(parted.n_parted, 'vertex', 'vertices')} by "
            f"{counted(parted.n_parted, 'new triangle')}"
        )
    if parted.n_split:
        repairs.append(
            f"split {counted(parted.n_split, 'vertex', 'vertices')} where the surface only "
            "touches itself"
        )
    if not repairs:
        return mesh
    source = np.concatenate(
        [mesh.source, np.full(len(parted.faces) - len(mesh.faces), -1, dtype=np.int64)]
    )
    return MendedMesh(parted.vertices, parted.faces, source, (*mesh.repairs, *repairs))
