"""Vessels that end where somebody happened to cut them."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ostiform.demo.deformation import Deformation
from ostiform.demo.implicit import Anatomy, Cut
from ostiform.values import value

_STUMP_MM = 4.0
"""What is left of every vessel at least."""


@value
class RandomEnds:
    """How much too short vessels may be cut.

    Attributes
    ----------
    lengths : mapping of str to float, mm
        Length of the vessels from their base to their cut, in material coordinates, by the name of
        the cut.
    longest_mm : float
        A vessel is cut shorter by 0 to so much in world coordinates, each length as likely.
    slant_deg : float
        The cut is slanted by 0 to so much.
    """

    lengths: Mapping[str, float]
    longest_mm: float
    slant_deg: float

    def cut(self, anatomy: Anatomy, deformation: Deformation, rng: np.random.Generator) -> Anatomy:
        """Return an anatomy whose vessels end at random for one shape."""
        return replace(
            anatomy, cuts=tuple(self._moved(cut, deformation, rng) for cut in anatomy.cuts)
        )

    def _moved(self, cut: Cut, deformation: Deformation, rng: np.random.Generator) -> Cut:
        material = self.lengths.get(cut.first)
        if material is None:
            return cut
        ends = deformation.forward(np.stack([cut.center - material * cut.normal, cut.center]))
        length = float(np.linalg.norm(ends[1] - ends[0]))
        shorter = min(rng.uniform(0.0, self.longest_mm), max(length - _STUMP_MM, 0.0))
        slant = np.tan(np.radians(rng.uniform(0.0, self.slant_deg)))
        turn = rng.uniform(0.0, 2.0 * np.pi)
        other = np.cross(cut.normal, cut.saddle_axis)
        across = np.cos(turn) * cut.saddle_axis + np.sin(turn) * other
        return replace(
            cut,
            center=cut.center - material * shorter / length * cut.normal,
            normal=cut.normal + slant * across,
        )
