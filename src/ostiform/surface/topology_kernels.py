"""Compiled loops of `topology`: edges sorted by counting, labels of pieces, flips of faces."""

import numpy as np

from ostiform.arrays import BoolArray, IntArray
from ostiform.compiled import kernel


@kernel
def labels_of_links(one: IntArray, two: IntArray, count: int) -> IntArray:
    """Join the sets of linked items, each known by its first item, then number the sets."""
    parent = np.arange(count)
    for k in range(len(one)):
        a, b = one[k], two[k]
        while parent[a] != a:
            parent[a] = parent[parent[a]]
            a = parent[a]
        while parent[b] != b:
            parent[b] = parent[parent[b]]
            b = parent[b]
        parent[max(a, b)] = min(a, b)
    labels = np.empty(count, dtype=np.int64)
    found = 0
    for item in range(count):
        if parent[item] == item:
            labels[item] = found
            found += 1
        else:
            labels[item] = labels[parent[item]]
    return labels


@kernel
def grouped_edges(
    low: IntArray, high: IntArray, span: int
) -> tuple[IntArray, IntArray, IntArray, IntArray]:
    """Sort pairs (n,) below `span` by counting, twice.

    Return the distinct ones, the index of each, their count, and the pairs' order.
    """
    n = len(low)
    order = np.empty(n, dtype=np.int64)
    start = np.zeros(span + 1, dtype=np.int64)
    for k in range(n):
        start[high[k] + 1] += 1
    start = np.cumsum(start)
    for k in range(n):
        order[start[high[k]]] = k
        start[high[k]] += 1
    start = np.zeros(span + 1, dtype=np.int64)
    for k in range(n):
        start[low[k] + 1] += 1
    start = np.cumsum(start)
    by_both = np.empty(n, dtype=np.int64)
    for item in order:
        by_both[start[low[item]]] = item
        start[low[item]] += 1
    edges = np.empty((n, 2), dtype=np.int64)
    count = np.zeros(n, dtype=np.int64)
    index = np.empty(n, dtype=np.int64)
    found = -1
    for item in by_both:
        if found < 0 or edges[found, 0] != low[item] or edges[found, 1] != high[item]:
            found += 1
            edges[found, 0] = low[item]
            edges[found, 1] = high[item]
        index[item] = found
        count[found] += 1
    return edges[: found + 1].copy(), index, count[: found + 1].copy(), by_both


@kernel
def propagated_flips(
    neighbours: IntArray, same_direction: BoolArray, n_faces: int
) -> tuple[BoolArray, bool]:
    """Flood each piece from its first face; a face is flipped where orientations disagree."""
    degree = np.zeros(n_faces + 1, dtype=np.int64)
    for e in range(len(neighbours)):
        degree[neighbours[e, 0] + 1] += 1
        degree[neighbours[e, 1] + 1] += 1
    start = np.cumsum(degree)
    fill = start[:-1].copy()
    link = np.empty(2 * len(neighbours), dtype=np.int64)
    for e in range(len(neighbours)):
        for side in range(2):
            link[fill[neighbours[e, side]]] = e
            fill[neighbours[e, side]] += 1
    flip = np.zeros(n_faces, dtype=np.bool_)
    seen = np.zeros(n_faces, dtype=np.bool_)
    queue = np.empty(n_faces, dtype=np.int64)
    is_orientable = True
    for root in range(n_faces):
        if seen[root]:
            continue
        seen[root] = True
        queue[0] = root
        head, tail = 0, 1
        while head < tail:
            face = queue[head]
            head += 1
            for k in range(start[face], start[face + 1]):
                e = link[k]
                other = neighbours[e, 0] + neighbours[e, 1] - face
                wanted = flip[face] != same_direction[e]
                if not seen[other]:
                    seen[other] = True
                    flip[other] = wanted
                    queue[tail] = other
                    tail += 1
                elif flip[other] != wanted:
                    is_orientable = False
    return flip, is_orientable
