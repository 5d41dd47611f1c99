"""Compiled loops of `voxel_topology`: simple voxels, and sets that grow or shrink by these.

Voxels of an object are joined by faces; those beside it by faces and edges. This is the pair
(6+, 18) of digital topology, and what flying edges make of the signs of a field.
"""

import numpy as np

from ostiform.arrays import BoolArray, IntArray
from ostiform.compiled import kernel

_PLACES = np.stack(np.unravel_index(np.arange(27), (3, 3, 3)), axis=1)
_APART = np.abs(_PLACES[:, None] - _PLACES[None])  # (27, 27, 3)
_STEPS = np.where(_APART.max(axis=2) < 2, _APART.sum(axis=2), 9)
RINGS = np.array([int((1 << np.flatnonzero(_STEPS[13] == ring)).sum()) for ring in range(4)])
"""Bits of the voxels that share a face, an edge and a corner with the middle one."""
BY_FACES = np.array([int((1 << np.flatnonzero(own == 1)).sum()) for own in _STEPS])
BY_EDGES = np.array([int((1 << np.flatnonzero((own == 1) | (own == 2))).sum()) for own in _STEPS])


@kernel
def flipped_while_simple(state: BoolArray, allowed: BoolArray, rank: IntArray) -> None:
    """Flip allowed voxels, lowest rank first, while that changes no topology; in place.

    Parameters
    ----------
    state : (I, J, K) bool
        The object; its outermost voxels are never flipped.
    allowed : (I, J, K) bool
        What may be flipped once, towards one value only; flipped voxels are struck out.
    rank : (I, J, K) int64
        From 0.
    """
    sizes = state.shape
    n_ranks = int(rank.max()) + 1
    heads = np.full(n_ranks, -1, dtype=np.int64)  # stacks of voxels by rank
    before = np.full(state.size, -1, dtype=np.int64)
    waiting = np.zeros(state.size, dtype=np.bool_)
    flat_rank, flat_allowed = rank.ravel(), allowed.ravel()
    for v in range(state.size):
        if flat_allowed[v]:
            before[v] = heads[flat_rank[v]]
            heads[flat_rank[v]] = v
            waiting[v] = True
    lowest = 0
    while lowest < n_ranks:
        v = heads[lowest]
        if v < 0:
            lowest += 1
            continue
        heads[lowest] = before[v]
        waiting[v] = False
        i, rest = v // (sizes[1] * sizes[2]), v % (sizes[1] * sizes[2])
        j, k = rest // sizes[2], rest % sizes[2]
        if not allowed[i, j, k] or not _within(i, j, k, sizes):
            continue
        if not is_simple(_around(state, i, j, k)):
            continue
        state[i, j, k] = not state[i, j, k]
        allowed[i, j, k] = False
        for a in range(i - 1, i + 2):
            for b in range(j - 1, j + 2):
                for c in range(k - 1, k + 2):
                    w = (a * sizes[1] + b) * sizes[2] + c
                    if allowed[a, b, c] and not waiting[w]:
                        before[w] = heads[flat_rank[w]]
                        heads[flat_rank[w]] = w
                        waiting[w] = True
                        lowest = min(lowest, flat_rank[w])


@kernel
def _within(i: int, j: int, k: int, sizes: tuple[int, int, int]) -> bool:
    return 0 < i < sizes[0] - 1 and 0 < j < sizes[1] - 1 and 0 < k < sizes[2] - 1


@kernel
def _around(state: BoolArray, i: int, j: int, k: int) -> int:
    """Return the 27 voxels about one as bits."""
    bits = 0
    at = 0
    for a in range(i - 1, i + 2):
        for b in range(j - 1, j + 2):
            for c in range(k - 1, k + 2):
                if state[a, b, c]:
                    bits |= 1 << at
                at += 1
    return bits


@kernel
def is_simple(around: int) -> bool:
    """Return whether flipping the middle of 3 x 3 x 3 voxels (bits) changes no topology.

    So it is where both topological numbers are one (Bertrand & Malandain 1994).
    """
    first = around & RINGS[1]  # the object, in steps across faces
    second = around & RINGS[2] & _spread(first, BY_FACES)
    third = around & RINGS[3] & _spread(second, BY_FACES)
    if not _is_one_piece(first | second | third, BY_FACES):
        return False
    near = ~around & (RINGS[1] | RINGS[2])  # what is beside it, in steps across faces and edges
    far = ~around & RINGS[3] & _spread(near, BY_EDGES)
    return _is_one_piece(near | far, BY_EDGES)


@kernel
def _spread(members: int, neighbours: IntArray) -> int:
    """Return the neighbours of all members."""
    found = 0
    for n in range(27):
        if members >> n & 1:
            found |= neighbours[n]
    return found


@kernel
def _is_one_piece(members: int, neighbours: IntArray) -> bool:
    if members == 0:
        return False
    seen = members & -members
    front = seen
    while front:
        front = _spread(front, neighbours) & members & ~seen
        seen |= front
    return bool(seen == members)
