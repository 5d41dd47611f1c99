"""Fitting a beating model to all phases of a shape at once."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.errors import InputError
from ostiform.fitting.data import KINDS
from ostiform.fitting.fit import CLEARLY_NEARER, SAMPLED_EDGES, fit_shape, kinds_of
from ostiform.fitting.linear import pose_size
from ostiform.fitting.rim_kinds import with_openings_matched
from ostiform.fitting.sequence_data import SequenceData, prepared_sequence, single_targets
from ostiform.fitting.sequence_distances import data_distances, summary
from ostiform.fitting.sequence_doubts import doubts
from ostiform.fitting.sequence_posterior import (
    SequencePosterior,
    deviations_at,
    drawn_states,
    fit_state,
    sequence_posterior,
)
from ostiform.fitting.sequence_prior import SequencePrior
from ostiform.fitting.sequence_solver import (
    COARSE_ITERATIONS,
    FINE_ITERATIONS,
    SequenceSolution,
    phase_points,
    solve_sequence,
    starting_state,
    thinner,
)
from ostiform.fitting.sequence_types import PhaseTarget, SequenceFit, SequenceSettings, SliceShift
from ostiform.fitting.settings import FitSettings
from ostiform.fitting.target_size import checked_size
from ostiform.fitting.types import FitStatus, ShapeFit, Typicality, all_positions
from ostiform.fitting.typical import typicality

COARSE_PHASES = 8
DRAWS = 100


def fit_sequence(
    prior: SequencePrior,
    phases: Sequence[PhaseTarget],
    settings: SequenceSettings | None = None,
) -> SequenceFit:
    """Fit a beating model to all phases of one shape at once.

    The posterior of pose, cycle (modes over time, and a smooth field beyond them), and one shift in
    its plane for every slice, jointly: the pose of the phase with most data starts it
    (`fit_shape`), the mean cycle in it is improved with the modes alone, then all unknowns are
    solved for together, data paired anew in every iteration. Phases and slices may be missing,
    times uneven. Deterministic.

    Parameters
    ----------
    prior : SequencePrior
        From `sequence_prior`; serves any number of fits.
    phases : sequence of PhaseTarget
        Of one shape and in one frame, mm; at different times.
    settings : SequenceSettings, optional

    Raises
    ------
    InputError
        If there is nothing to fit to, two phases have one time, names are not the model's, or the
        data are of another size than the model (wrong units).
    TopologyError
        If a target surface is no consistently oriented manifold.
    """
    chosen = SequenceSettings() if settings is None else settings
    ordered = _ordered(phases)
    single = FitSettings(pose=chosen.pose, noise_mm=chosen.noise_mm)
    space = prior.space
    for phase in ordered:
        checked_size(space.model.mean, single_targets(phase))
    first = _first_look(prior, ordered, single)
    has_shifts = chosen.shift_sd_mm > 0.0
    data = prepared_sequence(space, ordered, has_shifts)
    start = starting_state(prior, data, first.pose)
    coarse = solve_sequence(
        prior,
        thinner(data, COARSE_PHASES),
        start,
        single,
        chosen.shift_sd_mm,
        False,
        COARSE_ITERATIONS,
    )
    data = _with_openings(prior, data, coarse)
    final = solve_sequence(
        prior, data, coarse.state, single, chosen.shift_sd_mm, True, FINE_ITERATIONS
    )
    posterior = sequence_posterior(prior, data, final, single, chosen.shift_sd_mm)
    fit = _result(prior, data, ordered, final, posterior, single)
    found = doubts(prior, data, ordered, final, first)
    return replace(fit, notes=(*first.notes, *found, *fit.notes))


def cycle_at(prior: SequencePrior, fit: SequenceFit, times: FloatArray) -> FloatArray:
    """Return the fitted shapes (n, P, 3) in mm at any times (n,), in the frame of the data."""
    state = fit_state(prior, fit)
    count = len(prior.space.model.mean)
    return np.stack([phase_points(prior, state, float(time))[:count] for time in times])


def cycle_deviations_at(
    prior: SequencePrior, fit: SequenceFit, times: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return standard deviations (n, P) in mm at any times, along normals and per coordinate."""
    state = fit_state(prior, fit)
    n_pose = _n_pose(prior, fit)
    found = [deviations_at(prior, state, fit.root, n_pose, float(time)) for time in times]
    return np.stack([normal for normal, _ in found]), np.stack([whole for _, whole in found])


def drawn_cycles(
    prior: SequencePrior, fit: SequenceFit, times: FloatArray, count: int = DRAWS
) -> FloatArray:
    """Return cycles (count, n, P, 3) in mm drawn from the posterior, always the same ones."""
    states = drawn_states(prior, fit_state(prior, fit), fit.root, _n_pose(prior, fit), count)
    size = len(prior.space.model.mean)
    return np.stack(
        [
            np.stack([phase_points(prior, state, float(time))[:size] for time in times])
            for state in states
        ]
    )


def _n_pose(prior: SequencePrior, fit: SequenceFit) -> int:
    state = fit_state(prior, fit)
    return len(fit.root) - state.modes.size - state.field.size - state.shifts.size


def _ordered(phases: Sequence[PhaseTarget]) -> list[PhaseTarget]:
    if not phases:
        raise InputError("a fit to a sequence: expected at least one phase, found none")
    ordered = sorted(phases, key=lambda phase: phase.time % 1.0)
    for before, after in zip(ordered, ordered[1:], strict=False):
        if abs(before.time % 1.0 - after.time % 1.0) < 1e-9:
            raise InputError(
                f"phases {before.name} and {after.name}: expected different times, found "
                f"{after.time:g} of the cycle for both; the cycle ends before it begins again"
            )
    return ordered


def _first_look(
    prior: SequencePrior, phases: Sequence[PhaseTarget], single: FitSettings
) -> ShapeFit:
    """Return the fit of the phase with most data alone, whose pose all start from.

    A few slices leave room for wrong poses that look right, so any rotation is tried as well.
    """
    sizes = [len(all_positions(single_targets(phase))) for phase in phases]
    targets = single_targets(phases[int(np.argmax(sizes))])
    fit = fit_shape(prior.space, targets, single)
    if single.pose != "near":
        return fit
    other = fit_shape(prior.space, targets, replace(single, pose="unknown"))
    return other if other.residues.median < CLEARLY_NEARER * fit.residues.median else fit


def _with_openings(
    prior: SequencePrior, data: SequenceData, solution: SequenceSolution
) -> SequenceData:
    """Return the data with the loops of surfaces named that came near an opening."""
    found = []
    for time, phase in zip(data.times, data.phases, strict=True):
        points = phase_points(prior, solution.state, float(time))
        found.append(with_openings_matched(prior.space, phase, points)[0])
    return replace(data, phases=tuple(found))


def _result(
    prior: SequencePrior,
    data: SequenceData,
    phases: Sequence[PhaseTarget],
    final: SequenceSolution,
    posterior: SequencePosterior,
    single: FitSettings,
) -> SequenceFit:
    space, state = prior.space, final.state
    count, n_modes = len(space.model.mean), state.modes.shape[1]
    n_pose = pose_size(single)
    points, normal, overall = [], [], []
    for time in data.times:
        points.append(phase_points(prior, state, float(time))[:count])
        along, whole = deviations_at(prior, state, posterior.root, n_pose, float(time))
        normal.append(along)
        overall.append(whole)
    distances = data_distances(prior, data, state)
    coefficients = np.zeros((len(state.modes), n_modes + state.field.shape[1]))
    coefficients[:, :n_modes] = state.modes
    coefficients[: len(state.field), n_modes:] = state.field
    spread = np.sqrt(space.leftover.growth * space.model.variances[:n_modes])
    shift_rows = posterior.root[len(posterior.root) - state.shifts.size :]
    shift_sd = np.sqrt((shift_rows**2).sum(axis=1)).reshape(state.shifts.shape)
    sd = np.zeros(3)
    if n_pose:
        start = state.modes.size + state.field.size
        deviations = np.sqrt((posterior.root[start : start + n_pose] ** 2).sum(axis=1))
        sd[0] = np.degrees(np.sqrt((deviations[:3] ** 2).mean()))
        sd[1] = np.sqrt((deviations[3:6] ** 2).mean())
    return SequenceFit(
        times=data.times,
        names=tuple(phase.name for phase in phases),
        points=np.stack(points),
        normal_sd=np.stack(normal),
        point_sd=np.stack(overall),
        pose=state.pose,
        pose_sd=sd,
        coefficients=coefficients,
        root=posterior.root,
        scores=spread * state.modes[0],
        shifts=tuple(
            SliceShift(
                slice=name,
                normal=data.slices.normals[index],
                shift=state.shifts[index, :2] @ data.slices.axes[index, :2],
                through=float(state.shifts[index, 2]),
                sd=float(np.sqrt((shift_sd[index, :2] ** 2).mean())),
                residue=distances.of_slice(index),
            )
            for index, name in enumerate(data.slices.names)
        ),
        residues={
            phase.name: summary(own) for phase, own in zip(phases, distances.phases, strict=True)
        },
        noise_mm=_noise(data, final.noise),
        outlier_share=posterior.outlier_share,
        typicality=_typicality(prior, state.modes[0], posterior, distances.median),
        status=FitStatus.CONVERGED if final.has_settled else FitStatus.ITERATION_LIMIT,
        iterations=final.iterations,
    )


def _noise(data: SequenceData, noise: FloatArray) -> dict[str, float]:
    kinds = sorted({kind for phase in data.phases for kind in kinds_of(phase)})
    return {KINDS[kind]: float(noise[kind]) for kind in kinds}


def _typicality(
    prior: SequencePrior, modes: FloatArray, posterior: SequencePosterior, median: float
) -> Typicality:
    """Return how typical the mean shape over the cycle is, in coordinates that make it N(0, I)."""
    space = prior.space
    n_modes = len(modes)
    spread = np.linalg.inv(prior.precision)[:n_modes, :n_modes]
    whitening = np.linalg.inv(np.linalg.cholesky(spread))
    expected = float(np.hypot(space.deviation, SAMPLED_EDGES * space.edge))
    return typicality(
        space,
        whitening @ (modes - prior.mean[0]),
        np.eye(n_modes) - whitening @ posterior.gain @ whitening.T,
        posterior.energy,
        median / expected,
    )
