"""The shapes of a population resampled in correspondence."""

from typing import Annotated

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.domain import Template
from ostiform.study import ShapeId
from ostiform.values import Axes, value


@value
class Correspondence:
    """N shapes sampled at the P points of one template.

    Attributes
    ----------
    template : Template
    ids : tuple of ShapeId
        In study order; N successful shapes.
    directions : (N, P, 3) float64
        Where each template point went on each shape's component sphere (unit vectors).
    points : (N, P, 3) float64, mm
        In each shape's own input coordinates.
    aligned : (N, P, 3) float64, mm
        After alignment.
    transforms : (N, 4, 4) float64
        From input to aligned coordinates (column vectors).
    weights : (P,) float64
        Population-mean area share of each point, sum 1.
    """

    template: Annotated[Template, Axes("P")]
    ids: Annotated[tuple[ShapeId, ...], Axes("N")]
    directions: Annotated[FloatArray, Axes("N", "P", 3)]
    points: Annotated[FloatArray, Axes("N", "P", 3)]
    aligned: Annotated[FloatArray, Axes("N", "P", 3)]
    transforms: Annotated[FloatArray, Axes("N", 4, 4)]
    weights: Annotated[FloatArray, Axes("P")]

    @property
    def subjects(self) -> np.ndarray:
        """Subject of each shape, (N,) str."""
        return np.array([id.subject for id in self.ids])
