"""How every figure looks: a colour-blind-safe palette, small clean axes, print sizes."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

import matplotlib
from matplotlib.figure import Figure

__all__ = ["COLOURS", "FLIPPED", "KIND_NAMES", "PART_COLOURS", "figure", "styled"]

# Okabe & Ito (2008), distinguishable with any common colour-vision deficiency.
COLOURS: Final = {
    "conformal": "#0072B2",
    "euclidean": "#E69F00",
    "optimal": "#009E73",
    "truth": "#000000",
}
KIND_NAMES: Final = {
    "conformal": "conformal",
    "euclidean": "minimum Euclidean",
    "optimal": "optimal",
}
PART_COLOURS: Final = ("#CC79A7", "#56B4E9", "#E69F00", "#009E73", "#F0E442", "#0072B2")
FLIPPED: Final = "#D55E00"

SETTINGS: Final[dict[Any, Any]] = {
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.25,
    "legend.frameon": False,
    "svg.fonttype": "none",
    "svg.hashsalt": "ostiform",
    "pdf.fonttype": 42,
    "figure.dpi": 110,
}


@contextmanager
def styled() -> Iterator[None]:
    """Apply the style inside a block."""
    with matplotlib.rc_context(SETTINGS):
        yield


def figure(width_mm: float, height_mm: float) -> Figure:
    """Return an empty figure of a print size, drawn without any window system."""
    return Figure(figsize=(width_mm / 25.4, height_mm / 25.4), layout="constrained")
