"""The animations of a run: the first modes and the mean cycle.

Artifacts: ``animations/modeM.webp`` and ``animations/cycle.webp``, each with its frames as
``animations/NAME/0000.png``, ...
"""

from collections.abc import Callable

import numpy as np

from ostiform.model import DynamicModel, ShapeModel, mean_cycle
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


def write_animations(
    store: Store, key: str, model: ShapeModel, dynamic: DynamicModel | None
) -> None:
    """Write the animations that are not current.

    Parameters
    ----------
    store : Store
    key : str
        Of what the model was made from.
    model : ShapeModel
    dynamic : DynamicModel or None
        None where no subject has several phases: there is no cycle then.
    """
    own = key_of("animations", key)
    wanted: dict[str, Callable[[], Animation]] = {
        f"mode{mode + 1}": _mode_maker(model, mode)
        for mode in range(min(MODES_ANIMATED, len(model.modes)))
    }
    if dynamic is not None:
        wanted["cycle"] = _cycle_maker(dynamic)
    for name, make in wanted.items():
        if not store.is_current(f"animations/{name}.webp", own):
            animation = make()
            write_frames(store.path(f"animations/{name}"), animation)
            with store.writing(f"animations/{name}.webp", own) as path:
                write_webp(path, animation)  # last: it vouches for the frames


def mean_cycle_animation(dynamic: DynamicModel, n_frames: int = FRAMES) -> Animation:
    """Return the mean beating heart of a dynamic model."""
    times = np.arange(n_frames) / n_frames
    return cycle_animation(dynamic.total, mean_cycle(dynamic, times), times, "mean cycle")


def _mode_maker(model: ShapeModel, mode: int) -> Callable[[], Animation]:
    return lambda: mode_animation(model, mode)


def _cycle_maker(dynamic: DynamicModel) -> Callable[[], Animation]:
    return lambda: mean_cycle_animation(dynamic)
