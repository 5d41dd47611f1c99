"""How every figure looks: a colour-blind-safe palette, small clean axes, print sizes."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from ostiform.arrays import FloatArray, IntArray

PRINT_DPI: Final = 300
"""Resolution of everything that is drawn as pixels."""

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
SUBJECT_COLOURS: Final = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
MARKERS: Final = ("o", "s", "^", "D", "v", "P", "X", "*")
FLIPPED: Final = "#D55E00"
MM3_PER_ML: Final = 1000.0

SETTINGS: Final[dict[Any, Any]] = {
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.titley": 1.0,  # else every drawing measures all labels of ticks to put titles above them
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.25,
    "legend.frameon": False,
    "svg.fonttype": "none",
    "svg.hashsalt": "ostiform",
    "pdf.fonttype": 42,
    "pdf.compression": 4,
    "figure.dpi": 110,
    "text.parse_math": False,  # a dollar in a name is a dollar
}


@contextmanager
def styled() -> Iterator[None]:
    """Apply the style inside a block."""
    with matplotlib.rc_context(SETTINGS):
        yield


def figure(width_mm: float, height_mm: float) -> Figure:
    """Return an empty figure of a print size that lays out its axes itself.

    No window system is needed.
    """
    return Figure(figsize=(width_mm / 25.4, height_mm / 25.4), layout="constrained")


def plain_figure(width_mm: float, height_mm: float) -> Figure:
    """Return an empty figure of a print size whose axes stay where they are put."""
    return Figure(figsize=(width_mm / 25.4, height_mm / 25.4))


def grid_of_panels(
    drawing: Figure,
    rows: int,
    columns: int,
    width_mm: float,
    height_mm: float,
    title_mm: float,
    gap_mm: float = 0.0,
    bottom_mm: float = 0.0,
) -> list[list[Axes]]:
    """Return axes of ``width_mm`` by ``height_mm`` that tile a figure, below a strip for titles.

    The figure must be ``columns * (width_mm + gap_mm)`` wide and
    ``rows * (height_mm + gap_mm) + title_mm + bottom_mm`` high; half of the gap is on each side of
    the axes, and a strip of ``bottom_mm`` stays free below them.
    """
    wide = columns * (width_mm + gap_mm)
    high = rows * (height_mm + gap_mm) + title_mm + bottom_mm
    return [
        [
            drawing.add_axes(
                (
                    (column * (width_mm + gap_mm) + 0.5 * gap_mm) / wide,
                    (bottom_mm + (rows - 1 - row) * (height_mm + gap_mm) + 0.5 * gap_mm) / high,
                    width_mm / wide,
                    height_mm / high,
                )
            )
            for column in range(columns)
        ]
        for row in range(rows)
    ]


def part_colours(face_part: IntArray) -> FloatArray:
    """Return red, green, blue (F, 3) in [0, 1] of triangles (F,) by their part."""
    palette = np.array([to_rgb(colour) for colour in PART_COLOURS])
    chosen: FloatArray = palette[face_part % len(palette)]
    return chosen


def shortened(name: str, length: int = 26) -> str:
    """Return a name cut to a number of characters, for legends and titles; tables have it whole."""
    return name if len(name) <= length else f"{name[: length - 1]}\N{HORIZONTAL ELLIPSIS}"


def percent(share: float) -> str:
    """Return a share as percent, without the sign for it."""
    return decimal(100.0 * share, 1)


def decimal(value: float, digits: int, sign: str = "") -> str:
    """Return a number as text, with a true minus sign and none for what rounds to zero.

    `sign` is "+" where positive numbers have one.
    """
    return f"{value:{sign}z.{digits}f}".replace("-", "\N{MINUS SIGN}")
