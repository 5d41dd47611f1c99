"""How an effect on shape is tested."""

from dataclasses import dataclass
from typing import Literal, TypeAlias

Movement: TypeAlias = Literal["any", "normal"]


@dataclass(frozen=True, slots=True)
class EffectSettings:
    """How an effect is tested.

    Attributes
    ----------
    permutations : int
    seed : int
    movement : str
        ``"any"`` tests the three coordinates of every point, ``"normal"`` its movement along the
        normal of the mean shape.
    modes : int or None
        Modes of the test of the whole shape; None chooses (see `score_test`).
    shrinkage : float or None
        Of the covariance; None chooses.
    """

    permutations: int = 9999
    seed: int = 0
    movement: Movement = "any"
    modes: int | None = None
    shrinkage: float | None = None
