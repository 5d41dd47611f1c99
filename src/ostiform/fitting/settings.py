"""What a fit can be told."""

from typing import Annotated, Literal, TypeAlias

from ostiform.values import Above, value

TargetKind: TypeAlias = Literal["auto", "surface", "points", "contours", "landmarks"]
PoseKnowledge: TypeAlias = Literal["known", "near", "unknown"]
Scaling: TypeAlias = Literal["rigid", "similarity"]


@value(eq=True)
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
    noise_mm: Annotated[float, Above(0)] | None = None
