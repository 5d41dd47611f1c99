"""Isotropic remeshing that keeps rims and seams (Botsch & Kobbelt 2004).

Edges are split above 4/3 and collapsed below 4/5 of the wanted length, flipped towards even
valences, and vertices move tangentially and back onto the input surface. Vertices of a curve move
only along its input polyline. The result has no inner edge that joins two curve vertices and so
no triangle with three of them: what the embedding asks of a mesh (design 3, step 1).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from ostiform.arrays import BoolArray, FloatArray, IntArray
from ostiform.errors import ConvergenceError, InputError
from ostiform.surface.halfedges import twin_half_edges
from ostiform.surface.queries import SurfaceTree, closest_points, surface_tree
from ostiform.surface.remesh_kernels import collapse_edges, split_edges
from ostiform.surface.remesh_mesh import Curves, Grid, closed, opened
from ostiform.surface.remesh_smoothing import flip_edges, relax
from ostiform.surface.topology import boundary_loops, half_edges
from ostiform.values import AtLeast, value

LONG = 4.0 / 3.0
SHORT = 4.0 / 5.0
SPLIT_ROUNDS = 12
"""Each round halves what is too long: enough for edges 4,000 times the wanted length."""
COUNT_TOLERANCE = 0.01
COUNT_ROUNDS = 8
SETTLING_ROUNDS = 3


@value(eq=True)
class RemeshRules:
    """What a remeshing may do.

    Attributes
    ----------
    move_curves : bool
        Whether vertices of curves may be added, removed and slid along them.
    fewest_on_curve : int
        No curve is left with fewer vertices.
    iterations : int
        Rounds of splitting, collapsing, flipping and smoothing.
    """

    move_curves: bool = True
    fewest_on_curve: Annotated[int, AtLeast(3)] = 8
    iterations: Annotated[int, AtLeast(1)] = 10


@dataclass(frozen=True, slots=True, eq=False)
class RemeshedSurface:
    """A surface with new, nearly equilateral triangles.

    Attributes
    ----------
    vertices : (V, 3) float64, mm
    faces : (F, 3) int64
    labels : (F,) int64
        Label of the input face each triangle lies on.
    curves : tuple of (n,) int64
        The given curves, each with its new vertices in the old direction, starting at the vertex
        nearest along the curve to where the old one started.
    rims : tuple of (n,) int64
        The boundary loops that were not given, in the order of `boundary_loops`.
    """

    vertices: FloatArray
    faces: IntArray
    labels: IntArray
    curves: tuple[IntArray, ...]
    rims: tuple[IntArray, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Job:
    # What stays the same over a run: the input surface, its curves and the rules.
    tree: SurfaceTree
    sizing: FloatArray
    curves: Curves
    rules: RemeshRules


def isotropic_remeshed(
    vertices: FloatArray,
    faces: IntArray,
    *,
    edge_mm: float | None = None,
    n_vertices: int | None = None,
    curves: Sequence[IntArray] = (),
    labels: IntArray | None = None,
    sizing: FloatArray | None = None,
    rules: RemeshRules | None = None,
) -> RemeshedSurface:
    """Return a surface remeshed with nearly equilateral triangles of one or of graded size.

    Parameters
    ----------
    vertices : (V, 3) float64, mm
    faces : (F, 3) int64
        Consistently oriented manifold.
    edge_mm : float, optional
        Wanted edge length. Exactly one of this and `n_vertices` is given.
    n_vertices : int, optional
        Wanted number of vertices, reached to within 2 %.
    curves : sequence of (n,) int64
        Closed curves along edges to keep (rims, seams, borders between labels), disjoint.
        Boundary loops are kept whether given or not.
    labels : (F,) int64, optional
        A label per face; borders between labels must be among the curves. Zero if absent.
    sizing : (V,) float64, optional
        Relative edge length at the vertices, times `edge_mm`. One if absent.
    rules : RemeshRules, optional

    Returns
    -------
    RemeshedSurface

    Raises
    ------
    InputError
        If the wanted size, a curve, the labels or the sizes are not usable.
    TopologyError
        If the surface is not a consistently oriented manifold.
    ConvergenceError
        If the number of vertices is not reached (far too few for the curves).
    """
    if (edge_mm is None) == (n_vertices is None):
        raise InputError("remeshing: expected either an edge length or a number of vertices")
    if edge_mm is not None and not edge_mm > 0:
        raise InputError(f"remeshing: expected a positive edge length, found {edge_mm} mm")
    if n_vertices is not None and n_vertices < 4:
        raise InputError(f"remeshing: expected at least 4 vertices, found {n_vertices}")
    relative = np.ones(len(vertices)) if sizing is None else np.asarray(sizing, dtype=np.float64)
    if relative.shape != (len(vertices),) or not (relative > 0).all():
        raise InputError("remeshing: expected one positive size per vertex, found others")
    rims = boundary_loops(faces)
    kept = _all_curves(curves, rims)
    grid, polylines = _prepared(vertices, faces, labels, relative, kept)
    rules = RemeshRules() if rules is None else rules
    job = _Job(surface_tree(vertices, faces), relative, polylines, rules)
    if edge_mm is not None:
        grid = _remeshed(_scaled(grid, edge_mm), job, edge_mm, rules.iterations)
    else:
        grid = _with_count(grid, job, n_vertices or 0, rules.iterations)
    loops = [_ordered_curve(grid, index, polylines) for index in range(len(kept))]
    return RemeshedSurface(
        vertices=grid.vertices,
        faces=grid.faces,
        labels=grid.labels,
        curves=tuple(loops[: len(curves)]),
        rims=tuple(loops[len(curves) :]),
    )


def _all_curves(curves: Sequence[IntArray], rims: Sequence[IntArray]) -> list[IntArray]:
    given = [np.asarray(curve, dtype=np.int64) for curve in curves]
    known = {frozenset(curve.tolist()) for curve in given}
    return given + [rim for rim in rims if frozenset(rim.tolist()) not in known]


def _prepared(
    vertices: FloatArray,
    faces: IntArray,
    labels: IntArray | None,
    relative: FloatArray,
    curves: Sequence[IntArray],
) -> tuple[Grid, Curves]:
    face_labels = np.zeros(len(faces), dtype=np.int64) if labels is None else np.asarray(labels)
    if face_labels.shape != (len(faces),):
        raise InputError(
            f"labels: expected one per face, shape ({len(faces)},), found {face_labels.shape}"
        )
    curve = np.full(len(vertices), -1, dtype=np.int64)
    along = np.zeros(len(vertices))
    directed = half_edges(faces)
    span = len(vertices)
    keys = directed.min(axis=1) * span + directed.max(axis=1)
    feature = np.full(len(keys), -1, dtype=np.int64)
    start, points, arcs = [0], [np.zeros((0, 3))], [np.zeros(0)]
    for index, loop in enumerate(curves):
        if len(loop) < 3 or (curve[loop] >= 0).any() or len(np.unique(loop)) < len(loop):
            raise InputError(
                f"curves: expected disjoint closed curves of at least 3 vertices, found curve "
                f"{index} with {len(loop)} vertices that crosses itself or another"
            )
        following = np.roll(loop, -1)
        edges = np.minimum(loop, following) * span + np.maximum(loop, following)
        if not np.isin(edges, keys).all():
            raise InputError(
                f"curves: expected curves along edges of the surface, found curve {index} with "
                f"{int((~np.isin(edges, keys)).sum())} steps that are not edges"
            )
        closed = np.concatenate([vertices[loop], vertices[loop[:1]]])
        lengths = np.linalg.norm(np.diff(closed, axis=0), axis=1)
        if not (lengths > 0).all():
            raise InputError(
                "curves: expected edges longer than zero, found one of length zero on curve "
                f"{index}"
            )
        arc = np.concatenate([[0.0], np.cumsum(lengths)])
        curve[loop], along[loop] = index, arc[:-1]
        feature[np.isin(keys, edges)] = index
        start.append(start[-1] + len(arc))
        points.append(closed)
        arcs.append(arc)
    twins = twin_half_edges(faces, len(vertices))
    inner = twins >= 0
    owner = np.arange(len(twins)) // 3
    border = inner & (face_labels[owner] != face_labels[np.maximum(twins, 0) // 3])
    if (border & (feature < 0)).any():
        raise InputError(
            f"labels: expected every border between labels to be among the curves, found "
            f"{int((border & (feature < 0)).sum()) // 2} border edges that are not"
        )
    grid = Grid(
        vertices=np.array(vertices, dtype=np.float64),
        faces=np.array(faces, dtype=np.int64),
        labels=face_labels.astype(np.int64),
        target=relative.copy(),
        curve=curve,
        along=along,
        feature=feature,
    )
    polylines = Curves(
        np.array(start, dtype=np.int64), np.concatenate(points), np.concatenate(arcs)
    )
    return grid, polylines


def _scaled(grid: Grid, factor: float) -> Grid:
    return replace(grid, target=grid.target * factor)


def _with_count(grid: Grid, job: _Job, n_vertices: int, iterations: int) -> Grid:
    corners = job.tree.vertices[job.tree.faces]
    areas = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    # An equilateral mesh of edge h has 2 / (sqrt(3) h^2) vertices per area.
    wanted = (areas / job.sizing[job.tree.faces].mean(axis=1) ** 2).sum() * 2.0 / np.sqrt(3.0)
    edge = float(np.sqrt(wanted / n_vertices))
    grid = _remeshed(_scaled(grid, edge), job, edge, iterations)
    for _ in range(COUNT_ROUNDS):
        missing = n_vertices - len(grid.vertices)
        if abs(missing) <= COUNT_TOLERANCE * n_vertices:
            return grid
        factor = float(np.sqrt(len(grid.vertices) / n_vertices))
        edge *= factor
        grid = _scaled(grid, factor)
        if missing > 0:
            lengths, wanted = _edge_lengths(grid)
            may = np.ones(len(lengths), dtype=np.bool_)
            if not job.rules.move_curves:
                may = grid.feature < 0
            grid = _split_round(grid, job, may & (lengths > wanted), missing)
        else:
            grid = _collapse_round(grid, job, 1.0, -missing)
        for _ in range(SETTLING_ROUNDS):
            grid = _smooth_round(grid, job, edge, by_angle=True)
    if abs(len(grid.vertices) / n_vertices - 1.0) > 2.0 * COUNT_TOLERANCE:
        raise ConvergenceError(
            f"remeshing: expected {n_vertices} vertices to within 2 %, found {len(grid.vertices)} "
            f"after {COUNT_ROUNDS} rounds: ask for more vertices or fewer on each curve"
        )
    return grid


def _remeshed(grid: Grid, job: _Job, edge: float, iterations: int) -> Grid:
    grid = _split_round(grid, job, _joins_curves(grid))
    for iteration in range(iterations):
        for _ in range(SPLIT_ROUNDS):
            lengths, wanted = _edge_lengths(grid)
            long = lengths > LONG * wanted
            if not job.rules.move_curves:
                long &= grid.feature < 0
            if not long.any():
                break
            grid = _split_round(grid, job, long)
        grid = _collapse_round(grid, job)
        grid = _smooth_round(grid, job, edge, by_angle=iteration >= iterations - 2)
    return grid


def _edge_lengths(grid: Grid) -> tuple[FloatArray, FloatArray]:
    directed = half_edges(grid.faces)  # (3F, 2)
    lengths = np.linalg.norm(grid.vertices[directed[:, 1]] - grid.vertices[directed[:, 0]], axis=1)
    return lengths, grid.target[directed].mean(axis=1)


def _joins_curves(grid: Grid) -> BoolArray:
    joins: BoolArray = (grid.curve[half_edges(grid.faces)] >= 0).all(axis=1) & (grid.feature < 0)
    return joins


def _split_round(grid: Grid, job: _Job, wanted: BoolArray, at_most: int | None = None) -> Grid:
    if not wanted.any():
        return grid
    directed = half_edges(grid.faces)
    twins = twin_half_edges(grid.faces, len(grid.vertices))
    once = wanted & ((twins < 0) | (directed[:, 0] < directed[:, 1]))
    lengths, target = _edge_lengths(grid)
    chosen = np.flatnonzero(once)
    chosen = chosen[np.argsort(-(lengths / target)[chosen], kind="stable")][:at_most]
    mesh = opened(grid, len(chosen), twins, len(job.curves.start) - 1)
    split_edges(mesh, job.curves, chosen, np.ascontiguousarray(directed[chosen]))
    return closed(mesh)


def _collapse_round(
    grid: Grid, job: _Job, shortest: float = SHORT, at_most: int | None = None
) -> Grid:
    lengths, wanted = _edge_lengths(grid)
    directed = half_edges(grid.faces)
    twins = twin_half_edges(grid.faces, len(grid.vertices))
    once = (twins < 0) | (directed[:, 0] < directed[:, 1])
    chosen = np.flatnonzero(once & (lengths < shortest * wanted))
    chosen = chosen[np.argsort((lengths / wanted)[chosen], kind="stable")]
    mesh = opened(grid, 0, twins, len(job.curves.start) - 1)
    collapse_edges(
        mesh,
        job.curves,
        chosen,
        shortest,
        job.rules.fewest_on_curve,
        len(chosen) if at_most is None else at_most,
        job.rules.move_curves,
    )
    return closed(mesh)


def _smooth_round(grid: Grid, job: _Job, edge: float, by_angle: bool) -> Grid:
    twins = twin_half_edges(grid.faces, len(grid.vertices))
    mesh = opened(grid, 0, twins, len(job.curves.start) - 1)
    flip_edges(mesh, False)
    for _ in range(2):
        relax(mesh, job.curves, 0.7, job.rules.move_curves)
    if by_angle:
        flip_edges(mesh, True)
    moved = closed(mesh)
    free = moved.curve < 0
    closest = closest_points(job.tree, moved.vertices)
    vertices = np.where(free[:, None], closest.points, moved.vertices)
    corners = job.tree.faces[closest.faces]
    target = edge * np.einsum("nk,nk->n", closest.barycentric, job.sizing[corners])
    return replace(moved, vertices=vertices, target=target)


def _ordered_curve(grid: Grid, index: int, polylines: Curves) -> IntArray:
    on_curve = np.flatnonzero(grid.curve == index)
    length = polylines.arcs[polylines.start[index + 1] - 1]
    # The vertex nearest to the old start may lie a little before it.
    along = grid.along[on_curve]
    along = np.where(along > 0.5 * length, along - length, along)
    order = np.argsort(along)
    first = int(np.argmin(np.abs(along[order])))
    loop: IntArray = np.roll(on_curve[order], -first)
    return loop
