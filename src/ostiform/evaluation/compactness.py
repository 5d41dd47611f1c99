"""How few modes carry how much of a population's variation (HY Fig. 4 left; design 6)."""

from dataclasses import dataclass

import numpy as np

from ostiform.arrays import FloatArray, frozen_floats
from ostiform.model import ShapeModel


@dataclass(frozen=True, slots=True, eq=False)
class Compactness:
    """Area-weighted variance of a population's shapes, mm^2 per point.

    Attributes
    ----------
    variances : (K,) float64
        Of the modes, largest first.
    total : float
        Of the modes and the residual together.
    """

    variances: FloatArray
    total: float

    def __post_init__(self) -> None:
        """Check the array and make it read-only."""
        object.__setattr__(self, "variances", frozen_floats(self.variances, (None,), "variances"))

    @property
    def cumulative(self) -> FloatArray:
        """Variance (K,) of the first mode, the first two modes, and so on."""
        return np.cumsum(self.variances)

    def modes_for(self, share: float) -> int:
        """Return the fewest modes that carry a share of the total; K + 1 if all do not."""
        reached = self.cumulative >= share * self.total * (1.0 - SHARE_ROUNDING)
        return int(np.argmax(reached)) + 1 if reached.any() else len(self.variances) + 1


SHARE_ROUNDING = 1e-12
"""Relative: rounding of the cumulative sum."""


def model_compactness(model: ShapeModel) -> Compactness:
    """Return the variances of a model and their total."""
    return Compactness(model.variances, model.total_variance)
