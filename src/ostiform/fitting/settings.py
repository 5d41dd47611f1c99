"""What a fit can be told."""

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

from ostiform.errors import InputError

TargetKind: TypeAlias = Literal["auto", "surface", "points", "contours", "landmarks"]
PoseKnowledge: TypeAlias = Literal["known", "near", "unknown"]
Scaling: TypeAlias = Literal["rigid", "similarity"]


@dataclass(frozen=True, slots=True)
class FitSettings:
    """How a fit works.

    Attributes
    ----------
    pose : {"near", "known", "unknown"}
        ``near``: the target is turned by less than about 45 degrees against the model, wherever
        it lies. ``known``: it lies in the model's frame, no pose is estimated. ``unknown``: it
        may be turned in any way; many starts are tried.
    scaling : {"rigid", "similarity"}
        Whether the size is part of the pose.
    noise_mm : float or None
        Standard deviation of each coordinate of the data; None estimates it.
    """

    pose: PoseKnowledge = "near"
    scaling: Scaling = "rigid"
    noise_mm: float | None = None

    def __post_init__(self) -> None:
        """Check the values."""
        for name, value, allowed in (
            ("pose", self.pose, get_args(PoseKnowledge)),
            ("scaling", self.scaling, get_args(Scaling)),
        ):
            if value not in allowed:
                raise InputError(f'{name}: expected one of {", ".join(allowed)}, found "{value}"')
        if self.noise_mm is not None and not 0.0 < self.noise_mm < math.inf:
            raise InputError(f"noise: expected a positive number in mm, found {self.noise_mm}")
