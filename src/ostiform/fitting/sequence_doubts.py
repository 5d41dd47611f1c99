"""What may be wrong with the data of a sequence, one sentence each."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from ostiform.arrays import BoolArray, FloatArray
from ostiform.fitting.fit import CLEARLY_NEARER, fit_shape
from ostiform.fitting.sequence_data import SequenceData, Slices, single_targets
from ostiform.fitting.sequence_distances import Distances, data_distances
from ostiform.fitting.sequence_prior import SequencePrior
from ostiform.fitting.sequence_solver import SequenceSolution
from ostiform.fitting.sequence_types import PhaseTarget, SliceContours
from ostiform.fitting.settings import FitSettings
from ostiform.fitting.types import ShapeFit, all_positions

APART = 3.0
"""A slice or phase this many times further from the surface than the median one does not belong."""

LEAST_APART = 0.15
"""In edges of the model: nearer data are never in doubt."""

TURNED_DEG = 60.0
"""Turned further than any patient lies against another of the same position."""

PARALLEL = np.cos(np.radians(5.0))
FEWEST_PARALLEL = 3

NOT_ONE_HEART = 1.8
"""The whole cycle this many times further from the data than one phase alone."""

UNLIKELY = 4.0
"""A cycle whose squared deviation from the mean is this many times the expected one."""

LOOKED_AT = 8
"""Phases that are fitted by themselves where they make no one heart, at most."""


def doubts(
    prior: SequencePrior,
    data: SequenceData,
    phases: Sequence[PhaseTarget],
    solution: SequenceSolution,
    first: ShapeFit,
) -> tuple[str, ...]:
    """Return what may be wrong with the data.

    Parameters
    ----------
    prior : SequencePrior
    data : SequenceData
    phases : sequence of PhaseTarget
        In the order of the data.
    solution : SequenceSolution
        Where the fit ended.
    first : ShapeFit
        Of the phase with most data alone.
    """
    distances = data_distances(prior, data, solution.state)
    found = [*_turned(first), *_slices_apart(prior, data, distances)]
    found += _phases_apart(prior, phases, distances)
    is_far = distances.median > LEAST_APART * prior.space.edge
    if is_far or found:
        found += _reversed(prior, data.slices, phases, distances)
    excess = solution.scales[0]
    if excess > UNLIKELY and len(phases) > 1:
        found.append(
            f"the cycle is {np.sqrt(excess):.1f} times as far from the mean cycle as those of the "
            "training subjects: check that all phases are of one patient, and their times"
        )
    if is_far and distances.median > NOT_ONE_HEART * first.residues.median:
        found += _two_hearts(prior, phases, distances, first)
    return tuple(found)


def _turned(first: ShapeFit) -> list[str]:
    angle = float(np.degrees(Rotation.from_matrix(first.pose.rotation).magnitude()))
    if angle < TURNED_DEG:
        return []
    return [
        f"the data are turned by {angle:.0f} degrees against the model: check the patient's "
        "position, the order of the slices and the frame of the files"
    ]


def _slices_apart(prior: SequencePrior, data: SequenceData, distances: Distances) -> list[str]:
    names = data.slices.names
    if len(names) < FEWEST_PARALLEL:
        return []
    apart = np.array([distances.of_slice(k) for k in range(len(names))])
    usual = float(np.median(apart))
    limit = max(APART * usual, LEAST_APART * prior.space.edge)
    far = [int(k) for k in np.flatnonzero(apart > limit)]
    if (
        len(far) == 2
        and abs(float(data.slices.normals[far[0]] @ data.slices.normals[far[1]])) > PARALLEL
    ):
        return [
            f"slices {names[far[0]]} and {names[far[1]]}: their curves stay {apart[far[0]]:.1f} "
            f"and {apart[far[1]]:.1f} mm from the fitted surface, those of the others "
            f"{usual:.1f} mm: check whether they were exchanged"
        ]
    return [
        f"slice {names[k]}: its curves stay {apart[k]:.1f} mm from the fitted surface, those of "
        f"the others {usual:.1f} mm: check that it is of this heart and lies where the file says"
        for k in far
    ]


def _phases_apart(
    prior: SequencePrior, phases: Sequence[PhaseTarget], distances: Distances
) -> list[str]:
    if len(phases) < FEWEST_PARALLEL:
        return []
    apart = np.array([distances.of_phase(k) for k in range(len(phases))])
    usual = float(np.median(apart))
    limit = max(APART * usual, LEAST_APART * prior.space.edge)
    far = [int(k) for k in np.flatnonzero(apart > limit)]
    if not far:
        return []
    return [
        f"phase {', '.join(phases[k].name for k in far)}: the data stay {apart[far].max():.1f} mm "
        f"from the fitted cycle, those of the other phases {usual:.1f} mm: check that the phase is "
        "of this patient and its time is right"
    ]


def _reversed(
    prior: SequencePrior, slices: Slices, phases: Sequence[PhaseTarget], distances: Distances
) -> list[str]:
    """Say whether the stack of parallel slices fits far better in reverse order."""
    sizes = [len(all_positions(single_targets(phase))) for phase in phases]
    phase = phases[int(np.argmax(sizes))]
    turned = _reversed_stack(slices, phase)
    if turned is None:
        return []
    near = FitSettings(pose="near")
    as_given = fit_shape(prior.space, single_targets(phase), near)
    other = fit_shape(prior.space, single_targets(turned), near)
    if other.residues.median >= CLEARLY_NEARER * as_given.residues.median:
        return []
    return [
        f"the slices fit far better in reverse order ({other.residues.median:.1f} mm instead of "
        f"{as_given.residues.median:.1f} mm in phase {phase.name}): check their order and the sign "
        "of their spacing"
    ]


def _reversed_stack(slices: Slices, phase: PhaseTarget) -> PhaseTarget | None:
    """Return a phase with the contours of its largest stack of slices in reverse order."""
    if not len(slices.normals):
        return None
    alike = np.abs(slices.normals @ slices.normals.T) > PARALLEL
    family = np.flatnonzero(alike[int(alike.sum(axis=1).argmax())])
    if len(family) < FEWEST_PARALLEL:
        return None
    normal = slices.normals[family[0]]
    names = {slices.names[k] for k in family}
    heights: dict[str, float] = {}
    for item in phase.targets:
        if isinstance(item, SliceContours) and item.slice in names:
            heights[item.slice] = float(np.concatenate(item.curves).mean(axis=0) @ normal)
    if len(heights) < FEWEST_PARALLEL:
        return None
    middle = min(heights.values()) + max(heights.values())
    return replace(
        phase,
        targets=tuple(
            replace(
                item,
                curves=tuple(
                    curve + (middle - 2.0 * heights[item.slice]) * normal for curve in item.curves
                ),
            )
            if isinstance(item, SliceContours) and item.slice in heights
            else item
            for item in phase.targets
        ),
    )


def _two_hearts(
    prior: SequencePrior,
    phases: Sequence[PhaseTarget],
    distances: Distances,
    first: ShapeFit,
) -> list[str]:
    """Say which phases make another heart than the others, each fitted by itself."""
    chosen = np.unique(np.linspace(0, len(phases) - 1, LOOKED_AT).round().astype(int))
    if len(chosen) < 2:
        return []
    design = prior.design(np.array([phases[k].time for k in chosen]))
    fits = [
        fit_shape(prior.space, single_targets(phases[k]), FitSettings(pose="near")) for k in chosen
    ]
    spread = np.sqrt(prior.space.model.variances[: prior.mean.shape[1]])
    own = (
        np.stack([fit.scores[: prior.mean.shape[1]] for fit in fits]) - design @ prior.mean * spread
    )
    groups = _divided(own)
    apart = ", ".join(phases[k].name for k, other in zip(chosen, groups, strict=True) if other)
    rest = ", ".join(phases[k].name for k, other in zip(chosen, groups, strict=True) if not other)
    return [
        f"the phases do not make one heart: together the data stay {distances.median:.1f} mm from "
        f"the surface, one phase alone {first.residues.median:.1f} mm; phases {apart} look unlike "
        f"{rest}: check that all are of one patient, and their times"
    ]


def _divided(rows: FloatArray) -> BoolArray:
    """Return which rows (n, K) lie beyond the widest gap along their principal axis; the fewer."""
    centred = rows - rows.mean(axis=0)
    along = centred @ np.linalg.svd(centred, full_matrices=False)[2][0]
    order = np.argsort(along)
    gap = int(np.diff(along[order]).argmax())
    beyond: BoolArray = along > 0.5 * (along[order[gap]] + along[order[gap + 1]])
    return beyond if beyond.sum() <= len(rows) / 2 else ~beyond
