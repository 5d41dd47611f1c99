"""Functions of one shape that worker processes can import."""

import os
import signal
from pathlib import Path

from ostiform.correspondence import sample


def sampled_sum(shape, item, template):
    return item * float(sample(shape, template, template.points).sum())


def logged_and_killed_once(shape, item, folder):
    """Leave a line for every call; the first to reach shape 5 takes its process along."""
    with (Path(folder) / f"{item}.log").open("a") as stream:
        stream.write(f"{os.getpid()}\n")
    marker = Path(folder) / "killed"
    if item == 5 and not marker.exists():
        marker.write_text("killed")
        os.kill(os.getpid(), signal.SIGKILL)
    return float(shape.components[0].component.vertices.sum())
