"""How far the data of a sequence lie from the fitted cycle."""

from dataclasses import dataclass

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.fitting.sequence_data import SequenceData, without_shifts
from ostiform.fitting.sequence_prior import SequencePrior
from ostiform.fitting.sequence_solver import SequenceState, phase_points, slice_moves
from ostiform.surface import SurfaceDistance, closest_points, surface_tree


@dataclass(frozen=True, slots=True, eq=False)
class Distances:
    """Distances of the data from the fitted surfaces, shifts taken off.

    Attributes
    ----------
    phases : tuple of (n,) float64, mm
    slices : tuple of (n,) int64
        The slice of every one; -1 for none.
    """

    phases: tuple[FloatArray, ...]
    slices: tuple[IntArray, ...]

    @property
    def median(self) -> float:
        """Of all, mm."""
        return _median(np.concatenate(self.phases))

    def of_phase(self, index: int) -> float:
        """Median of one phase, mm; 0 where it has only labelled data."""
        return _median(self.phases[index])

    def of_slice(self, index: int) -> float:
        """Median of one slice over the phases, mm."""
        together = np.concatenate(self.phases)
        return _median(together[np.concatenate(self.slices) == index])


def data_distances(prior: SequencePrior, data: SequenceData, state: SequenceState) -> Distances:
    """Return how far the points of all phases lie from the surfaces of a state."""
    moves = slice_moves(data, state)
    phases, slices = [], []
    for time, phase in zip(data.times, data.phases, strict=True):
        points = np.ascontiguousarray(phase_points(prior, state, float(time)))
        taken = without_shifts(phase, moves)
        found, own = [np.zeros(0)], [np.zeros(0, dtype=np.int64)]
        for item in taken.point_sets:
            patch = (taken.capped if item.is_outline else taken.patches)[item.part]
            found.append(closest_points(surface_tree(points, patch.faces), item.points).distances)
            plain = np.full(len(item.points), -1)
            own.append(plain if item.slices is None else item.slices)
        for surface in taken.surfaces:
            tree = surface_tree(points, taken.patches[surface.part].faces)
            found.append(closest_points(tree, surface.samples).distances)
            own.append(np.full(len(surface.samples), -1))
        phases.append(np.concatenate(found))
        slices.append(np.concatenate(own))
    return Distances(tuple(phases), tuple(slices))


def summary(distances: FloatArray) -> SurfaceDistance:
    """Return mean, 95th percentile and maximum of distances (n,); zero where there are none."""
    if not len(distances):
        return SurfaceDistance(0.0, 0.0, 0.0)
    return SurfaceDistance(
        float(distances.mean()), float(np.quantile(distances, 0.95)), float(distances.max())
    )


def _median(distances: FloatArray) -> float:
    return float(np.median(distances)) if len(distances) else 0.0
