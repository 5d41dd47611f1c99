"""Flipping of edges and tangential smoothing, compiled (Botsch & Kobbelt 2004).

The kernels change the arrays they are given, which `ostiform.surface.remesh` owns.
"""

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.compiled import kernel
from ostiform.surface.remesh_mesh import (
    MAX_RING,
    SAME_SIDE,
    Curves,
    Mesh,
    arc_step,
    area_vector,
    curve_position,
    following,
    half_edge_ring,
    neighbours,
    origin,
    pair,
    preceding,
    squared_distance,
    turns_little,
)


@kernel
def flip_edges(mesh: Mesh, by_angle: bool) -> int:
    """Flip inner edges to even out valences, or to widen the smallest angle; return how many.

    Never flips a feature, joins two curve vertices, doubles an edge or folds the surface.
    """
    valence = np.zeros(mesh.counts[0], np.int64)
    ideal = np.full(mesh.counts[0], 6, np.int64)
    for f in range(mesh.counts[1]):
        for k in range(3):
            valence[mesh.faces[f, k]] += 1
            if mesh.twins[3 * f + k] < 0:  # a boundary vertex has one neighbour more than faces
                valence[mesh.faces[f, k]] += 1
                ideal[mesh.faces[f, k]] = 4
    ring, near = np.empty(MAX_RING, np.int64), np.empty(MAX_RING + 1, np.int64)
    done = 0
    for h in range(3 * mesh.counts[1]):
        t = mesh.twins[h]
        if t < h or mesh.feature[h] >= 0:
            continue
        a, b = origin(mesh.faces, h), origin(mesh.faces, t)
        c, d = origin(mesh.faces, preceding(h)), origin(mesh.faces, preceding(t))
        if mesh.curve[c] >= 0 and mesh.curve[d] >= 0:
            continue
        if valence[a] <= ideal[a] // 2 or valence[b] <= ideal[b] // 2:
            continue
        before, after = 0, 0
        for u, gain in ((a, -1), (b, -1), (c, 1), (d, 1)):
            before += (valence[u] - ideal[u]) ** 2
            after += (valence[u] + gain - ideal[u]) ** 2
        if not by_angle and after >= before:
            continue
        if not _flip_is_sound(mesh, a, b, c, d, by_angle):
            continue
        n, _ = neighbours(mesh, c, ring, near)
        doubled = n < 0
        for i in range(n):
            doubled = doubled or near[i] == d
        if doubled:
            continue
        _flip(mesh, h, t)
        valence[a] -= 1
        valence[b] -= 1
        valence[c] += 1
        valence[d] += 1
        done += 1
    return done


@kernel
def _largest_cosine(a: FloatArray, b: FloatArray, c: FloatArray) -> float:
    # Cosine of the smallest angle of a triangle.
    la, lb, lc = squared_distance(b, c), squared_distance(c, a), squared_distance(a, b)
    if la <= 0.0 or lb <= 0.0 or lc <= 0.0:
        return 1.0
    one = (lb + lc - la) / np.sqrt(4.0 * lb * lc)
    two = (lc + la - lb) / np.sqrt(4.0 * lc * la)
    three = (la + lb - lc) / np.sqrt(4.0 * la * lb)
    return float(max(one, max(two, three)))


@kernel
def _flip_is_sound(mesh: Mesh, a: int, b: int, c: int, d: int, by_angle: bool) -> bool:
    pa, pb, pc, pd = mesh.positions[a], mesh.positions[b], mesh.positions[c], mesh.positions[d]
    old = max(_largest_cosine(pa, pb, pc), _largest_cosine(pb, pa, pd))
    new = max(_largest_cosine(pa, pd, pc), _largest_cosine(pd, pb, pc))
    if by_angle:
        if new >= old - 1e-6:
            return False
    elif new > old and new > 0.9:  # below 26 degrees only if it improves
        return False
    n1, n2 = np.array(area_vector(pa, pb, pc)), np.array(area_vector(pb, pa, pd))
    m1, m2 = np.array(area_vector(pa, pd, pc)), np.array(area_vector(pd, pb, pc))
    whole = n1 + n2
    size = np.sqrt((whole * whole).sum())
    l1, l2 = np.sqrt((m1 * m1).sum()), np.sqrt((m2 * m2).sum())
    if (m1 * whole).sum() <= SAME_SIDE * l1 * size or (m2 * whole).sum() <= SAME_SIDE * l2 * size:
        return False
    k1, k2 = np.sqrt((n1 * n1).sum()), np.sqrt((n2 * n2).sum())
    crease = (n1 * n2).sum() / max(k1 * k2, 1e-300)
    return bool((m1 * m2).sum() / max(l1 * l2, 1e-300) >= min(crease, 0.7))


@kernel
def _flip(mesh: Mesh, h: int, t: int) -> None:
    # (a, b, c) and (b, a, d) -> (d, c, a) and (c, d, b).
    faces, twins, feature = mesh.faces, mesh.twins, mesh.feature
    hn, hp, tn, tp = following(h), preceding(h), following(t), preceding(t)
    a, b, c, d = origin(faces, h), origin(faces, t), origin(faces, hp), origin(faces, tp)
    bc, ca, ad, db = twins[hn], twins[hp], twins[tn], twins[tp]
    k_bc, k_ca, k_ad, k_db = feature[hn], feature[hp], feature[tn], feature[tp]
    faces[h // 3, h % 3], faces[h // 3, hn % 3], faces[h // 3, hp % 3] = d, c, a
    faces[t // 3, t % 3], faces[t // 3, tn % 3], faces[t // 3, tp % 3] = c, d, b
    pair(mesh, hn, ca, k_ca)
    pair(mesh, hp, ad, k_ad)
    pair(mesh, tn, db, k_db)
    pair(mesh, tp, bc, k_bc)
    pair(mesh, h, t, -1)
    mesh.out[a], mesh.out[b], mesh.out[c], mesh.out[d] = hp, tp, hn, h


@kernel
def relax(mesh: Mesh, curves: Curves, damping: float, move_curves: bool) -> None:
    """Move vertices tangentially to the centroid of their faces, and along their curve.

    Faces count by area over target edge length to the fourth, which grades the mesh; a move that
    would turn a face by more than 60 degrees is shortened, then given up.
    """
    ring = np.empty(MAX_RING, np.int64)
    for v in range(mesh.counts[0]):
        n, _ = half_edge_ring(mesh, v, ring)
        k = mesh.curve[v]
        if n < 0 or (k >= 0 and not move_curves):
            continue
        here = mesh.positions[v].copy()
        if k >= 0:
            shift = 0.5 * damping * _arc_imbalance(mesh, curves, v, k, ring, n)
        else:
            move = _tangential_move(mesh, v, ring, n)
        for halving in range(3):
            scale = 0.5**halving
            if k >= 0:
                position, along = curve_position(curves, k, mesh.along[v] + scale * shift)
            else:
                position = here + (scale * damping) * move
            sound = True
            for i in range(n):
                a, b = (
                    origin(mesh.faces, following(ring[i])),
                    origin(mesh.faces, preceding(ring[i])),
                )
                if not turns_little(mesh, v, a, b, position, False):
                    sound = False
                    break
            if sound:
                mesh.positions[v] = position
                if k >= 0:
                    mesh.along[v] = along
                break


@kernel
def _arc_imbalance(mesh: Mesh, curves: Curves, v: int, k: int, ring: IntArray, n: int) -> float:
    # Sum of the signed arc lengths to the two neighbours on the curve: zero midway.
    total = 0.0
    for i in range(n):
        if mesh.feature[ring[i]] == k:
            u = origin(mesh.faces, following(ring[i]))
            total += arc_step(curves, k, mesh.along[v], mesh.along[u])
        incoming = preceding(ring[i])
        if mesh.twins[incoming] < 0 and mesh.feature[incoming] == k:
            u = origin(mesh.faces, incoming)
            total += arc_step(curves, k, mesh.along[v], mesh.along[u])
    return total


@kernel
def _tangential_move(mesh: Mesh, v: int, ring: IntArray, n: int) -> FloatArray:
    centre, normal = np.zeros(3), np.zeros(3)
    total = 0.0
    p = mesh.positions[v]
    for i in range(n):
        a, b = origin(mesh.faces, following(ring[i])), origin(mesh.faces, preceding(ring[i]))
        x, y, z = area_vector(p, mesh.positions[a], mesh.positions[b])
        size = (mesh.target[v] + mesh.target[a] + mesh.target[b]) / (3.0 * mesh.target[v])
        weight = np.sqrt(x * x + y * y + z * z) / size**4
        normal[0] += x
        normal[1] += y
        normal[2] += z
        total += weight
        for d in range(3):
            centre[d] += weight * (mesh.positions[a, d] + mesh.positions[b, d] - 2.0 * p[d]) / 3.0
    length = np.sqrt((normal * normal).sum())
    if total <= 0.0 or length <= 0.0:
        return np.zeros(3)
    centre /= total
    normal /= length
    move: FloatArray = centre - (centre * normal).sum() * normal
    return move
