"""Maximum a posteriori cycle, pose and shifts: Gauss-Newton on all phases at once.

As in `ostiform.fitting.solver`, with data paired anew in every iteration and Student-t noise whose
scale all phases share. The points of a phase depend on the modes and the field at its time alone,
so each phase gives one small block of normal equations in space, which the temporal functions
spread over the unknowns of the cycle: ``A = sum_t (phi(t) phi(t)^T) x A_t``. The shift of a slice
is two unknowns more, of the phases that it was seen in.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from ostiform.arrays import FloatArray
from ostiform.fitting.data import KINDS, sparser
from ostiform.fitting.linear import (
    LinearSystem,
    State,
    linear_system,
    moved,
    placed_points,
    pose_size,
    prior_information,
)
from ostiform.fitting.noise import (
    evidence_of,
    independent_share,
    inlier_probabilities,
    inlier_shares,
    starting_noise,
    student_weights,
    updated_noise,
)
from ostiform.fitting.observations import Observations, model_surface, observations
from ostiform.fitting.sequence_data import SequenceData, without_shifts
from ostiform.fitting.sequence_prior import SequencePrior
from ostiform.fitting.settings import FitSettings
from ostiform.fitting.solver import SETTLED, TURNED_BACK
from ostiform.fitting.types import Pose, placed
from ostiform.fitting.typical import FIELD_DOF

COARSE_SAMPLES = 300
COARSE_ITERATIONS, FINE_ITERATIONS = 5, 12
THROUGH_SHARE = 0.5
"""A slice may also be off through its plane, by this share of the deviation in it: a breath moves a
heart in all directions. Taken for exact, how large a section is would say where the heart lies to
a few tenths of a millimetre, and wrongly where the heart is unlike the model. Chosen on two
generated hearts, whose ventricle was 0.57 and 1.28 mm off with 0, 0.41 and 0.86 with 0.25, 0.44 and
0.53 with 0.5, 0.50 and 0.46 with 0.75; on ellipsoids more than 0.5 let the planes wander."""

TAKEN_EVERY = 3
"""In so many iterations the unknowns take about as many observations."""


@dataclass(frozen=True, slots=True, eq=False)
class SequenceState:
    """Where a fit is.

    Attributes
    ----------
    pose : Pose
        Of all phases.
    modes : (2 H + 1, K) float64
    field : (2 G + 1, 3 M) float64
        Empty along the second axis where the field is not solved for.
    shifts : (S, 3) float64, mm
        Of every slice along two axes of its plane and through it.
    """

    pose: Pose
    modes: FloatArray
    field: FloatArray
    shifts: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class SequenceSolution:
    """Where a run of the solver ended.

    Attributes
    ----------
    state : SequenceState
    noise : (5,) float64, mm
        Scale of every kind of data.
    shares : (5,) float64
        Of every kind of data, the share that is of the shape and no outlier.
    scales : float, float
        How many times more this cycle varies than the prior says, in the modes and beyond them
        (variances).
    has_settled : bool
    iterations : int
    """

    state: SequenceState
    noise: FloatArray
    shares: FloatArray
    scales: tuple[float, float]
    has_settled: bool
    iterations: int


@dataclass(frozen=True, slots=True, eq=False)
class Linearised:
    """The linear problem of all phases at one state.

    Attributes
    ----------
    phases : tuple of Observations
    systems : tuple of LinearSystem
        Rows of the phase's modes and field, then of the pose.
    seen : Observations
        Weight, size, kind of all phases' observations together.
    squared : (m,) float64, mm^2
        Of the same.
    """

    phases: tuple[Observations, ...]
    systems: tuple[LinearSystem, ...]
    seen: Observations
    squared: FloatArray


def phase_state(prior: SequencePrior, state: SequenceState, time: float) -> State:
    """Return pose and spatial coefficients at a time of the cycle."""
    phi = prior.design(np.array([time]))[0]
    field = phi[: len(state.field)] @ state.field
    return State(state.pose, np.concatenate([phi @ state.modes, field]))


def phase_points(prior: SequencePrior, state: SequenceState, time: float) -> FloatArray:
    """Return the points (Q, 3) at a time of the cycle, in the data's frame."""
    return placed_points(prior.space, phase_state(prior, state, time))


def turning_centre(prior: SequencePrior, pose: Pose) -> FloatArray:
    """Return the point (3,) that a change of the pose of all phases turns about."""
    centre: FloatArray = placed(pose, prior.space.mean).mean(axis=0)
    return centre


def slice_moves(data: SequenceData, state: SequenceState) -> FloatArray:
    """Return the shifts of all slices (S, 3) in space."""
    moves: FloatArray = np.einsum("ga,gai->gi", state.shifts, data.slices.axes)
    return moves


def starting_state(prior: SequencePrior, data: SequenceData, pose: Pose) -> SequenceState:
    """Return the mean cycle in a pose."""
    return SequenceState(
        pose,
        prior.mean,
        np.zeros((len(prior.field_variances), 0)),
        np.zeros((len(data.slices.names), 3)),
    )


def linearised(
    prior: SequencePrior, data: SequenceData, state: SequenceState, n_pose: int, gated: bool
) -> Linearised:
    """Pair all phases with the model as it lies, and linearise."""
    moves = slice_moves(data, state)
    use_field = state.field.shape[1] > 0
    centre = turning_centre(prior, state.pose)
    phases, systems = [], []
    for time, phase in zip(data.times, data.phases, strict=True):
        own = phase_state(prior, state, float(time))
        points = placed_points(prior.space, own)
        taken = without_shifts(phase, moves)
        seen = observations(prior.space, taken, model_surface(prior.space, taken, points), gated)
        phases.append(seen)
        systems.append(linear_system(prior.space, own, points, seen, use_field, n_pose, centre))
    nothing = np.zeros((0, 3))
    joined = Observations(
        corners=np.zeros((0, 3), dtype=np.int64),
        barycentric=nothing,
        directions=nothing,
        goals=nothing,
        owner=np.zeros(0, dtype=np.int64),
        weight=np.concatenate([seen.weight for seen in phases]),
        size=np.concatenate([seen.size for seen in phases]),
        kind=np.concatenate([seen.kind for seen in phases]),
        distance=np.concatenate([seen.distance for seen in phases]),
        slice=np.concatenate([seen.slice for seen in phases]),
    )
    return Linearised(
        tuple(phases), tuple(systems), joined, np.concatenate([s.squared for s in systems])
    )


def normal_equations(
    prior: SequencePrior,
    data: SequenceData,
    at: Linearised,
    per_observation: FloatArray,
    n_space: tuple[int, int],
) -> tuple[FloatArray, FloatArray]:
    """Return the information (D, D) of the data and their pull (D,) on all unknowns.

    Parameters
    ----------
    prior : SequencePrior
    data : SequenceData
    at : Linearised
    per_observation : (m,) float64, mm^-2
        Weight over squared noise.
    n_space : int, int
        Number of modes and of the field's functions in space.
    """
    n_modes, n_field = n_space
    n_shape = n_modes + n_field
    blocks, pulls = [], []
    start = 0
    for seen, system in zip(at.phases, at.systems, strict=True):
        weight = per_observation[start : start + len(seen.weight)][seen.owner]
        start += len(seen.weight)
        root = np.sqrt(weight)[:, None]
        rows = np.concatenate([system.rows, _shift_rows(data, seen)], axis=1) * root
        blocks.append(rows.T @ rows)
        pulls.append(rows.T @ (root[:, 0] * system.rest))
    block, pull = np.stack(blocks), np.stack(pulls)  # (T, C + D, C + D), (T, C + D)
    # Modes and field are spread over the cycle by temporal functions; all else is constant.
    design = prior.design(data.times)  # (T, 2 H + 1)
    constant = np.ones((len(data.times), 1))
    spread = (design, design[:, : len(prior.field_variances)], constant)
    columns = (slice(0, n_modes), slice(n_modes, n_shape), slice(n_shape, None))
    information = np.block(
        [
            [_kron_sum(one, two, block[:, a, b]) for two, b in zip(spread, columns, strict=True)]
            for one, a in zip(spread, columns, strict=True)
        ]
    )
    right = np.concatenate(
        [(one.T @ pull[:, a]).ravel() for one, a in zip(spread, columns, strict=True)]
    )
    return information, right


def prior_terms(
    prior: SequencePrior,
    state: SequenceState,
    settings: FitSettings,
    shift_sd: float,
    scales: tuple[float, float] = (1.0, 1.0),
) -> tuple[FloatArray, FloatArray]:
    """Return the prior's information (D, D) and its pull (D,) at a state.

    Parameters
    ----------
    prior : SequencePrior
    state : SequenceState
    settings : FitSettings
    shift_sd : float, mm
    scales : float, float
        Factors of the variances of the modes' coefficients and of the field's.
    """
    n_field = state.field.shape[1]
    n_pose = pose_size(settings)
    shape = State(state.pose, np.zeros(0))
    pose_precision, pose_pull = prior_information(prior.space, shape, 0, settings)
    field_precision = np.repeat(1.0 / (scales[1] * prior.field_variances), n_field)
    # Before the field is solved for, what it explains would go through the planes.
    through = THROUGH_SHARE if n_field else 1e-2
    deviations = shift_sd * np.array([1.0, 1.0, through])
    shifts = np.tile(1.0 / np.maximum(deviations, 1e-6) ** 2, len(state.shifts))
    n_modes = prior.mean.size
    total = n_modes + len(field_precision) + n_pose + len(shifts)
    information = np.zeros((total, total))
    information[:n_modes, :n_modes] = prior.precision / scales[0]
    diagonal = np.concatenate([field_precision, pose_precision[:n_pose], shifts])
    index = np.arange(n_modes, total)
    information[index, index] = diagonal
    pull = np.concatenate(
        [
            prior.precision @ (prior.mean - state.modes).ravel() / scales[0],
            -field_precision * state.field.ravel(),
            pose_pull[:n_pose],
            -shifts * state.shifts.ravel(),
        ]
    )
    return information, pull


def solve_sequence(
    prior: SequencePrior,
    data: SequenceData,
    start: SequenceState,
    settings: FitSettings,
    shift_sd: float,
    use_field: bool,
    most_iterations: int,
) -> SequenceSolution:
    """Run the iteration from a start."""
    space = prior.space
    n_modes, n_field = space.modes.shape[2], 3 * space.field.shape[1] if use_field else 0
    n_pose = pose_size(settings)
    field = np.zeros((len(prior.field_variances), n_field))
    if start.field.shape[1] == n_field:
        field = start.field
    state = SequenceState(start.pose, start.modes, field, start.shifts)
    noise: FloatArray | None = None
    shares, taken, scales = np.ones(len(KINDS)), 0.0, (1.0, 1.0)
    points = _all_points(prior, data, state)
    move = np.zeros_like(points)
    for iteration in range(1, most_iterations + 1):
        at = linearised(prior, data, state, n_pose, gated=use_field)
        whole = LinearSystem(np.zeros((0, 0)), np.zeros(0), at.squared)
        discount = 1.0 if use_field else _independent(prior, at)
        if noise is None:
            noise = starting_noise(space, at.seen, whole, settings, use_field)
        belongs = inlier_probabilities(space, at.seen, whole, noise, shares)
        shares = inlier_shares(at.seen, belongs)
        weights = discount * belongs * student_weights(at.seen, whole, noise)
        per_row = weights / noise[at.seen.kind] ** 2
        of_data, pull = normal_equations(prior, data, at, per_row, (n_modes, n_field))
        of_prior, back = prior_terms(prior, state, settings, shift_sd)
        factor = cho_factor(of_data + of_prior, lower=True)
        step = cho_solve(factor, pull + back)
        if iteration % TAKEN_EVERY == 1:
            free = 1.0 - np.diag(cho_solve(factor, of_prior))
            taken = float(free.sum())
            scales = _scales(prior, state, free)
        centre = turning_centre(prior, state.pose)
        following = stepped(state, step, centre, n_pose)
        later = _all_points(prior, data, following)
        if float(((later - points) * move).sum()) < 0.0:
            step = TURNED_BACK * step
            following = stepped(state, step, centre, n_pose)
            later = _all_points(prior, data, following)
        move = later - points
        change = float(np.sqrt((move**2).sum(axis=2).max()))
        squared = _left(prior, data, at, step, state, n_pose)
        counts = discount * belongs * at.seen.weight * at.seen.size
        for kind in np.unique(at.seen.kind):
            chosen = at.seen.kind == kind
            share = float((per_row * at.seen.size)[chosen].sum() / (per_row * at.seen.size).sum())
            evidence = evidence_of(chosen, counts, weights * squared, taken * share)
            noise[kind] = updated_noise(space, settings, evidence, use_field)
        state, points = following, later
        if change < SETTLED * space.edge:
            return SequenceSolution(state, noise, shares, scales, True, iteration)
    if noise is None:
        noise = np.full(len(KINDS), space.edge)
    return SequenceSolution(state, noise, shares, scales, False, most_iterations)


def thinner(data: SequenceData, most_phases: int) -> SequenceData:
    """Return some of the phases, evenly, with fewer samples of each, for a first look."""
    chosen = np.unique(np.linspace(0, len(data.times) - 1, most_phases).round().astype(int))
    phases = tuple(sparser(data.phases[k], COARSE_SAMPLES) for k in chosen)
    return SequenceData(data.times[chosen], phases, data.slices)


def stepped(
    state: SequenceState, step: FloatArray, centre: FloatArray, n_pose: int
) -> SequenceState:
    """Return the state after a step of all unknowns."""
    n_modes, n_field = state.modes.size, state.field.size
    change = step[n_modes + n_field : n_modes + n_field + n_pose]
    pose = moved(State(state.pose, np.zeros(0)), change, centre, 0).pose
    return SequenceState(
        pose,
        state.modes + step[:n_modes].reshape(state.modes.shape),
        state.field + step[n_modes : n_modes + n_field].reshape(state.field.shape),
        state.shifts + step[n_modes + n_field + n_pose :].reshape(state.shifts.shape),
    )


def _scales(prior: SequencePrior, state: SequenceState, free: FloatArray) -> tuple[float, float]:
    """Return how many times more a cycle varies than the prior says, in the modes and beyond.

    The squared deviation over the number of coefficients that the data determine (`free`, by
    unknown; MacKay 1992), with the scatter between training subjects as its prior.
    """
    apart = (state.modes - prior.mean).ravel()
    n_modes, n_field = apart.size, state.field.size
    known = float(free[:n_modes].sum())
    few = max(prior.subjects - 1.0, 1.0)
    modes = (float(apart @ prior.precision @ apart) + few) / (known + few)
    if not n_field:
        return modes, 1.0
    energy = float((state.field**2 / prior.field_variances[:, None]).sum())
    dof = float(np.clip(prior.space.leftover.energy_dof, *FIELD_DOF))
    return modes, (energy + dof) / (float(free[n_modes : n_modes + n_field].sum()) + dof)


def _all_points(prior: SequencePrior, data: SequenceData, state: SequenceState) -> FloatArray:
    return np.stack([phase_points(prior, state, float(time)) for time in data.times])


def _shift_rows(data: SequenceData, seen: Observations) -> FloatArray:
    """Return how far the model lags behind goals along directions per unit of every shift."""
    n_slices = len(data.slices.names)
    rows = np.zeros((len(seen.goals), n_slices, 3))
    slices = seen.slice[seen.owner]
    of_slice = np.flatnonzero(slices >= 0)
    if len(of_slice):
        axes = data.slices.axes[slices[of_slice]]  # (n, 3, 3)
        rows[of_slice, slices[of_slice]] = np.einsum("nai,ni->na", axes, seen.directions[of_slice])
    return rows.reshape(len(rows), -1)


def _kron_sum(one: FloatArray, two: FloatArray, block: FloatArray) -> FloatArray:
    """Return ``sum_t (one_t two_t^T) x block_t`` for (T, h), (T, g) and (T, a, b)."""
    h, g = one.shape[1], two.shape[1]
    a, b = block.shape[1:]
    products = np.einsum("th,tg->thg", one, two).reshape(len(one), -1)
    summed = products.T @ block.reshape(len(block), -1)  # (h g, a b)
    joined: FloatArray = summed.reshape(h, g, a, b).transpose(0, 2, 1, 3).reshape(h * a, g * b)
    return joined


def _left(
    prior: SequencePrior,
    data: SequenceData,
    at: Linearised,
    step: FloatArray,
    state: SequenceState,
    n_pose: int,
) -> FloatArray:
    """Return what the linear problem leaves of every observation (m,), squared, mm^2."""
    n_modes, n_field = state.modes.size, state.field.size
    modes = step[:n_modes].reshape(state.modes.shape)
    field = step[n_modes : n_modes + n_field].reshape(state.field.shape)
    rest = step[n_modes + n_field :]
    found = []
    design = prior.design(data.times)
    for phi, seen, system in zip(design, at.phases, at.systems, strict=True):
        own = np.concatenate([phi @ modes, phi[: len(field)] @ field, rest[:n_pose]])
        left = system.rest - system.rows @ own - _shift_rows(data, seen) @ rest[n_pose:]
        found.append(np.bincount(seen.owner, left**2, minlength=len(seen.weight)))
    return np.concatenate(found)


def _independent(prior: SequencePrior, at: Linearised) -> float:
    shares = [independent_share(prior.space, seen) for seen in at.phases]
    return float(np.mean(shares))
