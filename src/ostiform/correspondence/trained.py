"""What a correspondence run leaves behind: the common yardstick and one trained model per kind."""

from dataclasses import dataclass
from typing import Literal

from ostiform.arrays import FloatArray, IntArray, frozen_floats, frozen_ints
from ostiform.correspondence.alignment import AlignmentMode
from ostiform.correspondence.control_points import ControlPoints
from ostiform.correspondence.description_length import QuadraticForm
from ostiform.correspondence.shape_step import WarpLevel
from ostiform.correspondence.sweeps import LevelStatus, SweepRecord
from ostiform.correspondence.types import Correspondence
from ostiform.domain import BaseDomain, Template

Kind = Literal["conformal", "euclidean", "optimal"]
KINDS: tuple[Kind, ...] = ("conformal", "euclidean", "optimal")


@dataclass(frozen=True, slots=True, eq=False)
class Yardstick:
    """What the three models of a comparison share, fixed from the conformal sampling (design 6).

    Attributes
    ----------
    domain : BaseDomain
    template : Template
        The optimal model's has its points elsewhere; see `spreading`.
    weights : (P,) float64
        Mean area share of each point over the conformally sampled shapes, sum 1.
    noise_mm : float
        Standard deviation per coordinate of the noise of the surfaces.
    l_cut : float
        mm^2; see `description_length.cut_off_eigenvalue`.
    alignment : {"rigid", "similarity", "none"}
    groups : (N,) int64
        Shapes with the same label share a transform.
    """

    domain: BaseDomain
    template: Template
    weights: FloatArray
    noise_mm: float
    l_cut: float
    alignment: AlignmentMode
    groups: IntArray

    def __post_init__(self) -> None:
        """Check the arrays and make them read-only."""
        count = len(self.template.points)
        object.__setattr__(self, "weights", frozen_floats(self.weights, (count,), "weights"))
        object.__setattr__(self, "groups", frozen_ints(self.groups, (None,), "groups"))


@dataclass(frozen=True, slots=True, eq=False)
class TrainedCorrespondence:
    """One of the three models of the paper: its correspondence and what places further shapes.

    Attributes
    ----------
    kind : {"conformal", "euclidean", "optimal"}
    correspondence : Correspondence
        Scored by the yardstick's weights and alignment.
    yardstick : Yardstick
    mean : (P, 3) float64, mm
        Of the aligned shapes.
    eigenvalues, modes : (R,) and (R, 3P) float64
        Those above l_cut of the covariance of the sqrt(weight)-scaled aligned shapes: the
        spectral factors of W.
    levels : tuple of WarpLevel
        Through which a further shape's warp is composed; empty for the conformal kind.
    forms : tuple of QuadraticForm
        What a further shape minimises at each level, at the optimiser's Q points: the distance to
        the mean at level 1, ``y^T W y`` after.
    history : tuple of SweepRecord
    statuses : tuple of LevelStatus
        How each level ended.
    coherence : float
        Strength of the coherence term at the last level: that of the settings, or weaker where
        the description was too long with it; see `hierarchy.optimal_levels`.
    interior, boundary : ControlPoints or None
        Of the finest level; None for the conformal kind.
    """

    kind: Kind
    correspondence: Correspondence
    yardstick: Yardstick
    mean: FloatArray
    eigenvalues: FloatArray
    modes: FloatArray
    levels: tuple[WarpLevel, ...]
    forms: tuple[QuadraticForm, ...]
    history: tuple[SweepRecord, ...]
    statuses: tuple[LevelStatus, ...]
    coherence: float
    interior: ControlPoints | None
    boundary: ControlPoints | None

    @property
    def has_converged(self) -> bool:
        """Whether every level ended by its stopping rule."""
        return all(status is LevelStatus.CONVERGED for status in self.statuses)
