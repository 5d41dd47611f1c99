"""Sweeps over the shapes of a population: one record per sweep, one status per level.

Where a level stands is a value, `LevelState`: handed out after every sweep and taken back to go
on, it leads to the same result, bit for bit, as sweeps without interruption.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import TypeAlias

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.correspondence.alignment import AlignmentMode, align
from ostiform.correspondence.crowding import crowding_value
from ostiform.correspondence.description_length import QuadraticForm
from ostiform.correspondence.landmarks import landmark_term, landmark_value
from ostiform.correspondence.metric import MetricTerm, metric_value, with_reference
from ostiform.correspondence.penalty import penalty_value
from ostiform.correspondence.sampling import ShapeSampler
from ostiform.correspondence.shape_step import (
    Proposal,
    ShapeGoal,
    WarpLevel,
    WarpState,
    advance,
    propose,
)
from ostiform.correspondence.shapes import GivenShapes, Shapes, as_shapes
from ostiform.surface import vertex_areas


class LevelStatus(Enum):
    """How the sweeps of a level ended."""

    CONVERGED = "the objective fell by less than the tolerance and its gradient is below it"
    SWEEP_LIMIT = "stopped at the largest number of sweeps before converging"
    STALLED = "no shape found a step that lowers the objective, although the gradient is not small"


@dataclass(frozen=True, slots=True)
class SweepRecord:
    """What one sweep over all shapes did.

    Attributes
    ----------
    stage : str
        ``"euclidean"`` or ``"optimal"``.
    level, sweep : int
        From 1; sweep 0 is the state before the first.
    objective : float
        Mean squared distance in units of `euclidean_noise_mm` (level 1) or description length
        and coherence term (level 2 and finer), at the optimiser's points, plus the mean penalty.
    penalty : float
        The penalty's part of the objective.
    step_rad : float
        Root mean square displacement of the points in this sweep.
    gradient : float
        Decrease that the quadratic models promise from here, over the objective.
    drift : float
        Norm of the mean coefficients over the shapes after the steps were accepted, over the
        root mean square norm; 0 when no velocity is common to all.
    accepted : int
        Shapes that took a step.
    seconds : float
        Time that the sweep took, by the clock.
    """

    stage: str
    level: int
    sweep: int
    objective: float
    penalty: float
    step_rad: float
    gradient: float
    drift: float
    accepted: int
    seconds: float


Progress: TypeAlias = Callable[[SweepRecord], None]


@dataclass(frozen=True, slots=True, eq=False)
class Population:
    """The warps of all shapes and the alignment they are judged in.

    Attributes
    ----------
    states : tuple of WarpState
    transforms : (N, 4, 4) float64
        From input to aligned coordinates.
    """

    states: tuple[WarpState, ...]
    transforms: FloatArray

    def __post_init__(self) -> None:
        """Give the transforms one memory layout: products round alike wherever they come from."""
        object.__setattr__(self, "transforms", np.ascontiguousarray(self.transforms))

    @property
    def landmarks(self) -> FloatArray:
        """Sampled points (N, Q, 3) in input coordinates, mm."""
        return np.stack([state.landmarks for state in self.states])

    @property
    def aligned(self) -> FloatArray:
        """Sampled points (N, Q, 3) in aligned coordinates, mm."""
        linear = self.transforms[:, None, :3, :3]  # (N, 1, 3, 3)
        moved = (linear @ self.landmarks[..., None])[..., 0]
        aligned: FloatArray = moved + self.transforms[:, None, :3, 3]
        return aligned

    def chosen(self, indices: Sequence[int]) -> "Population":
        """Return some of the shapes, in the order given."""
        states = tuple(self.states[index] for index in indices)
        return Population(states, self.transforms[list(indices)])

    def moved(self, indices: Sequence[int], states: Sequence[WarpState]) -> "Population":
        """Return the population with some of its shapes in other states."""
        found = dict(zip(indices, states, strict=True))
        return replace(
            self, states=tuple(found.get(i, state) for i, state in enumerate(self.states))
        )


@dataclass(frozen=True, slots=True, eq=False)
class LevelState:
    """Where the sweeps of a level stand.

    Attributes
    ----------
    level : int
        From 1.
    population : Population
        After the last finished sweep.
    records : tuple of SweepRecord
        Of the level, from sweep 0.
    status : LevelStatus or None
        How the level ended; None while it goes on.
    """

    level: int
    population: Population
    records: tuple[SweepRecord, ...]
    status: LevelStatus | None

    @property
    def sweeps(self) -> int:
        """Finished sweeps."""
        return len(self.records) - 1


Keep: TypeAlias = Callable[[LevelState], None]


@dataclass(frozen=True, slots=True, eq=False)
class Journal:
    """Who follows a run, and where an earlier, interrupted one stood.

    Attributes
    ----------
    progress : callable or None
        Called with the record of every sweep.
    keep : callable or None
        Called with the state after every sweep.
    begun : mapping of int to LevelState
        Of an earlier run on the same input, by level.
    """

    progress: Progress | None = None
    keep: Keep | None = None
    begun: Mapping[int, LevelState] = field(default_factory=dict)


def area_shares(points: FloatArray, faces: IntArray) -> FloatArray:
    """Return every point's share (N, P) of the area of each sampled surface (N, P, 3)."""
    areas = np.stack([vertex_areas(shape, faces) for shape in points])
    shares: FloatArray = areas / areas.sum(axis=1, keepdims=True)
    return shares


def current_metric(population: Population, level: WarpLevel) -> MetricTerm:
    """Return the metric term with the population's present mean as reference."""
    if level.metric.strength == 0.0:
        return level.metric
    return with_reference(level.metric, population.landmarks)


def mean_penalty(population: Population, level: WarpLevel) -> float:
    """Return the penalty summed over the shapes and divided by N - 1, as it goes with F."""
    metric = current_metric(population, level)
    total = sum(
        penalty_value(level.penalty, state.directions[level.index])
        + metric_value(metric, state.landmarks)
        + crowding_value(level.template, state.directions)
        for state in population.states
    )
    if level.terms:
        total += sum(
            landmark_value(term, state.landmarks)
            for term, state in zip(level.terms, population.states, strict=True)
        )
    return total / max(len(population.states) - 1, 1)


def realigned(
    population: Population,
    weights: FloatArray,
    mode: AlignmentMode,
    groups: IntArray,
    value: Callable[[FloatArray], float],
) -> Population:
    """Return the population aligned afresh, if that lowers a function of the aligned points."""
    if mode == "none":
        return population
    found = align(population.landmarks, weights, mode, groups)
    if value(found.aligned) <= value(population.aligned):
        return replace(population, transforms=found.transforms)
    return population


@dataclass(frozen=True, slots=True)
class SweepOutcome:
    """What a sweep reports beside the new population; see `SweepRecord`.

    Attributes
    ----------
    expected : float
        Decrease of the objective that the quadratic models of the shapes promised.
    drift, step_rad : float
    accepted : int
    """

    expected: float
    drift: float
    accepted: int
    step_rad: float


@dataclass(frozen=True, slots=True)
class SweepObjective:
    """What a level minimises, and how.

    Attributes
    ----------
    value : callable
        From aligned points (N, Q, 3) to the objective without the penalty.
    take : callable
        One sweep.
    realign : callable
        The population aligned afresh where that helps.
    """

    value: Callable[[FloatArray], float]
    take: Callable[[Population, WarpLevel], tuple[Population, SweepOutcome]]
    realign: Callable[[Population], Population]


@dataclass(frozen=True, slots=True, eq=False)
class _Rules:
    """What all shapes of a sweep share; the form only where it is the same for all.

    The common step (D,) is the mean of those that the shapes propose.
    """

    level: WarpLevel
    metric: MetricTerm
    form: QuadraticForm | None
    common: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Turn:
    """What a shape has of its own in a sweep; the form only where every shape has another."""

    state: WarpState
    transform: FloatArray
    form: QuadraticForm | None
    step: FloatArray


def joint_sweep(
    shapes: GivenShapes,
    population: Population,
    level: WarpLevel,
    forms: Sequence[QuadraticForm],
    metric: MetricTerm,
) -> tuple[Population, SweepOutcome]:
    """Return the population after every shape took a step on its own objective.

    The steps are made without regard to each other and their mean over the population is removed
    (a velocity common to all shapes moves points together and explains nothing); then each shape
    takes the longest part of its step that lowers its own objective. Where no part of it does, as
    happens while shapes are far from their goals, the shape tries its step with the mean.

    Parameters
    ----------
    shapes : Shapes or sequence of ShapeSampler
        N.
    population : Population
        Of these shapes.
    level : WarpLevel
    forms : sequence of QuadraticForm
        One per shape.
    metric : MetricTerm
        See `current_metric`.
    """
    kept = as_shapes(shapes)
    is_common = all(form is forms[0] for form in forms)
    # The terms of all shapes' landmarks stay here: each shape makes its own from its marks.
    nothing = np.zeros(len(level.basis))
    rules = _Rules(
        replace(level, terms=()),
        metric,
        forms[0] if is_common else None,
        nothing,
    )
    turns = [
        _Turn(state, transform, None if is_common else form, nothing)
        for state, transform, form in zip(
            population.states, population.transforms, forms, strict=True
        )
    ]
    proposals = kept.each(_proposed, turns, rules)
    steps = np.stack([proposal.coefficients for proposal in proposals])  # (N, D)
    common = steps.mean(axis=0)
    outcomes = kept.each(
        _advanced,
        [replace(turn, step=step) for turn, step in zip(turns, steps, strict=True)],
        replace(rules, common=common),
    )
    taken = np.stack([step for _, step in outcomes])  # (N, D)
    moved = replace(population, states=tuple(state for state, _ in outcomes))
    gradients = np.stack([proposal.half_gradient for proposal in proposals])  # (N, D)
    expected = max(-float(np.sum(gradients * (steps - common))), 0.0) / max(len(proposals) - 1, 1)
    return moved, sweep_outcome(population, moved, taken, expected)


def _proposed(shape: ShapeSampler, turn: _Turn, rules: _Rules) -> Proposal:
    return propose(shape, turn.state, rules.level, _goal(shape, turn, rules), turn.transform)


def _advanced(shape: ShapeSampler, turn: _Turn, rules: _Rules) -> tuple[WarpState, FloatArray]:
    """Return the state after a step and the step (D,); without the common part if that helps."""
    goal = _goal(shape, turn, rules)
    for step in (turn.step - rules.common, turn.step):
        state, part = advance(shape, turn.state, rules.level, goal, turn.transform, step)
        if part > 0.0:
            break
    return state, part * step


def _goal(shape: ShapeSampler, turn: _Turn, rules: _Rules) -> ShapeGoal:
    form = rules.form if turn.form is None else turn.form
    if form is None:
        raise ValueError("a shape of a sweep has a form of its own, or all share one")
    return ShapeGoal(form, rules.metric, landmark_term(rules.level.marks, shape.marks))


def batched_sweep(
    shapes: Shapes,
    population: Population,
    level: WarpLevel,
    form_of: Callable[[Population], QuadraticForm],
    batches: Sequence[Sequence[int]],
) -> tuple[Population, SweepOutcome]:
    """Return the population after every shape took a step, batch by batch.

    Mean, form and metric reference are those after the batch before: with several batches a
    sweep goes further and costs as much again only in decompositions.

    Parameters
    ----------
    shapes : Shapes
    population : Population
    level : WarpLevel
    form_of : callable
        From a population to the form common to its shapes.
    batches : sequence of sequence of int
        The shapes, each once; a random part of the population each, as the mean of a batch's
        steps stands for that of all.
    """
    outcomes = []
    for batch in batches:
        form, metric = form_of(population), current_metric(population, level)
        part, outcome = joint_sweep(
            shapes.chosen(batch),
            population.chosen(batch),
            level,
            (form,) * len(batch),
            metric,
        )
        population = population.moved(batch, part.states)
        outcomes.append(outcome)
    if len(outcomes) == 1:
        return population, outcomes[0]
    shares = np.array([len(batch) for batch in batches]) / len(shapes)
    steps = np.array([outcome.step_rad for outcome in outcomes])
    return population, SweepOutcome(
        expected=sum(outcome.expected for outcome in outcomes),
        drift=float(shares @ [outcome.drift for outcome in outcomes]),
        accepted=sum(outcome.accepted for outcome in outcomes),
        step_rad=float(np.sqrt(shares @ steps**2)),
    )


def sweep_outcome(
    before: Population, after: Population, taken: FloatArray, expected: float
) -> SweepOutcome:
    """Return what a sweep did, from the coefficients (N, D) that each shape took."""
    size = float(np.sqrt((taken**2).sum(axis=1).mean()))
    moved = np.stack(
        [
            new.directions - old.directions
            for new, old in zip(after.states, before.states, strict=True)
        ]
    )
    return SweepOutcome(
        expected=expected,
        drift=float(np.linalg.norm(taken.mean(axis=0))) / size if size > 0.0 else 0.0,
        accepted=int((taken != 0.0).any(axis=1).sum()),
        step_rad=float(np.sqrt((moved**2).sum(axis=2).mean())),
    )


def run_sweeps(
    population: Population,
    level: WarpLevel,
    objective: SweepObjective,
    labels: tuple[str, int],
    limits: tuple[int, float],
    journal: Journal,
) -> tuple[Population, tuple[SweepRecord, ...], LevelStatus]:
    """Return the population after the sweeps of one level, their records and the status.

    Parameters
    ----------
    population : Population
    level : WarpLevel
    objective : SweepObjective
    labels : (str, int)
        Stage and level, for the records.
    limits : (int, float)
        Most sweeps, and the tolerance on the relative decrease and on the gradient.
    journal : Journal
        If it knows the level from an earlier run, the sweeps go on from there.
    """
    stage, number = labels
    most, tolerance = limits
    state = journal.begun.get(number)
    if state is None:
        penalty = mean_penalty(population, level)
        best = objective.value(population.aligned) + penalty
        first = SweepRecord(stage, number, 0, best, penalty, 0.0, 0.0, 0.0, 0, 0.0)
        state = LevelState(number, population, (first,), None)
    while (end := state.status) is None:
        clock = time.perf_counter()
        population, outcome = objective.take(state.population, level)
        population = objective.realign(population)
        penalty = mean_penalty(population, level)
        reached = objective.value(population.aligned) + penalty
        scale = max(abs(reached), np.finfo(float).tiny)
        record = SweepRecord(
            stage,
            number,
            state.sweeps + 1,
            reached,
            penalty,
            outcome.step_rad,
            outcome.expected / scale,
            outcome.drift,
            outcome.accepted,
            time.perf_counter() - clock,
        )
        decrease = (state.records[-1].objective - reached) / scale
        status = _status(record, decrease, most, tolerance)
        state = LevelState(number, population, (*state.records, record), status)
        if journal.keep is not None:
            journal.keep(state)
        if journal.progress is not None:
            journal.progress(record)
    return state.population, state.records, end


def _status(
    record: SweepRecord, decrease: float, most: int, tolerance: float
) -> LevelStatus | None:
    """Return how a level ends with a sweep, None if it goes on."""
    small = record.gradient < tolerance
    if decrease < tolerance and (small or record.accepted == 0):
        return LevelStatus.CONVERGED if small else LevelStatus.STALLED
    return LevelStatus.SWEEP_LIMIT if record.sweep >= most else None
