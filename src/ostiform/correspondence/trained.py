"""What a correspondence run leaves behind: the shared metric and one trained model per kind."""

from dataclasses import dataclass
from typing import Annotated, Literal

from ostiform.arrays import FloatArray, IntArray
from ostiform.correspondence.checkpoint import LevelStatus, SweepRecord
from ostiform.correspondence.control_points import ControlPoints
from ostiform.correspondence.frozen import FrozenModel
from ostiform.correspondence.types import Correspondence
from ostiform.correspondence.warp import Warps
from ostiform.domain import BaseDomain, Template
from ostiform.study import AlignmentMode
from ostiform.values import Axes, value

Kind = Literal["conformal", "euclidean", "optimal"]
KINDS: tuple[Kind, ...] = ("conformal", "euclidean", "optimal")


@value
class SharedMetric:
    """What the three models of a comparison share, fixed from the conformal sampling (design 6).

    Attributes
    ----------
    domain : BaseDomain
    template : Template
        The optimal model's has its points elsewhere; see `lloyd`.
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
    template: Annotated[Template, Axes("P")]
    weights: Annotated[FloatArray, Axes("P")]
    noise_mm: float
    l_cut: float
    alignment: AlignmentMode
    groups: Annotated[IntArray, Axes(None)]


@dataclass(frozen=True, slots=True, eq=False)
class TrainedCorrespondence:
    """One of the three models of the paper: its correspondence, the warps, what places others.

    Attributes
    ----------
    kind : {"conformal", "euclidean", "optimal"}
    correspondence : Correspondence
        Scored by the shared metric's weights and alignment.
    shared_metric : SharedMetric
    frozen : FrozenModel
        What places further shapes.
    warps : Warps
        Of its shapes, from the points of the template to the directions of the correspondence.
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
    shared_metric: SharedMetric
    frozen: FrozenModel
    warps: Warps
    history: tuple[SweepRecord, ...]
    statuses: tuple[LevelStatus, ...]
    coherence: float
    interior: ControlPoints | None
    boundary: ControlPoints | None

    @property
    def has_converged(self) -> bool:
        """Whether every level ended by its stopping rule."""
        return all(status is LevelStatus.CONVERGED for status in self.statuses)
