"""Splitting and collapsing of edges, compiled (Botsch & Kobbelt 2004).

The kernels change the arrays they are given, which `ostiform.surface.remesh` owns.
"""

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.compiled import kernel
from ostiform.surface.remesh_mesh import (
    MAX_RING,
    Curves,
    Mesh,
    arc_step,
    curve_position,
    following,
    neighbours,
    origin,
    pair,
    preceding,
    squared_distance,
    turns_little,
)

LONGEST_AFTER_COLLAPSE = 4.0 / 3.0
"""Of the target edge length: a collapse may not create an edge that would be split again."""


@kernel
def split_edges(mesh: Mesh, curves: Curves, chosen: IntArray, ends: IntArray) -> int:
    """Split half-edges at their middle (on their curve for a feature); return how many.

    Parameters
    ----------
    mesh, curves
        The mesh needs room for as many vertices and twice as many faces as edges are chosen.
    chosen : (n,) int64
        Half-edges.
    ends : (n, 2) int64
        Their vertices; an edge that an earlier split has changed is left.
    """
    done = 0
    for i in range(len(chosen)):
        h = chosen[i]
        if origin(mesh.faces, h) == ends[i, 0] and origin(mesh.faces, following(h)) == ends[i, 1]:
            _split(mesh, curves, h)
            done += 1
    return done


@kernel
def _split(mesh: Mesh, curves: Curves, h: int) -> None:
    faces, twins, feature = mesh.faces, mesh.twins, mesh.feature
    f, hn, t = h // 3, following(h), twins[h]
    a, b, c = origin(faces, h), origin(faces, hn), origin(faces, preceding(h))
    m, g = mesh.counts[0], mesh.counts[1]
    mesh.counts[0] += 1
    mesh.counts[1] += 1
    k = feature[h]
    mesh.curve[m] = k
    mesh.target[m] = 0.5 * (mesh.target[a] + mesh.target[b])
    if k >= 0:
        step = arc_step(curves, k, mesh.along[a], mesh.along[b])
        mesh.positions[m], mesh.along[m] = curve_position(curves, k, mesh.along[a] + 0.5 * step)
        mesh.on_curve[k] += 1
    else:
        mesh.positions[m] = 0.5 * (mesh.positions[a] + mesh.positions[b])
    faces[f, hn % 3] = m  # (a, b, c) -> (a, m, c) and (m, b, c)
    faces[g, 0], faces[g, 1], faces[g, 2] = m, b, c
    mesh.label[g] = mesh.label[f]
    pair(mesh, 3 * g + 1, twins[hn], feature[hn])
    pair(mesh, hn, 3 * g + 2, -1)
    feature[3 * g] = k
    twins[3 * g] = -1
    mesh.out[m] = 3 * g
    mesh.out[b] = 3 * g + 1
    if t < 0:
        return
    g2 = mesh.counts[1]
    mesh.counts[1] += 1
    f2, tp = t // 3, preceding(t)
    d = origin(faces, tp)
    faces[f2, t % 3] = m  # (b, a, d) -> (m, a, d) and (b, m, d)
    faces[g2, 0], faces[g2, 1], faces[g2, 2] = b, m, d
    mesh.label[g2] = mesh.label[f2]
    pair(mesh, 3 * g2 + 2, twins[tp], feature[tp])
    pair(mesh, tp, 3 * g2 + 1, -1)
    pair(mesh, 3 * g, 3 * g2, k)


@kernel
def collapse_edges(
    mesh: Mesh,
    curves: Curves,
    chosen: IntArray,
    shortest: float,
    fewest_on_curve: int,
    at_most: int,
    move_curves: bool,
) -> int:
    """Collapse half-edges that are still shorter than a multiple of their target; return how many.

    A collapse is refused where it would change the topology, join two curve vertices by an inner
    edge, turn a triangle over, make a sliver, or make an edge that is too long.

    Parameters
    ----------
    mesh, curves
    chosen : (n,) int64
        Half-edges, in the order to try.
    shortest : float
        Edges below this multiple of the target length are collapsed.
    fewest_on_curve : int
        No curve keeps fewer vertices.
    at_most : int
        Stop after this many.
    move_curves : bool
        Whether edges of curves may be collapsed.
    """
    ring_v, ring_w = np.empty(MAX_RING, np.int64), np.empty(MAX_RING, np.int64)
    near_v, near_w = np.empty(MAX_RING + 1, np.int64), np.empty(MAX_RING + 1, np.int64)
    done = 0
    for i in range(len(chosen)):
        if done >= at_most:
            break
        h = chosen[i]
        if mesh.faces[h // 3, 0] < 0:
            continue
        v, w = origin(mesh.faces, h), origin(mesh.faces, following(h))
        wanted = shortest * 0.5 * (mesh.target[v] + mesh.target[w])
        if squared_distance(mesh.positions[v], mesh.positions[w]) >= wanted**2:
            continue
        on_curve = mesh.feature[h]
        if mesh.curve[v] >= 0 and mesh.curve[w] >= 0:
            if on_curve < 0 or not move_curves or mesh.on_curve[on_curve] <= fewest_on_curve:
                continue
        elif mesh.curve[v] >= 0:
            h = mesh.twins[h]
            v, w = w, v
        if _collapse(mesh, curves, h, ring_v, ring_w, near_v, near_w):
            done += 1
    return done


@kernel
def _collapse(
    mesh: Mesh,
    curves: Curves,
    h: int,
    ring_v: IntArray,
    ring_w: IntArray,
    near_v: IntArray,
    near_w: IntArray,
) -> bool:
    # Merges the origin v of h into its end w.
    faces, twins, feature = mesh.faces, mesh.twins, mesh.feature
    t = twins[h]
    v, w, c = origin(faces, h), origin(faces, following(h)), origin(faces, preceding(h))
    d = origin(faces, preceding(t)) if t >= 0 else -1
    for apex in (c, d):  # a vertex with three neighbours would be left with two
        if apex >= 0:
            n_near, n_faces = neighbours(mesh, apex, ring_v, near_v)
            if n_near < 0 or n_near <= (3 if n_near == n_faces else 2):
                return False
    n_w, f_w = neighbours(mesh, w, ring_w, near_w)
    n_v, f_v = neighbours(mesh, v, ring_v, near_v)
    if n_v < 0 or n_w < 0 or n_v + n_w > MAX_RING:
        return False
    common = 0
    for i in range(n_v):
        u = near_v[i]
        for j in range(n_w):
            common += u == near_w[j]
        if mesh.curve[w] >= 0 and mesh.curve[v] < 0 and mesh.curve[u] >= 0:
            if u != w and u != c and u != d:
                return False
    if common != (2 if t >= 0 else 1):
        return False
    if feature[following(h)] >= 0 and feature[preceding(h)] >= 0:
        return False
    if t >= 0 and feature[following(t)] >= 0 and feature[preceding(t)] >= 0:
        return False
    if twins[following(h)] < 0 and twins[preceding(h)] < 0:
        return False
    if t >= 0 and twins[following(t)] < 0 and twins[preceding(t)] < 0:
        return False
    k = feature[h]
    along = mesh.along[w]
    if k >= 0:
        step = arc_step(curves, k, mesh.along[v], mesh.along[w])
        position, along = curve_position(curves, k, mesh.along[v] + 0.5 * step)
    elif mesh.curve[w] >= 0:
        position = mesh.positions[w].copy()
    else:
        position = 0.5 * (mesh.positions[v] + mesh.positions[w])
    target = 0.5 * (mesh.target[v] + mesh.target[w])
    if not _fits(mesh, v, w, ring_v, f_v, position, target):
        return False
    if not _fits(mesh, w, v, ring_w, f_w, position, target):
        return False
    for i in range(f_v):
        faces[ring_v[i] // 3, ring_v[i] % 3] = w
    _close_gap(mesh, h, w, c)
    if t >= 0:
        _close_gap(mesh, t, w, d)
    mesh.positions[w] = position
    mesh.along[w] = along
    mesh.target[w] = target
    mesh.out[v] = -1
    if k >= 0:
        mesh.on_curve[k] -= 1
    return True


@kernel
def _close_gap(mesh: Mesh, h: int, w: int, apex: int) -> None:
    # Removes the face of h, whose other two sides have become one edge between w and the apex.
    one, two = following(h), preceding(h)
    k = max(mesh.feature[one], mesh.feature[two])
    outer_one, outer_two = mesh.twins[one], mesh.twins[two]
    mesh.faces[h // 3, 0] = -1
    for outer, other in ((outer_one, outer_two), (outer_two, outer_one)):
        if outer >= 0:
            pair(mesh, outer, other, k)
            for side in (outer, following(outer)):
                if origin(mesh.faces, side) == w:
                    mesh.out[w] = side
                elif origin(mesh.faces, side) == apex:
                    mesh.out[apex] = side


@kernel
def _fits(
    mesh: Mesh, v: int, other: int, ring: IntArray, n: int, position: FloatArray, target: float
) -> bool:
    # Whether the faces at v that do not touch `other` stay sound when v moves to `position`.
    for i in range(n):
        h = ring[i]
        a, b = origin(mesh.faces, following(h)), origin(mesh.faces, preceding(h))
        for u in (a, b):
            if u != other:
                longest = LONGEST_AFTER_COLLAPSE * 0.5 * (mesh.target[u] + target)
                new = squared_distance(mesh.positions[u], position)
                old = squared_distance(mesh.positions[u], mesh.positions[v])
                if new > longest**2 and new > old:
                    return False
        if a != other and b != other and not turns_little(mesh, v, a, b, position, True):
            return False
    return True
