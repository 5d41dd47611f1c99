"""Contours that come in pieces, put together.

A plane through a mesh gives segments of two points each in most programs; a contour is sampled
evenly along its length, so its pieces must be known to be one curve.
"""

from collections.abc import Sequence

import numpy as np

from ostiform.arrays import FloatArray, IntArray


def joined_curves(points: FloatArray, pieces: Sequence[IntArray]) -> tuple[FloatArray, ...]:
    """Return curves (m, 3) from polylines, joined wherever exactly two ends meet.

    Ends meet where their coordinates are the same. A closed curve ends with its first point.

    Parameters
    ----------
    points : (n, 3) float64
    pieces : sequence of (m,) int64
        Vertex indices in order.
    """
    lines = [points[piece] for piece in pieces if len(piece)]
    whole = [line for line in lines if len(line) < 2 or (line[0] == line[-1]).all()]
    open_lines = [line for line in lines if len(line) >= 2 and (line[0] != line[-1]).any()]
    if not open_lines:
        return tuple(whole)
    ends = np.array([end for line in open_lines for end in (line[0], line[-1])])
    _, place = np.unique(ends, axis=0, return_inverse=True)
    place = place.reshape(-1, 2)  # of the two ends of every line
    meeting: dict[int, list[int]] = {}
    for index, pair in enumerate(place.tolist()):
        for node in pair:
            meeting.setdefault(node, []).append(index)
    used = np.zeros(len(open_lines), dtype=bool)
    found = []
    loose = [i for i, pair in enumerate(place.tolist()) if any(len(meeting[n]) != 2 for n in pair)]
    for first in (*loose, *range(len(open_lines))):  # open curves from an end, then closed ones
        if not used[first]:
            found.append(_walk(first, open_lines, place, meeting, used))
    return (*whole, *found)


def _walk(
    first: int,
    lines: Sequence[FloatArray],
    place: IntArray,
    meeting: dict[int, list[int]],
    used: np.ndarray,
) -> FloatArray:
    """Follow lines from one on, as long as exactly two meet."""
    start, node = (int(n) for n in place[first])
    line = lines[first]
    if len(meeting[start]) == 2 and len(meeting[node]) != 2:
        node, line = start, line[::-1]
    used[first] = True
    chain = [line]
    while len(meeting[node]) == 2:
        following = [index for index in meeting[node] if not used[index]]
        if not following:
            break
        (index,) = following
        used[index] = True
        if place[index, 0] == node:
            chain.append(lines[index][1:])
            node = int(place[index, 1])
        else:
            chain.append(lines[index][-2::-1])
            node = int(place[index, 0])
    return np.concatenate(chain)
