"""The two optimisers of the description length on the same axes."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np

from ostiform.correspondence import SweepRecord

COLOURS = ("#1f6f8b", "#c1582f")


def draw_optimisers(path: Path, histories: Mapping[str, Sequence[SweepRecord]]) -> None:
    """Draw the objective of the levels from 2 against processor time, one panel per level."""
    mpl.use("Agg")
    import matplotlib.pyplot as plt

    levels = sorted({r.level for history in histories.values() for r in history if r.level > 1})
    with mpl.rc_context({"font.size": 8, "svg.hashsalt": "ostiform", "svg.fonttype": "none"}):
        drawing, grid = plt.subplots(
            1, len(levels), figsize=(2.5 * len(levels), 2.6), layout="constrained", squeeze=False
        )
        for axes, level in zip(grid[0], levels, strict=True):
            for (name, history), colour in zip(histories.items(), COLOURS, strict=True):
                own = [record for record in history if record.level == level]
                seconds = np.cumsum([record.seconds for record in own])
                label = "conjugate gradient" if "conjugate" in name else "majorise"
                axes.plot(
                    seconds, [r.objective for r in own], marker=".", color=colour, label=label
                )
            axes.set_title(f"level {level}")
            axes.set_xlabel("processor time (s)")
            axes.spines[["top", "right"]].set_visible(False)
        grid[0][0].set_ylabel("objective")
        grid[0][-1].legend(frameon=False)
        drawing.savefig(path, metadata={"Date": None} if path.suffix == ".svg" else {})
        plt.close(drawing)
