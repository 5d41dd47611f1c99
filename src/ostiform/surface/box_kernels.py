"""Closest points of triangles by a tree of boxes: its construction, refitting and search.

The tree halves the triangles by their centroids along the longest side of the box of these, down
to single triangles. Nodes stand in preorder: the left child follows its parent, ``right`` holds
the other one, or for a leaf ``-1 - face``.
"""

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.compiled import kernel

DEEPEST = 64
"""Halving n triangles ends after log2(n) + 1 levels."""


@kernel
def halved(vertices: FloatArray, faces: IntArray) -> IntArray:
    """Return the children (2 F - 1,) of a tree over triangles (F, 3)."""
    count = len(faces)
    centroids = np.empty((count, 3))
    for f in range(count):
        for k in range(3):
            a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
            centroids[f, k] = vertices[a, k] + vertices[b, k] + vertices[c, k]
    order = np.arange(count)
    right = np.empty(2 * count - 1, dtype=np.int64)
    stack = np.empty((DEEPEST, 3), dtype=np.int64)  # node, first and last of its triangles + 1
    stack[0, 0], stack[0, 1], stack[0, 2] = 0, 0, count
    top = 1
    while top > 0:
        top -= 1
        node, first, last = stack[top, 0], stack[top, 1], stack[top, 2]
        if last - first == 1:
            right[node] = -1 - order[first]
            continue
        middle = (first + last) // 2
        _select(order, centroids[:, _longest(order, centroids, first, last)], first, last, middle)
        right[node] = node + 2 * (middle - first)
        stack[top, 0], stack[top, 1], stack[top, 2] = right[node], middle, last
        stack[top + 1, 0], stack[top + 1, 1], stack[top + 1, 2] = node + 1, first, middle
        top += 2
    return right


@kernel
def fitted(vertices: FloatArray, faces: IntArray, right: IntArray) -> FloatArray:
    """Return the boxes (2 F - 1, 6) of a tree's nodes: least, then largest coordinates."""
    boxes = np.empty((len(right), 6))
    for node in range(len(right) - 1, -1, -1):  # children stand behind their parents
        if right[node] < 0:
            face = -1 - right[node]
            for k in range(3):
                a, b = vertices[faces[face, 0], k], vertices[faces[face, 1], k]
                c = vertices[faces[face, 2], k]
                boxes[node, k] = min(a, b, c)
                boxes[node, 3 + k] = max(a, b, c)
        else:
            for k in range(3):
                one, other = node + 1, right[node]
                boxes[node, k] = min(boxes[one, k], boxes[other, k])
                boxes[node, 3 + k] = max(boxes[one, 3 + k], boxes[other, 3 + k])
    return boxes


@kernel
def nearest(
    vertices: FloatArray,
    faces: IntArray,
    right: IntArray,
    boxes: FloatArray,
    queries: FloatArray,
    near: IntArray,
) -> tuple[FloatArray, IntArray, FloatArray]:
    """Return squared distances (n,), faces (n,) and barycentric coordinates (n, 3) of queries.

    The search begins with the distance from the triangles ``near`` (n,), where that is not
    negative: the nearer these are, the fewer boxes are opened.
    """
    squared = np.empty(len(queries))
    found = np.empty(len(queries), dtype=np.int64)
    weights = np.empty((len(queries), 3))
    nodes = np.empty(DEEPEST, dtype=np.int64)
    gaps = np.empty(DEEPEST)
    for q in range(len(queries)):
        x, y, z = queries[q, 0], queries[q, 1], queries[q, 2]
        best, face, v, w = np.inf, -1, 0.0, 0.0
        if near[q] >= 0:
            face = near[q]
            best, v, w = _to_triangle(vertices, faces, face, x, y, z)
        node, top = 0, 0
        while True:
            if right[node] < 0:
                distance, own_v, own_w = _to_triangle(vertices, faces, -1 - right[node], x, y, z)
                if distance < best:
                    best, face, v, w = distance, -1 - right[node], own_v, own_w
            else:
                one, other = node + 1, right[node]
                to_one, to_other = _to_box(boxes, one, x, y, z), _to_box(boxes, other, x, y, z)
                if to_other < to_one:  # the nearer one is opened first, the other one waits
                    one, other = other, one
                    to_one, to_other = to_other, to_one
                if to_one < best:
                    nodes[top], gaps[top] = other, to_other
                    top += 1
                    node = one
                    continue
            while top > 0 and gaps[top - 1] >= best:
                top -= 1
            if top == 0:
                break
            top -= 1
            node = nodes[top]
        squared[q], found[q] = best, face
        weights[q, 0], weights[q, 1], weights[q, 2] = max(1.0 - v - w, 0.0), v, w
    return squared, found, weights


@kernel
def _longest(order: IntArray, centroids: FloatArray, first: int, last: int) -> int:
    axis, length = 0, -1.0
    for k in range(3):
        low, high = np.inf, -np.inf
        for i in range(first, last):
            value = centroids[order[i], k]
            low, high = min(low, value), max(high, value)
        if high - low > length:
            axis, length = k, high - low
    return axis


@kernel
def _select(order: IntArray, keys: FloatArray, first: int, last: int, middle: int) -> None:
    """Order in place so that keys before the middle are at most, behind it at least, the one there.

    Hoare's selection; equal keys are swapped, so that they are divided evenly.
    """
    low, high = first, last - 1
    while low < high:
        pivot = keys[order[(low + high) // 2]]
        i, j = low, high
        while i <= j:
            while keys[order[i]] < pivot:
                i += 1
            while keys[order[j]] > pivot:
                j -= 1
            if i <= j:
                order[i], order[j] = order[j], order[i]
                i += 1
                j -= 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            return


@kernel(inline="always")
def _to_box(boxes: FloatArray, node: int, x: float, y: float, z: float) -> float:
    total = 0.0
    for k, at in enumerate((x, y, z)):
        below, above = boxes[node, k] - at, at - boxes[node, 3 + k]
        gap = below if below > above else above  # `max` has a branch for what is not a number
        total += gap * gap if gap > 0.0 else 0.0
    return total


@kernel
def _to_triangle(
    vertices: FloatArray, faces: IntArray, face: int, x: float, y: float, z: float
) -> tuple[float, float, float]:
    """Return the squared distance from a triangle a, b, c and the weights of b and c there.

    By the region of the plane that the point lies over (Ericson, Real-Time Collision Detection,
    2005, 5.1.5); a triangle without area is its edges.
    """
    a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
    ax, ay, az = vertices[a, 0], vertices[a, 1], vertices[a, 2]
    ux, uy, uz = vertices[b, 0] - ax, vertices[b, 1] - ay, vertices[b, 2] - az
    vx, vy, vz = vertices[c, 0] - ax, vertices[c, 1] - ay, vertices[c, 2] - az
    px, py, pz = x - ax, y - ay, z - az
    uu, uv = ux * ux + uy * uy + uz * uz, ux * vx + uy * vy + uz * vz
    vv = vx * vx + vy * vy + vz * vz
    d1, d2 = ux * px + uy * py + uz * pz, vx * px + vy * py + vz * pz
    d3, d4, d5, d6 = d1 - uu, d2 - uv, d1 - uv, d2 - vv
    wa, wb, wc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if d1 <= 0.0 and d2 <= 0.0:
        s, t = 0.0, 0.0
    elif d3 >= 0.0 and d4 <= d3:
        s, t = 1.0, 0.0
    elif d6 >= 0.0 and d5 <= d6:
        s, t = 0.0, 1.0
    elif wc <= 0.0 <= d1 and d3 <= 0.0 < uu:
        s, t = d1 / uu, 0.0
    elif wb <= 0.0 <= d2 and d6 <= 0.0 < vv:
        s, t = 0.0, d2 / vv
    elif wa <= 0.0 and d4 >= d3 and d5 >= d6 and d4 - d3 + d5 - d6 > 0.0:
        t = (d4 - d3) / (d4 - d3 + d5 - d6)
        s = 1.0 - t
    else:
        wa, wb, wc = max(wa, 0.0), max(wb, 0.0), max(wc, 0.0)
        total = wa + wb + wc
        s, t = (wb / total, wc / total) if total > 0.0 else (0.0, 0.0)
    qx, qy, qz = px - s * ux - t * vx, py - s * uy - t * vy, pz - s * uz - t * vz
    return qx * qx + qy * qy + qz * qz, s, t
