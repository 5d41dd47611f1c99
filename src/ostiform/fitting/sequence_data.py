"""The phases of a sequence, prepared for pairing, and the slices that they share."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.errors import InputError
from ostiform.fitting.data import CONTOURS, LANDMARKS, Data, PointSet, part_faces, prepared_data
from ostiform.fitting.patches import Patch, curve_samples, open_patch
from ostiform.fitting.prior import FitPrior
from ostiform.fitting.sequence_types import PhaseTarget, SliceContours
from ostiform.fitting.types import ContourTarget, LandmarkTarget, Target

SAMPLE_EDGES = 0.5
"""Distance of the samples of a slice's curves, in edges of the model."""

FLAT_MM, FLAT_SHARE = 1.0, 0.05
"""Root mean square distance from its plane, in mm or of its size, up to which a slice is flat."""

SPREAD = 0.05
"""Of its size: a slice whose points are this near to a line has no plane of its own."""


@dataclass(frozen=True, slots=True, eq=False)
class Slices:
    """The planes that contours were drawn in.

    Attributes
    ----------
    names : tuple of str
        Of the G slices that can be shifted.
    normals : (G, 3) float64
    axes : (G, 3, 3) float64
        Two unit vectors in each plane, then its normal.
    """

    names: tuple[str, ...]
    normals: FloatArray
    axes: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class SequenceData:
    """All phases, ready for pairing.

    Attributes
    ----------
    times : (T,) float64
    phases : tuple of Data
        With the slices of their points as indices into `slices`.
    slices : Slices
    """

    times: FloatArray
    phases: tuple[Data, ...]
    slices: Slices


def prepared_sequence(space: FitPrior, phases: Sequence[PhaseTarget], shifts: bool) -> SequenceData:
    """Prepare phases for pairing with a beating model.

    Parameters
    ----------
    space : FitPrior
    phases : sequence of PhaseTarget
    shifts : bool
        Whether slices may be shifted.

    Raises
    ------
    InputError
        If a part or an opening is not of the model.
    """
    slices = _slices(phases) if shifts else Slices((), np.zeros((0, 3)), np.zeros((0, 3, 3)))
    place = {name: index for index, name in enumerate(slices.names)}
    prepared = tuple(_prepared_phase(space, phase, place) for phase in phases)
    times = np.array([phase.time for phase in phases]) % 1.0
    return SequenceData(times, prepared, slices)


def without_shifts(data: Data, moves: FloatArray) -> Data:
    """Return data whose points are taken back by the shifts (G, 3) of their slices."""
    sets = tuple(
        replace(item, points=item.points - moves[item.slices] * (item.slices >= 0)[:, None])
        if item.slices is not None and len(moves)
        else item
        for item in data.point_sets
    )
    return replace(data, point_sets=sets)


def single_targets(phase: PhaseTarget) -> tuple[Target, ...]:
    """Return a phase as targets of a fit to one shape, without slices."""
    found: list[Target] = []
    for item in phase.targets:
        if not isinstance(item, SliceContours):
            found.append(item)
        elif item.opening is None:
            found.append(ContourTarget(item.curves, item.part))
        else:
            rows = np.concatenate(item.curves)
            labels = tuple(f"{item.opening}-{k + 1}" for k in range(len(rows)))
            found.append(LandmarkTarget(labels, rows))
    return tuple(found)


def _prepared_phase(space: FitPrior, phase: PhaseTarget, place: Mapping[str, int]) -> Data:
    plain = [item for item in phase.targets if not isinstance(item, SliceContours)]
    data = prepared_data(space, plain)
    patches, capped = dict(data.patches), {}
    sets = list(data.point_sets)
    for item in phase.targets:
        if not isinstance(item, SliceContours):
            continue
        if item.opening is not None and item.opening not in space.centres:
            raise InputError(
                f"slice {item.slice}: expected one of the openings "
                f"{', '.join(space.centres) or '(none)'}, found {item.opening}"
            )
        if item.part not in patches:
            patches[item.part] = open_patch(part_faces(space, item.part), len(space.model.mean))
        if item.is_outline and item.part not in capped:
            capped[item.part] = _capped(space, patches[item.part])
        step = SAMPLE_EDGES * space.edge
        samples = [
            curve if item.opening else curve_samples(curve, max(step, _spacing(curve)))
            for curve in item.curves
            if len(curve)
        ]
        points = np.concatenate(samples)
        sets.append(
            PointSet(
                kind=CONTOURS if item.opening is None else LANDMARKS,
                part=item.part,
                points=points,
                slices=np.full(len(points), place.get(item.slice, -1)),
                rim=item.opening,
                is_outline=item.is_outline,
            )
        )
    return replace(data, point_sets=tuple(sets), patches=patches, capped=capped)


def _spacing(curve: FloatArray) -> float:
    """Return how far apart the points of a curve are: between them nothing new was measured."""
    lengths = np.linalg.norm(np.diff(curve, axis=0), axis=1)
    return float(np.median(lengths)) if len(lengths) else 0.0


def _capped(space: FitPrior, patch: Patch) -> Patch:
    """Return a part with a fan of triangles from the centre of every opening to its rim."""
    fans = [patch.faces]
    centre_of = {
        frozenset(np.asarray(space.model.mesh.loops[name]).tolist()): index
        for name, index in space.centres.items()
    }
    for loop in patch.loops:
        centre = centre_of.get(frozenset(loop.tolist()))
        if centre is not None:
            after = np.roll(loop, -1)
            fans.append(np.stack([after, loop, np.full(len(loop), centre)], axis=1))
    return open_patch(np.concatenate(fans), len(space.mean))


def _slices(phases: Sequence[PhaseTarget]) -> Slices:
    """Return the planes of all slices that are flat; others are no slices, and stay."""
    points: dict[str, list[FloatArray]] = {}
    for phase in phases:
        for item in phase.targets:
            if isinstance(item, SliceContours):
                points.setdefault(item.slice, []).extend(item.curves)
    names, normals, axes = [], [], []
    for name, curves in points.items():
        rows = np.concatenate(curves)
        if len(rows) < 3:
            continue
        _, spread, turn = np.linalg.svd(rows - rows.mean(axis=0), full_matrices=False)
        size, width, off = spread / np.sqrt(len(rows))
        if width > SPREAD * size and off < max(FLAT_MM, FLAT_SHARE * size):
            names.append(name)
            normals.append(turn[2])
            axes.append(turn)
    return Slices(tuple(names), np.array(normals).reshape(-1, 3), np.array(axes).reshape(-1, 3, 3))
