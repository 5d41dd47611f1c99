"""Where the sweeps of a correspondence stand, on disk while they go on: a kill costs little.

Artifacts: ``unfinished/NAME-level-N.bin``, removed when the stage that they belong to is done.
"""

import time
from dataclasses import dataclass
from functools import partial

from ostiform.artifacts import load, save
from ostiform.correspondence import Checkpoint
from ostiform.pipeline.store import Store

FOLDER = "unfinished"

REST = 20.0
"""Times as long as the last write took, nothing is written: so writing costs 5 % at most."""


@dataclass(slots=True)
class Unfinished:
    """The sweeps of one correspondence.

    Attributes
    ----------
    store : Store
    name : str
        Path segment that no other correspondence of the folder has.
    key : str
        Hash of everything that the correspondence is made from.
    """

    store: Store
    name: str
    key: str
    _next_write: float = 0.0

    def checkpoints(self) -> tuple[Checkpoint, ...]:
        """Return where an earlier run of this correspondence stood; empty where there was none."""
        states: list[Checkpoint] = []
        while not states or states[-1].status is not None:
            artifact = self._artifact(len(states) + 1)
            state = self.store.read_current(artifact, self.key, partial(load, kind=Checkpoint))
            if state is None:
                break
            states.append(state)
        return tuple(states)

    def save(self, state: Checkpoint) -> None:
        """Write the state at the end of a level, and between where it costs little."""
        start = time.monotonic()
        if state.status is None and start < self._next_write:
            return
        with self.store.writing(self._artifact(state.level), self.key) as path:
            save(path, state)
        end = time.monotonic()
        self._next_write = end + REST * (end - start)

    def remove(self) -> None:
        """Remove the states of all levels."""
        for path in self.store.path(FOLDER).glob(f"{self.name}-level-*.bin"):
            self.store.remove(f"{FOLDER}/{path.name}")

    def _artifact(self, level: int) -> str:
        return f"{FOLDER}/{self.name}-level-{level}.bin"
