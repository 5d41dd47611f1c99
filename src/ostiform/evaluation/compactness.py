"""How few modes carry how much of a population's variation (HY Fig. 4 left; design 6)."""

from typing import Annotated

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.model import ShapeModel
from ostiform.values import Axes, value


@value
class Compactness:
    """Area-weighted variance of a population's shapes, mm^2 per point.

    Attributes
    ----------
    variances : (K,) float64
        Of the modes, largest first.
    total : float
        Of the modes and the residual together.
    """

    variances: Annotated[FloatArray, Axes("K")]
    total: float

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
