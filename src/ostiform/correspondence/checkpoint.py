"""Where the sweeps of a level stand: a value, handed out after every sweep and taken back to go on.

It leads to the same result, bit for bit, as sweeps without interruption.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import TypeAlias

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.correspondence.state import WarpState
from ostiform.correspondence.warp import Steps


class LevelStatus(Enum):
    """How the sweeps of a level ended."""

    CONVERGED = "the objective fell by less than the tolerance and its gradient is below it"
    SWEEP_LIMIT = "stopped at the largest number of sweeps before converging"
    STALLED = "no shape found a step that lowers the objective, although the gradient is not small"


@dataclass(frozen=True, slots=True)
class SweepRecord:
    """What one sweep over all shapes did.

    Attributes
    ----------
    stage : str
        ``"euclidean"`` or ``"optimal"``.
    level, sweep : int
        From 1; sweep 0 is the state before the first.
    objective : float
        Mean squared distance in units of `euclidean_noise_mm` (level 1) or description length
        and coherence (level 2 and finer), at the optimiser's points, plus the other terms' means.
    terms : mapping of str to float
        What it is the sum of, by the names of the terms (see `objective.shape_terms`).
    step_rad : float
        Root mean square displacement of the points in this sweep.
    gradient : float
        Decrease that the quadratic models promise from here, over the objective.
    drift : float
        Norm of the mean coefficients over the shapes after the steps were accepted, over the
        root mean square norm; 0 when no velocity is common to all.
    accepted : int
        Shapes that took a step.
    seconds : float
        Time that the sweep took, by the clock.
    """

    stage: str
    level: int
    sweep: int
    objective: float
    terms: Mapping[str, float]
    step_rad: float
    gradient: float
    drift: float
    accepted: int
    seconds: float


@dataclass(frozen=True, slots=True, eq=False)
class Population:
    """The warps of all shapes and the alignment they are judged in.

    Attributes
    ----------
    states : tuple of WarpState
    transforms : (N, 4, 4) float64
        From input to aligned coordinates.
    """

    states: tuple[WarpState, ...]
    transforms: FloatArray

    def __post_init__(self) -> None:
        """Give the transforms one memory layout: products round alike wherever they come from."""
        object.__setattr__(self, "transforms", np.ascontiguousarray(self.transforms))

    @property
    def landmarks(self) -> FloatArray:
        """Sampled points (N, Q, 3) in input coordinates, mm."""
        return np.stack([state.landmarks for state in self.states])

    @property
    def aligned(self) -> FloatArray:
        """Sampled points (N, Q, 3) in aligned coordinates, mm."""
        linear = self.transforms[:, None, :3, :3]  # (N, 1, 3, 3)
        moved = (linear @ self.landmarks[..., None])[..., 0]
        aligned: FloatArray = moved + self.transforms[:, None, :3, 3]
        return aligned

    def chosen(self, indices: Sequence[int]) -> "Population":
        """Return some of the shapes, in the order given."""
        states = tuple(self.states[index] for index in indices)
        return Population(states, self.transforms[list(indices)])

    def moved(self, indices: Sequence[int], states: Sequence[WarpState]) -> "Population":
        """Return the population with some of its shapes in other states."""
        found = dict(zip(indices, states, strict=True))
        return replace(
            self, states=tuple(found.get(i, state) for i, state in enumerate(self.states))
        )


@dataclass(frozen=True, slots=True, eq=False)
class Checkpoint:
    """Where the sweeps of a level stand.

    Attributes
    ----------
    level : int
        From 1.
    population : Population
        After the last finished sweep.
    steps : Steps
        That led there from the start of the level.
    records : tuple of SweepRecord
        Of the level, from sweep 0.
    status : LevelStatus or None
        How the level ended; None while it goes on.
    """

    level: int
    population: Population
    steps: Steps
    records: tuple[SweepRecord, ...]
    status: LevelStatus | None

    @property
    def sweeps(self) -> int:
        """Finished sweeps."""
        return len(self.records) - 1


Progress: TypeAlias = Callable[[SweepRecord], None]
Save: TypeAlias = Callable[[Checkpoint], None]


@dataclass(frozen=True, slots=True, eq=False)
class Callbacks:
    """Who follows a run, and where an earlier, interrupted one stood.

    Attributes
    ----------
    progress : callable or None
        Called with the record of every sweep.
    save : callable or None
        Called with the checkpoint after every sweep.
    resumed : mapping of int to Checkpoint
        Of an earlier run on the same input, by level.
    """

    progress: Progress | None = None
    save: Save | None = None
    resumed: Mapping[int, Checkpoint] = field(default_factory=dict)
