"""The shapes of a population resampled in correspondence."""

from dataclasses import dataclass

import numpy as np

from ostiform.arrays import FloatArray, frozen_floats
from ostiform.domain import Template
from ostiform.study import ShapeId


@dataclass(frozen=True, slots=True, eq=False)
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

    template: Template
    ids: tuple[ShapeId, ...]
    directions: FloatArray
    points: FloatArray
    aligned: FloatArray
    transforms: FloatArray
    weights: FloatArray

    def __post_init__(self) -> None:
        """Check the arrays and make them read-only."""
        n, p = len(self.ids), len(self.template.points)
        for name, shape in (
            ("directions", (n, p, 3)),
            ("points", (n, p, 3)),
            ("aligned", (n, p, 3)),
            ("transforms", (n, 4, 4)),
            ("weights", (p,)),
        ):
            object.__setattr__(self, name, frozen_floats(getattr(self, name), shape, name))

    @property
    def subjects(self) -> np.ndarray:
        """Subject of each shape, (N,) str."""
        return np.array([id.subject for id in self.ids])
