"""Deformations: compositions of diffeomorphisms of space, with Jacobians and inverses."""

from dataclasses import dataclass

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.demo.spacemaps import SpaceMap


@dataclass(frozen=True, slots=True, eq=False)
class Deformation:
    """A composition of maps, the first applied first."""

    maps: tuple[SpaceMap, ...]

    def forward(self, points: FloatArray) -> FloatArray:
        """Return the images (n, 3), mm, of points (n, 3), mm."""
        for step in self.maps:
            points = step.forward(points)
        return points

    def linearised(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the images (n, 3) and the derivatives (n, 3, 3) at points (n, 3)."""
        result = np.broadcast_to(np.eye(3), (len(points), 3, 3))
        for step in self.maps:
            points, slope = step.linearised(points)
            result = slope @ result
        return points, result

    def inverse(self, points: FloatArray) -> FloatArray:
        """Return the points (n, 3) whose images are given, to 1e-9 mm.

        Raises
        ------
        ConvergenceError
            If Newton's method fails, which means that a map is not invertible.
        """
        for step in reversed(self.maps):
            points = step.inverse(points)
        return points
