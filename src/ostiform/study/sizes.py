"""Shapes of another size than they should have: files in other units than was said."""

from collections.abc import Sequence

import numpy as np

OTHER_UNITS = 8.0
"""Shapes of one population differ less than this in size; centimetres and millimetres, more."""

LARGEST_MM = 5000.0
"""A shape beyond is none of a body: its file is in smaller units."""


def other_size(size: float, usual: float) -> float | None:
    """Return how many times a size is above or below the usual one, where it is too many."""
    ratio = max(size / usual, usual / size) if min(size, usual) > 0.0 else np.inf
    return ratio if ratio >= OTHER_UNITS else None


def other_sizes(sizes: Sequence[float]) -> dict[int, tuple[float, float]]:
    """Return which of several sizes are of other units: usual size and ratio, by index.

    Of two, the smaller one.
    """
    found = {}
    for k, size in enumerate(sizes):
        usual = float(np.median(np.delete(sizes, k))) if len(sizes) > 1 else size
        ratio = other_size(size, usual)
        if ratio is not None and not (len(sizes) == 2 and size > usual):
            found[k] = usual, ratio
    return found
