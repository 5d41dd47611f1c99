"""Preparation of a mesh for a straight-line map with rims on circles (design 3, step 1).

A straight edge between two points of a concave circle leaves the domain, so a triangle with all
corners on a circle, or an inner edge that joins two points of circles, folds whatever the map. Such
edges are split. Triangles without area and very short edges of rims are removed, because one
vanishing triangle stalls every barrier method.
"""

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.errors import TopologyError
from ostiform.surface.operators import median_edge_length
from ostiform.surface.surgery import (
    MarkedMesh,
    collapsed_edges,
    compacted,
    flipped_edges,
    split_edges,
    split_faces,
)
from ostiform.surface.topology import unique_edges
from ostiform.surface.types import Component

# Rim and seam edges below this share of the mesh's median edge are collapsed.
SHORT_EDGE = 0.15
# A triangle is degenerate when its height is below this share of its longest edge: float32 files
# resolve about 1e-5 mm at 100 mm, 1e-5 of an edge of 1 mm.
DEGENERATE_HEIGHT = 1e-4
# Fewer edges than this do not resolve a circle (the octagon is 10 % smaller than its circle).
LEAST_LOOP = 8
# Each round removes an independent set; what is left after these is reported, not forced.
MOST_ROUNDS = 20


def cleaned_for_embedding(component: Component) -> tuple[Component, tuple[str, ...]]:
    """Return a component that a straight-line map with rims on circles can exist for.

    In order: degenerate triangles are removed by edge flips and collapses; rim and seam edges
    shorter than 0.15 of the median edge are collapsed; rims and seams of fewer than 8 edges are
    refined by splitting; inner edges that join two vertices of rims or seams are split, so that no
    triangle keeps three vertices on them. Splits do not change the surface as a point set; a
    collapse keeps one of the two ends where it is.

    Parameters
    ----------
    component : Component
        Its rims and seams must be disjoint simple cycles; orientation and genus are not checked.

    Returns
    -------
    component : Component
        The same object where nothing was to be done.
    repairs : tuple of str
        One sentence per kind of repair, with its count.

    Raises
    ------
    TopologyError
        If a rim or seam visits a vertex twice or shares one with another.
    """
    _check_curves(component)
    curves = (*component.rims.values(), *component.seams.values())
    mesh = MarkedMesh(component.vertices, component.faces, component.face_part, curves)
    repairs: list[str] = []
    mesh = _without_degenerate_triangles(mesh, repairs)
    mesh = _without_short_curve_edges(mesh, repairs)
    mesh = _with_resolved_curves(mesh, repairs)
    mesh = _without_chords(mesh, repairs)
    if not repairs:
        return component, ()
    mesh = compacted(mesh)
    n_rims = len(component.rims)
    cleaned = Component(
        component.name,
        component.parts,
        mesh.vertices,
        mesh.faces,
        mesh.face_part,
        dict(zip(component.rims, mesh.curves[:n_rims], strict=True)),
        dict(zip(component.seams, mesh.curves[n_rims:], strict=True)),
    )
    return cleaned, tuple(repairs)


def _check_curves(component: Component) -> None:
    visits = np.zeros(len(component.vertices), dtype=np.int64)
    for curve in (*component.rims.values(), *component.seams.values()):
        visits += np.bincount(curve, minlength=len(visits))
    if (visits > 1).any():
        raise TopologyError(
            f"{component.name}: expected rims and seams that are disjoint simple loops, found "
            f"{int((visits > 1).sum())} vertices visited more than once, the first at index "
            f"{int(np.argmax(visits > 1))}; repair the surface there"
        )


def _without_degenerate_triangles(mesh: MarkedMesh, repairs: list[str]) -> MarkedMesh:
    found = len(_degenerate_faces(mesh))
    if not found:
        return mesh
    flips, collapses = 0, 0
    for _ in range(MOST_ROUNDS):
        degenerate = _degenerate_faces(mesh)
        corners = mesh.vertices[mesh.faces[degenerate]]  # (K, 3, 3)
        lengths = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)  # (K, 3)
        is_cap = lengths.min(axis=1) > SHORT_EDGE * lengths.max(axis=1)
        mesh, flipped = flipped_edges(mesh, degenerate[is_cap])
        degenerate = _degenerate_faces(mesh)
        kept, removed = _shortest_edges(mesh, degenerate)
        mesh, collapsed = collapsed_edges(mesh, kept, removed, LEAST_LOOP, DEGENERATE_HEIGHT)
        flips, collapses = flips + flipped, collapses + collapsed
        if not flipped + collapsed or not len(_degenerate_faces(mesh)):
            break
    left = len(_degenerate_faces(mesh))
    repairs.append(
        f"{found} triangles without area: {flips} edges flipped, {collapses} collapsed, "
        f"{left} triangles left"
    )
    return mesh


def _degenerate_faces(mesh: MarkedMesh) -> IntArray:
    corners = mesh.vertices[mesh.faces]
    edges = np.roll(corners, -1, axis=1) - corners  # (F, 3, 3)
    longest_squared = np.einsum("fka,fka->fk", edges, edges).max(axis=1)
    double_areas = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    return np.flatnonzero(double_areas <= DEGENERATE_HEIGHT * longest_squared)


def _shortest_edges(mesh: MarkedMesh, faces: IntArray) -> tuple[IntArray, IntArray]:
    """Ends (2K,) and (2K,) of the shortest edge of each face, in both directions."""
    corners = mesh.vertices[mesh.faces[faces]]
    lengths = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)  # (K, 3)
    shortest = np.argmin(lengths, axis=1)
    rows = np.arange(len(faces))
    start = mesh.faces[faces][rows, shortest]
    end = mesh.faces[faces][rows, (shortest + 1) % 3]
    return _both_ways(start, end, lengths[rows, shortest])


def _both_ways(start: IntArray, end: IntArray, lengths: FloatArray) -> tuple[IntArray, IntArray]:
    """Both directions of each edge, one after the other, shortest edge first."""
    order = np.argsort(lengths, kind="stable")
    kept = np.stack([start, end], axis=1)[order].ravel()
    removed = np.stack([end, start], axis=1)[order].ravel()
    return kept, removed


def _without_short_curve_edges(mesh: MarkedMesh, repairs: list[str]) -> MarkedMesh:
    limit = SHORT_EDGE * median_edge_length(mesh.vertices, mesh.faces)
    total = 0
    for _ in range(MOST_ROUNDS):
        edges = mesh.curve_edges
        lengths = np.linalg.norm(mesh.vertices[edges[:, 1]] - mesh.vertices[edges[:, 0]], axis=1)
        short = np.flatnonzero(lengths < limit)
        kept, removed = _both_ways(edges[short, 0], edges[short, 1], lengths[short])
        mesh, collapsed = collapsed_edges(mesh, kept, removed, LEAST_LOOP, DEGENERATE_HEIGHT)
        total += collapsed
        if not collapsed:
            break
    if total:
        repairs.append(
            f"{total} edges of rims and seams below {SHORT_EDGE} of the median edge collapsed"
        )
    return mesh


def _with_resolved_curves(mesh: MarkedMesh, repairs: list[str]) -> MarkedMesh:
    total = 0
    while any(len(curve) < LEAST_LOOP for curve in mesh.curves):
        coarse = [curve for curve in mesh.curves if len(curve) < LEAST_LOOP]
        edges = np.concatenate([_longest_edges(mesh.vertices, curve) for curve in coarse])
        mesh = split_edges(mesh, edges)
        total += len(edges)
    if total:
        repairs.append(f"{total} edges split on rims and seams of fewer than {LEAST_LOOP} edges")
    return mesh


def _longest_edges(vertices: FloatArray, curve: IntArray) -> IntArray:
    """The longest edges (K, 2) of a curve, as many as it lacks or has, whichever is fewer."""
    edges = np.stack([curve, np.roll(curve, -1)], axis=1)
    lengths = np.linalg.norm(vertices[edges[:, 1]] - vertices[edges[:, 0]], axis=1)
    longest: IntArray = edges[np.argsort(-lengths, kind="stable")[: LEAST_LOOP - len(curve)]]
    return longest


def _without_chords(mesh: MarkedMesh, repairs: list[str]) -> MarkedMesh:
    """Split inner edges with both ends on curves, and faces whose three edges lie on curves."""
    curve_keys = mesh.edge_keys(mesh.curve_edges)
    on_curve = mesh.curve_of_vertex >= 0
    edges = unique_edges(mesh.faces)[0]
    edges = edges[on_curve[edges].all(axis=1)]
    chords = edges[~np.isin(mesh.edge_keys(edges), curve_keys)]
    if len(chords):
        mesh = split_edges(mesh, chords)
        repairs.append(f"{len(chords)} inner edges that join two vertices of rims or seams split")
    on_curve = mesh.curve_of_vertex >= 0
    enclosed = np.flatnonzero(on_curve[mesh.faces].all(axis=1))
    if len(enclosed):
        mesh = split_faces(mesh, enclosed)
        repairs.append(f"{len(enclosed)} triangles between rims and seams only split")
    return mesh
