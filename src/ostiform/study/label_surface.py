"""From a solid of regions to the meshes of its parts, which share their rims.

The solid's surface is a sphere. Every interface is one closed curve on it, and parts it in two; a
region is what lies on its side of all of them. So the parts have the openings that the study says
whatever the order of the parts, the numbers of the labels or the size of the triangles.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np
from scipy.sparse import coo_array, csr_array, diags_array
from scipy.sparse.csgraph import dijkstra

from ostiform.arrays import FloatArray, IntArray
from ostiform.errors import InputError, TopologyError
from ostiform.study.label_paths import first_steps, side_of
from ostiform.study.label_regions import Interface, Solid
from ostiform.study.markups import Cut, cut_heights
from ostiform.surface import (
    CutSurface,
    LevelField,
    enclosed_volume,
    face_areas,
    genus,
    isotropic_remeshed,
    level_surface,
    parted_along,
    parted_at,
    solid_field,
    unique_edges,
    without_unreferenced,
)

_LEAST = 0.25
"""Share of a voxel: where the mended solid and its smooth field disagree the field is this far
from zero on the solid's side."""
_SMOOTHING_ROUNDS = 10
"""Rounds in which the border of two regions is smoothed along the surface: about two voxels."""
_APART_IN_STEPS = 2.0
"""Regions without an interface keep this many voxels of the region between them on either side."""
_BAND_IN_SLICES = 1.5
"""The rim follows the plane through its contact as far as that lies within so many slices."""
_APART_PLANES = 1.5
"""Voxels between a rim that follows a plane and the other contacts."""
_TRIMMED = 2.5
"""Points further from the plane than this many median distances have no say in it."""

Rim = Literal["plane", "curve"]


@dataclass(frozen=True, slots=True, eq=False)
class PartedSurface:
    """The meshes of the parts of one solid.

    Attributes
    ----------
    meshes : mapping of str to (vertices (V, 3), faces (F, 3))
        mm, faces counter-clockwise seen from outside.
    rims : mapping of str to (n, 3) float64
        Of the openings that are contacts of their own, by full name.
    notes : tuple of str
    """

    meshes: Mapping[str, tuple[FloatArray, IntArray]]
    rims: Mapping[str, FloatArray]
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Sides:
    """A surface with curves among its edges.

    Attributes
    ----------
    vertices, faces
    shares : (V, R) float64
        How much of every region is at a vertex.
    away : (V, E) float64
        Distance along the surface from where the regions of each interface meet, mm, as far as a
        plane may lead a rim away from there.
    sides : list of (F,) int64
        For each curve so far, 1 on the side of the interface's first region, -1 on the other.
    """

    vertices: FloatArray
    faces: IntArray
    shares: FloatArray
    away: FloatArray
    sides: tuple[IntArray, ...] = ()


def parted_surface(
    solid: Solid, parts: Sequence[str], edge_mm: float, rim: Rim, cuts: Mapping[str, Cut]
) -> PartedSurface:
    """Return the meshes of the parts of a solid.

    Parameters
    ----------
    solid : Solid
    parts : sequence of str
        The first of its regions.
    edge_mm : float
        Edge length of the meshes.
    rim : {"plane", "curve"}
        Whether an interface is cut along the plane through its contact or where the regions meet.
    cuts : mapping of str to Cut
        Of interfaces that are stated otherwise, by name.

    Raises
    ------
    InputError
        If two regions meet in no closed curve.
    """
    vertices, faces, owner = _outline(solid)
    if genus(faces):
        raise TopologyError(f"expected a surface without handles, found genus {genus(faces)}")
    seen = np.unique(owner)
    for k, name in enumerate(solid.names):
        if k not in seen:
            raise InputError(
                f"expected {name} to have a surface of its own, found it inside the other labels "
                "of its component: parts of one component lie beside each other; take the seam "
                "away, or open it by [labels.openings]"
            )
    owner = _kept_apart(solid, vertices, faces, owner)
    shares = _shares(faces, owner, len(vertices), len(solid.names))
    away = np.zeros((len(vertices), 0))
    if rim == "plane":
        away = _away(solid, vertices, faces, shares)
    surface = _Sides(vertices, faces, shares, away)
    notes: list[str] = []
    for item in solid.interfaces:
        surface = _with_interface(surface, solid, item, rim, cuts.get(item.name), notes)
    region = _regions(surface, solid)
    loops = [_rim(surface.faces, side) for side in surface.sides]
    volume = enclosed_volume(surface.vertices, surface.faces)
    fine = isotropic_remeshed(
        surface.vertices, surface.faces, edge_mm=edge_mm, curves=loops, labels=region
    )
    positions = with_volume(fine.vertices, fine.faces, volume)
    rims = {
        item.ostium: positions[curve]
        for item, curve in zip(solid.interfaces, fine.curves, strict=True)
        if item.ostium is not None
    }
    meshes = {}
    for k, part in enumerate(parts):
        kept, own = without_unreferenced(fine.faces[fine.labels == k], len(positions))
        meshes[part] = (positions[kept], own)
    return PartedSurface(meshes, rims, tuple(notes))


def with_volume(vertices: FloatArray, faces: IntArray, volume: float) -> FloatArray:
    """Move a closed surface along its normals so that it encloses a volume; a small correction."""
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    at_vertices = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(at_vertices, faces[:, k], normals)
    at_vertices /= np.maximum(np.linalg.norm(at_vertices, axis=1, keepdims=True), 1e-300)
    area = 0.5 * float(np.linalg.norm(normals, axis=1).sum())
    moved: FloatArray = vertices + (volume - enclosed_volume(vertices, faces)) / area * at_vertices
    return moved


def _outline(solid: Solid) -> tuple[FloatArray, IntArray, IntArray]:
    """Return the surface of a solid, mm, and the region (V,) of every vertex."""
    grid = solid.grid
    values = solid_field(solid.distance)
    inside = grid.owner > 0
    least = _LEAST * grid.step
    values = np.where(inside, np.maximum(values, least), values)
    values = np.where(~inside, np.minimum(values, -least), values)
    vertices, faces = level_surface(LevelField(values, grid.affine))
    index = np.linalg.solve(grid.affine[:3, :3], (vertices - grid.affine[:3, 3]).T)
    # A vertex lies on an edge of the grid, one end of which is inside.
    low, high = (
        grid.owner[tuple(np.floor(index + shift).astype(np.int64))] for shift in (1e-6, 1 - 1e-6)
    )
    return vertices, faces, np.maximum(low, high) - 1


def _graph(vertices: FloatArray, faces: IntArray) -> csr_array:
    edges, _, _ = unique_edges(faces)
    lengths = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    rows, columns = np.concatenate([edges, edges[:, ::-1]]).T
    data = np.maximum(np.concatenate([lengths, lengths]), 1e-9)
    return coo_array((data, (rows, columns)), shape=(len(vertices),) * 2).tocsr()


def _kept_apart(solid: Solid, vertices: FloatArray, faces: IntArray, owner: IntArray) -> IntArray:
    """Return the regions with what lies between two of them widened.

    Where two regions come near each other without an interface, each leaves its border to its
    neighbour towards the other.
    """
    graph = _graph(vertices, faces)
    width = _APART_IN_STEPS * solid.grid.step
    steps = first_steps(solid)
    owner = owner.copy()
    given = owner.copy()
    joined = {frozenset((item.first, item.second)) for item in solid.interfaces}
    away = [
        dijkstra(
            graph, directed=False, indices=np.flatnonzero(owner == k), min_only=True, limit=width
        )
        for k in range(len(solid.names))
    ]
    for one, two in combinations(range(len(solid.names)), 2):
        if frozenset((one, two)) in joined:
            continue
        for own, other in ((one, two), (two, one)):
            given[(owner == own) & (away[other] < width)] = steps[own][other]
    return given


def _away(solid: Solid, vertices: FloatArray, faces: IntArray, shares: FloatArray) -> FloatArray:
    graph = _graph(vertices, faces)
    limit = _BAND_IN_SLICES * solid.grid.slice_mm + _APART_PLANES * solid.grid.step
    columns = []
    for item in solid.interfaces:
        above = shares[:, side_of(solid, item)].sum(axis=1)[faces] > 0.5
        ends = np.unique(faces[above.any(axis=1) & ~above.all(axis=1)])
        own = dijkstra(graph, directed=False, indices=ends, min_only=True, limit=limit)
        columns.append(np.minimum(own, limit))
    return np.stack(columns, axis=1) if columns else np.zeros((len(vertices), 0))


def _shares(faces: IntArray, owner: IntArray, n_vertices: int, n_regions: int) -> FloatArray:
    """Return the regions (V, R) smoothed along the surface; rows sum to one."""
    edges, _, _ = unique_edges(faces)
    rows, columns = np.concatenate([edges, edges[:, ::-1]]).T
    ones = coo_array((np.ones(len(rows)), (rows, columns)), shape=(n_vertices,) * 2).tocsr()
    mean = diags_array(1.0 / np.maximum(ones.sum(axis=1), 1.0)) @ ones
    shares = np.zeros((n_vertices, n_regions))
    shares[np.arange(n_vertices), owner] = 1.0
    for _ in range(_SMOOTHING_ROUNDS):
        shares = 0.5 * (shares + mean @ shares)
    return shares


def _with_interface(
    surface: _Sides,
    solid: Solid,
    item: Interface,
    rim: Rim,
    stated: Cut | None,
    notes: list[str],
) -> _Sides:
    """Return the surface with the curve of one more interface among its edges."""
    first = side_of(solid, item)
    height = surface.shares[:, first].sum(axis=1) - 0.5
    try:
        cut = parted_along(surface.vertices, surface.faces, height)
    except (InputError, TopologyError):
        one, two = solid.names[item.first], solid.names[item.second]
        raise InputError(
            f"expected the labels of {one} and {two} to meet in one closed curve for {item.name}, "
            "found none: check the labels where they meet"
        ) from None
    if stated is not None:
        heights = cut_heights(stated, surface.vertices)
        cut = parted_at(surface.vertices, surface.faces, heights, stated.center, stated.reach)
    elif rim == "plane":
        cut = _by_plane(surface, solid, item, cut, notes)
    return _carried(surface, cut, first)


def _by_plane(
    surface: _Sides, solid: Solid, item: Interface, curve: CutSurface, notes: list[str]
) -> CutSurface:
    """Return the cut along the robust plane through a curve.

    Where the plane leaves the neighbourhood of the curve, or comes near a third region, the curve
    stays.
    """
    rim = _rim(curve.faces, curve.side)
    points = curve.vertices[rim]
    center, normal = _robust_plane(points)
    band = _BAND_IN_SLICES * solid.grid.slice_mm
    number = solid.interfaces.index(item)
    away = surface.away[:, number]
    others = np.delete(surface.away, number, axis=1).min(axis=1, initial=np.inf)
    near = (away < band) & (away + _APART_PLANES * solid.grid.step < others)
    sign = np.ones(len(curve.vertices))
    sign[curve.faces[curve.side < 0]] = -1.0
    sign = sign[: len(surface.vertices)]
    height = (surface.vertices - center) @ normal
    if float((height[near] * sign[near]).sum()) < 0.0:
        height, normal = -height, -normal
    cut = parted_along(surface.vertices, surface.faces, np.where(near, height, band * sign))
    off = np.abs((cut.vertices[_rim(cut.faces, cut.side)] - center) @ normal)
    cosine = abs(float(normal @ solid.grid.slice_normal))
    notes.append(
        f"{item.name}: rim in the plane through the contact, "
        f"{np.degrees(np.arccos(min(cosine, 1.0))):.0f} degrees to the slices, "
        f"{100.0 * float((off < 0.1 * solid.grid.step).mean()):.0f} % of it"
    )
    return cut


def _robust_plane(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the centre and normal of the least-squares plane, far points left out in turn."""
    kept = np.ones(len(points), dtype=np.bool_)
    for _ in range(5):
        center = points[kept].mean(axis=0)
        normal = np.linalg.svd(points[kept] - center, full_matrices=False)[2][2]
        away = np.abs((points - center) @ normal)
        kept = away <= _TRIMMED * max(float(np.median(away)), 1e-9)
    return center, normal


def _carried(surface: _Sides, cut: CutSurface, first: Sequence[int]) -> _Sides:
    """Return the cut surface with the shares of regions and the sides of earlier curves."""
    known = np.hstack([surface.shares, surface.away])
    n_old, n_regions = len(surface.vertices), surface.shares.shape[1]
    values = np.vstack([known, np.zeros((len(cut.vertices) - n_old, known.shape[1]))])
    new = np.flatnonzero((cut.faces >= n_old).any(axis=1))
    for corner in range(3):
        rows = new[cut.faces[new, corner] >= n_old]
        parents = surface.faces[cut.source[rows]]  # (n, 3)
        weight = _barycentric(surface.vertices[parents], cut.vertices[cut.faces[rows, corner]])
        values[cut.faces[rows, corner]] = np.einsum("nc,ncr->nr", weight, known[parents])
    shares, away = values[:, :n_regions], values[:, n_regions:]
    area = face_areas(cut.vertices, cut.faces)
    belongs = shares[cut.faces].mean(axis=1)[:, list(first)].sum(axis=1) - 0.5
    same = float((area * cut.side * np.sign(belongs)).sum()) >= 0.0
    side = cut.side if same else -cut.side
    earlier = tuple(own[cut.source] for own in surface.sides)
    return _Sides(cut.vertices, cut.faces, shares, away, (*earlier, side))


def _barycentric(corners: FloatArray, points: FloatArray) -> FloatArray:
    """Return the weights (n, 3) of corners (n, 3, 3) at points (n, 3) in their planes."""
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    w = points - corners[:, 0]
    uu, vv, uv = (np.einsum("ni,ni->n", a, b) for a, b in ((u, u), (v, v), (u, v)))
    uw, vw = (np.einsum("ni,ni->n", a, w) for a in (u, v))
    det = np.maximum(uu * vv - uv * uv, 1e-300)
    second, third = (vv * uw - uv * vw) / det, (uu * vw - uv * uw) / det
    weights = np.clip(np.stack([1.0 - second - third, second, third], axis=1), 0.0, None)
    result: FloatArray = weights / weights.sum(axis=1, keepdims=True)
    return result


def _regions(surface: _Sides, solid: Solid) -> IntArray:
    """Return the region (F,) of every face: what lies on its side of all curves."""
    region = np.zeros(len(surface.faces), dtype=np.int64)
    firsts = [side_of(solid, item) for item in solid.interfaces]
    for k in range(len(solid.names)):
        inside = np.ones(len(surface.faces), dtype=np.bool_)
        for first, side in zip(firsts, surface.sides, strict=True):
            inside &= side == (1 if k in first else -1)
        region[inside] = k
    return region


def _rim(faces: IntArray, side: IntArray) -> IntArray:
    """Return the curve (n,) between the two sides of a surface, the first on its left."""
    own = faces[side > 0]
    start, end = own.reshape(-1), np.roll(own, -1, axis=1).reshape(-1)
    other = faces[side < 0]
    pairs = {
        (a, b)
        for a, b in zip(
            np.roll(other, -1, axis=1).reshape(-1).tolist(), other.reshape(-1).tolist(), strict=True
        )
    }
    after = {a: b for a, b in zip(start.tolist(), end.tolist(), strict=True) if (a, b) in pairs}
    loop = [min(after)]
    while (following := after[loop[-1]]) != loop[0]:
        loop.append(following)
    return np.array(loop, dtype=np.int64)
