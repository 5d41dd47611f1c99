"""The animations of a run: the first modes and the mean cycle.

Artifacts: ``animations/modeM.webp`` and ``animations/cycle.webp``, each with its frames as
``animations/NAME/0000.png``, ...
"""

import numpy as np

from ostiform.execution import Executor
from ostiform.model import DynamicModel, mean_cycle, read_dynamic_model, read_model
from ostiform.pipeline.dynamics import MODEL as DYNAMIC_MODEL
from ostiform.pipeline.store import Store, key_of
from ostiform.report import (
    FRAMES,
    Animation,
    cycle_animation,
    mode_animation,
    write_frames,
    write_webp,
)

MODES_ANIMATED = 3
CYCLE = "cycle"


def write_animations(store: Store, key: str, workers: Executor) -> None:
    """Write the animations of a folder's models that are not current.

    Parameters
    ----------
    store : Store
        Holds ``model.h5``, and ``dynamics.h5`` where subjects have several phases.
    key : str
        Of what the models were made from.
    workers : Executor
    """
    own = key_of("animations", key)
    modes = min(MODES_ANIMATED, len(read_model(store.path("model.h5")).model.modes))
    names = [f"mode{mode + 1}" for mode in range(modes)]
    if store.path(DYNAMIC_MODEL).is_file():
        names.append(CYCLE)
    wanted = [name for name in names if not store.is_current(f"animations/{name}.webp", own)]
    for outcome in workers.each(_written, wanted, store, own):
        _ = outcome.result


def mean_cycle_animation(dynamic: DynamicModel, n_frames: int = FRAMES) -> Animation:
    """Return the mean beating heart of a dynamic model."""
    times = np.arange(n_frames) / n_frames
    return cycle_animation(dynamic.total, mean_cycle(dynamic, times), times, "mean cycle")


def _written(name: str, store: Store, key: str) -> None:
    if name == CYCLE:
        animation = mean_cycle_animation(read_dynamic_model(store.path(DYNAMIC_MODEL)))
    else:
        model = read_model(store.path("model.h5")).model
        animation = mode_animation(model, int(name.removeprefix("mode")) - 1)
    write_frames(store.path(f"animations/{name}"), animation)
    with store.writing(f"animations/{name}.webp", key) as path:
        write_webp(path, animation)  # last: it vouches for the frames
