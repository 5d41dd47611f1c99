"""Settings of the correspondence stage, checked when they are made."""

from dataclasses import dataclass
from typing import Literal

from ostiform.correspondence.alignment import AlignmentMode
from ostiform.errors import InputError

Optimiser = Literal["majorise", "conjugate-gradient"]


@dataclass(frozen=True, slots=True)
class CorrespondenceSettings:
    """How shapes are brought into correspondence.

    Attributes
    ----------
    optimiser : {"majorise", "conjugate-gradient"}
        Of the description length; the second is the paper's.
    levels : int
        Level 1 minimises the Euclidean distance, levels 2 to `levels` the description length.
    n_points : int
        Points of the template.
    n_optimised : int
        The objective is evaluated on the coarsest template level with at least this many points.
    noise_mm : float or None
        Standard deviation per coordinate of the noise of the surfaces; None takes 0.2 times the
        median edge of the input.
    alignment : {"rigid", "similarity", "none"}
    per : {"subject", "shape"}
        Whether the phases of a subject share one transform.
    batch : int or None
        Shapes that `majorise` moves between two updates of the mean and of W; None moves all.
    sweeps : int
        Most sweeps per level.
    tolerance : float
        A level has converged when a sweep lowers the objective by less than this share of it and
        the quadratic models promise less than this share too.
    stretch, offset : float
        Penalty on the accumulated displacement; see `penalty.displacement_penalty`.
    coherence : float
        Strength of the coherence term of levels 2 and finer, dimensionless: one over the square
        of the radius of the mean shape; see `coherence`.
    metric : float
        Strength of the metric term; see `metric`.
    euclidean_noise_mm : float or None
        Unit of distance of level 1, set against the penalty; None takes the root mean square
        distance per point of the conformal start from its mean.
    seed : int
        Of the random order of `conjugate-gradient`.
    """

    optimiser: Optimiser = "majorise"
    levels: int = 4
    n_points: int = 2500
    n_optimised: int = 500
    noise_mm: float | None = None
    alignment: AlignmentMode = "rigid"
    per: Literal["subject", "shape"] = "subject"
    batch: int | None = None
    sweeps: int = 20
    tolerance: float = 2e-3
    stretch: float = 20.0
    offset: float = 20.0
    coherence: float = 1e6
    metric: float = 300.0
    euclidean_noise_mm: float | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse settings that cannot be used."""
        for name, choices in (
            ("optimiser", ("majorise", "conjugate-gradient")),
            ("alignment", ("rigid", "similarity", "none")),
            ("per", ("subject", "shape")),
        ):
            if getattr(self, name) not in choices:
                raise InputError(
                    f"correspondence {name}: expected one of {', '.join(choices)}, found "
                    f'"{getattr(self, name)}"'
                )
        for name, least in (("levels", 1), ("n_points", 12), ("n_optimised", 12), ("sweeps", 1)):
            if getattr(self, name) < least:
                raise InputError(
                    f"correspondence {name}: expected at least {least}, found {getattr(self, name)}"
                )
        if self.batch is not None and self.batch < 2:
            raise InputError(
                f"correspondence batch: expected at least 2 shapes, found {self.batch}"
            )
        for name in ("noise_mm", "euclidean_noise_mm"):
            value = getattr(self, name)
            if value is not None and not value > 0.0:
                raise InputError(
                    f"correspondence {name}: expected millimetres above 0, found {value:g}"
                )
        for name in ("tolerance", "stretch", "offset", "coherence", "metric"):
            if not getattr(self, name) >= 0.0:
                raise InputError(
                    f"correspondence {name}: expected a number not below 0, found "
                    f"{getattr(self, name):g}"
                )
