"""Settings of the correspondence stage, checked when they are made."""

from typing import Annotated, Literal

from ostiform.study import (
    AlignmentMode,
    AlignmentSettings,
    Optimiser,
    StatedCorrespondence,
    TemplateSettings,
)
from ostiform.values import Above, AtLeast, value

_STATED = StatedCorrespondence()


@value(eq=True)
class CorrespondenceSettings:
    """How shapes are brought into correspondence; what a study can state has its default.

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

    optimiser: Optimiser = _STATED.optimiser
    levels: Annotated[int, AtLeast(1)] = _STATED.levels
    n_points: Annotated[int, AtLeast(12)] = TemplateSettings().points
    n_optimised: Annotated[int, AtLeast(12)] = 500
    noise_mm: Annotated[float, Above(0)] | None = _STATED.noise_mm
    alignment: AlignmentMode = AlignmentSettings().mode
    per: Literal["subject", "shape"] = "subject"
    batch: Annotated[int, AtLeast(2)] | None = _STATED.batch
    sweeps: Annotated[int, AtLeast(1)] = 20
    tolerance: Annotated[float, AtLeast(0)] = 2e-3
    stretch: Annotated[float, AtLeast(0)] = 20.0
    offset: Annotated[float, AtLeast(0)] = 20.0
    coherence: Annotated[float, AtLeast(0)] = _STATED.coherence
    metric: Annotated[float, AtLeast(0)] = 300.0
    euclidean_noise_mm: Annotated[float, Above(0)] | None = None
    seed: int = _STATED.seed
