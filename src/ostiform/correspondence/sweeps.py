"""Sweeps over the shapes of a population: one record per sweep, one status per level."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.correspondence.alignment import align
from ostiform.correspondence.checkpoint import (
    Callbacks,
    Checkpoint,
    LevelStatus,
    Population,
    SweepRecord,
)
from ostiform.correspondence.level import WarpLevel
from ostiform.correspondence.objective import Terms, shape_terms
from ostiform.correspondence.sampling import ShapeSampler
from ostiform.correspondence.shape_step import Proposal, advance, propose
from ostiform.correspondence.shapes import GivenShapes, Shapes, as_shapes
from ostiform.correspondence.state import WarpState
from ostiform.correspondence.terms.metric import MetricTerm, with_reference
from ostiform.correspondence.warp import Step, Steps, in_order, steps_of
from ostiform.study import AlignmentMode
from ostiform.surface import vertex_areas


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


@dataclass(frozen=True, slots=True, eq=False)
class SweepOutcome:
    """What a sweep reports beside the new population; see `SweepRecord`.

    Attributes
    ----------
    expected : float
        Decrease of the objective that the quadratic models of the shapes promised.
    drift, step_rad : float
    accepted : int
    steps : Steps
    """

    expected: float
    drift: float
    accepted: int
    step_rad: float
    steps: Steps


@dataclass(frozen=True, slots=True)
class SweepObjective:
    """What a level minimises, and how.

    Attributes
    ----------
    values : callable
        From a population to every term's value, by name.
    take : callable
        One sweep.
    realign : callable
        The population aligned afresh where that helps.
    """

    values: Callable[[Population], dict[str, float]]
    take: Callable[[Population], tuple[Population, SweepOutcome]]
    realign: Callable[[Population], Population]


@dataclass(frozen=True, slots=True, eq=False)
class _OfAll:
    """What all shapes of a sweep share; the forms only where they are the same for all.

    The common step (D,) is the mean of those that the shapes propose.
    """

    level: WarpLevel
    metric: MetricTerm
    forms: Terms | None
    common: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _OfOne:
    """What a shape has of its own in a sweep; the forms only where every shape has others."""

    state: WarpState
    transform: FloatArray
    forms: Terms | None
    proposed: FloatArray


def joint_sweep(
    shapes: GivenShapes,
    population: Population,
    level: WarpLevel,
    forms: Sequence[Terms],
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
    forms : sequence of mapping of str to Term
        What the population asks of each shape; see `shape_terms`.
    metric : MetricTerm
        See `current_metric`.
    """
    kept = as_shapes(shapes)
    is_common = all(own is forms[0] for own in forms)
    nothing = np.zeros(len(level.basis))
    shared = _OfAll(level, metric, forms[0] if is_common else None, nothing)
    items = [
        _OfOne(state, transform, None if is_common else own, nothing)
        for state, transform, own in zip(
            population.states, population.transforms, forms, strict=True
        )
    ]
    proposals = kept.each(_proposed, items, shared)
    proposed = np.stack([proposal.coefficients for proposal in proposals])  # (N, D)
    common = proposed.mean(axis=0)
    outcomes = kept.each(
        _advanced,
        [replace(item, proposed=own) for item, own in zip(items, proposed, strict=True)],
        replace(shared, common=common),
    )
    moved = replace(population, states=tuple(state for state, _ in outcomes))
    gradients = np.stack([proposal.half_gradient for proposal in proposals])  # (N, D)
    expected = max(-float(np.sum(gradients * (proposed - common))), 0.0)
    steps = steps_of([[step] for _, step in outcomes], len(level.basis))
    return moved, sweep_outcome(population, moved, steps, expected / max(len(proposals) - 1, 1))


def _proposed(shape: ShapeSampler, own: _OfOne, shared: _OfAll) -> Proposal:
    return propose(shape, own.state, shared.level, _terms(shape, own, shared), own.transform)


def _advanced(shape: ShapeSampler, own: _OfOne, shared: _OfAll) -> tuple[WarpState, Step]:
    """Return the state after a step, and the step; without the common part if that helps."""
    terms = _terms(shape, own, shared)
    for wanted in (own.proposed - shared.common, own.proposed):
        state, step = advance(shape, own.state, shared.level, terms, own.transform, wanted)
        if step.coefficients.any():
            break
    return state, step


def _terms(shape: ShapeSampler, own: _OfOne, shared: _OfAll) -> Terms:
    forms = shared.forms if own.forms is None else own.forms
    if forms is None:
        raise ValueError("a shape of a sweep has forms of its own, or all share them")
    return shape_terms(forms, shared.level, shared.metric, shape.marks)


def batched_sweep(
    shapes: Shapes,
    population: Population,
    level: WarpLevel,
    forms_of: Callable[[Population], Terms],
    batches: Sequence[Sequence[int]],
) -> tuple[Population, SweepOutcome]:
    """Return the population after every shape took a step, batch by batch.

    Mean, forms and metric reference are those after the batch before: with several batches a
    sweep goes further and costs as much again only in decompositions.

    Parameters
    ----------
    shapes : Shapes
    population : Population
    level : WarpLevel
    forms_of : callable
        From a population to the forms common to its shapes.
    batches : sequence of sequence of int
        The shapes, each once; a random part of the population each, as the mean of a batch's
        steps stands for that of all.
    """
    outcomes = []
    for batch in batches:
        forms, metric = forms_of(population), current_metric(population, level)
        part, outcome = joint_sweep(
            shapes.chosen(batch),
            population.chosen(batch),
            level,
            (forms,) * len(batch),
            metric,
        )
        population = population.moved(batch, part.states)
        outcomes.append(outcome)
    if len(outcomes) == 1:
        return population, outcomes[0]
    coefficients = np.zeros((1, len(shapes), len(level.basis)))
    fastest = np.zeros((1, len(shapes)))
    for batch, outcome in zip(batches, outcomes, strict=True):
        coefficients[:, list(batch)] = outcome.steps.coefficients
        fastest[:, list(batch)] = outcome.steps.fastest
    shares = np.array([len(batch) for batch in batches]) / len(shapes)
    moves = np.array([outcome.step_rad for outcome in outcomes])
    return population, SweepOutcome(
        expected=sum(outcome.expected for outcome in outcomes),
        drift=float(shares @ [outcome.drift for outcome in outcomes]),
        accepted=sum(outcome.accepted for outcome in outcomes),
        step_rad=float(np.sqrt(shares @ moves**2)),
        steps=Steps(coefficients, fastest),
    )


def sweep_outcome(
    before: Population, after: Population, steps: Steps, expected: float
) -> SweepOutcome:
    """Return what a sweep did, from the steps that the shapes took."""
    taken = steps.coefficients.sum(axis=0)  # (N, D)
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
        steps=steps,
    )


def run_sweeps(
    population: Population,
    n_fields: int,
    objective: SweepObjective,
    labels: tuple[str, int],
    limits: tuple[int, float],
    callbacks: Callbacks,
) -> Checkpoint:
    """Return where a level ends, with its status.

    Parameters
    ----------
    population : Population
    n_fields : int
        Of the level.
    objective : SweepObjective
    labels : (str, int)
        Stage and level, for the records.
    limits : (int, float)
        Most sweeps, and the tolerance on the relative decrease and on the gradient.
    callbacks : Callbacks
        If they know the level from an earlier run, the sweeps go on from there.
    """
    stage, number = labels
    most, tolerance = limits
    at = callbacks.resumed.get(number)
    if at is None:
        terms = objective.values(population)
        first = SweepRecord(stage, number, 0, sum(terms.values()), terms, 0.0, 0.0, 0.0, 0, 0.0)
        at = Checkpoint(
            number, population, steps_of([[]] * len(population.states), n_fields), (first,), None
        )
    while at.status is None:
        clock = time.perf_counter()
        population, outcome = objective.take(at.population)
        population = objective.realign(population)
        terms = objective.values(population)
        reached = sum(terms.values())
        scale = max(abs(reached), np.finfo(float).tiny)
        record = SweepRecord(
            stage,
            number,
            at.sweeps + 1,
            reached,
            terms,
            outcome.step_rad,
            outcome.expected / scale,
            outcome.drift,
            outcome.accepted,
            time.perf_counter() - clock,
        )
        decrease = (at.records[-1].objective - reached) / scale
        status = _status(record, decrease, most, tolerance)
        steps = in_order([at.steps, outcome.steps])
        at = Checkpoint(number, population, steps, (*at.records, record), status)
        if callbacks.save is not None:
            callbacks.save(at)
        if callbacks.progress is not None:
            callbacks.progress(record)
    return at


def _status(
    record: SweepRecord, decrease: float, most: int, tolerance: float
) -> LevelStatus | None:
    """Return how a level ends with a sweep, None if it goes on."""
    small = record.gradient < tolerance
    if decrease < tolerance and (small or record.accepted == 0):
        return LevelStatus.CONVERGED if small else LevelStatus.STALLED
    return LevelStatus.SWEEP_LIMIT if record.sweep >= most else None
