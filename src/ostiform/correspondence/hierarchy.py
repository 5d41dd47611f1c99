"""From coarse to fine: level 1 is Euclidean, the later levels minimise the description length."""

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
from ostiform.correspondence.conjugate_gradient import conjugate_gradient_sweep
from ostiform.correspondence.control_points import (
    ControlPoints,
    basis_of,
    boundary_control_points,
    insert_interior,
    no_control_points,
)
from ostiform.correspondence.fields import FieldBasis
from ostiform.correspondence.level import WarpLevel, warp_level
from ostiform.correspondence.objective import Terms, population_values, shape_terms
from ostiform.correspondence.sampling import SurfaceMarks
from ostiform.correspondence.settings import CorrespondenceSettings
from ostiform.correspondence.shapes import Shapes, marks_of, sampled
from ostiform.correspondence.state import WarpState
from ostiform.correspondence.sweeps import (
    SweepObjective,
    SweepOutcome,
    area_shares,
    batched_sweep,
    current_metric,
    joint_sweep,
    realigned,
    run_sweeps,
)
from ostiform.correspondence.terms.coherence import (
    Coherence,
    coherence_about,
    coherence_form,
    coherence_value,
)
from ostiform.correspondence.terms.description_length import (
    description_length,
    majoriser,
    spectrum,
)
from ostiform.correspondence.terms.distance import (
    euclidean_forms,
    euclidean_value,
    medoid,
    root_mean_square_spread,
)
from ostiform.correspondence.terms.landmarks import TemplateMarks
from ostiform.correspondence.terms.metric import MetricTerm
from ostiform.correspondence.terms.quadratic_form import QuadraticForm
from ostiform.correspondence.warp import Steps
from ostiform.domain import Template

REPEATS = 5
"""How often the finest level is done again at most."""

LONGEST, RELIEF = 0.995, 0.6
"""Above this share of the conformal start's description length it is, with so much coherence."""

POOR_START = 0.86
"""Below this share it is, once: the start was poor, and so the mean that points were placed on."""


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """What stays the same through all levels.

    Attributes
    ----------
    shapes : Shapes
    template, coarse : Template
        All P points, and the Q at which the objective is evaluated.
    index : (Q,) int64
        Of the coarse points in the template.
    weights : (Q,) float64
        Area shares of the coarse points in the conformal sampling, mean over the shapes.
    circles : (K, 8) float64
        See `fields.circle_table`.
    groups : (N,) int64
        Shapes that share a transform.
    metric : MetricTerm
        Referred to the mean of the conformal sampling.
    l_cut : float
        mm^2.
    start_length : float
        Description length of the conformal sampling at l_cut.
    unit_mm : float
        Of the distances of level 1.
    settings : CorrespondenceSettings
    marks : TemplateMarks or None
        Where the users' landmarks lie among the coarse points.
    """

    shapes: Shapes
    template: Template
    coarse: Template
    index: IntArray
    weights: FloatArray
    circles: FloatArray
    groups: IntArray
    metric: MetricTerm
    l_cut: float
    start_length: float
    unit_mm: float
    settings: CorrespondenceSettings
    marks: TemplateMarks | None = None


@dataclass(frozen=True, slots=True, eq=False)
class LevelResult:
    """What a level leaves behind.

    Attributes
    ----------
    steps : Steps
    records : tuple of SweepRecord
    status : LevelStatus or None
        As in `Checkpoint`, without its population: the next level begins with that.
    basis : FieldBasis
    interior, boundary : ControlPoints
    l_cut : float
        The level's own cut-off, mm^2.
    coherence : float
        Strength of the level's coherence term.
    """

    steps: Steps
    records: tuple[SweepRecord, ...]
    status: LevelStatus | None
    basis: FieldBasis
    interior: ControlPoints
    boundary: ControlPoints
    l_cut: float
    coherence: float


def first_population(problem: Problem, directions: FloatArray) -> Population:
    """Return shapes whose template points are at directions (N, P, 3), aligned."""
    landmarks = problem.shapes.each(
        sampled, [own[problem.index] for own in directions], problem.coarse
    )
    states = tuple(
        WarpState(own, points) for own, points in zip(directions, landmarks, strict=True)
    )
    identity = np.broadcast_to(np.eye(4), (len(states), 4, 4))
    population = Population(states, identity)
    mode = problem.settings.alignment
    found = align(population.landmarks, problem.weights, mode, problem.groups)
    return replace(population, transforms=found.transforms)


def euclidean_level(
    problem: Problem, population: Population, callbacks: Callbacks
) -> tuple[LevelResult, Population]:
    """Return level 1 and where it ends: every shape as near as its penalty allows to the medoid.

    The fields are few and smooth: six conformal fields per sphere (rotations and boosts, cut off
    at the circles) and the sliding of every circle as a whole.
    """
    control = no_control_points(), boundary_control_points(problem.circles, 1)
    reference = medoid(population.aligned, problem.weights)
    level = level_of(problem, _basis(problem, *control))

    def forms(aligned: FloatArray) -> tuple[QuadraticForm, ...]:
        shares = area_shares(aligned, problem.coarse.faces)
        return euclidean_forms(aligned, shares, reference, problem.unit_mm)

    def charged(aligned: FloatArray) -> dict[str, float]:
        return {"distance": euclidean_value(forms(aligned), aligned)}

    def take(current: Population) -> tuple[Population, SweepOutcome]:
        metric = current_metric(current, level)
        each = [{"distance": form} for form in forms(current.aligned)]
        return joint_sweep(problem.shapes, current, level, each, metric)

    objective = _objective(problem, level, charged, take)
    end = _swept(problem, population, level, ("euclidean", 1), objective, callbacks)
    left = LevelResult(
        end.steps, end.records, end.status, level.basis, *control, problem.l_cut, 0.0
    )
    return left, end.population


def optimal_levels(
    problem: Problem, population: Population, callbacks: Callbacks
) -> tuple[tuple[LevelResult, ...], Population]:
    """Return levels 2 and finer, and where they end: description length of all, and coherence.

    The cut-off is annealed over the levels: see `annealed_cut_offs`. Where the points of the
    finest level describe the shapes at greater length than those of the conformal start did,
    coherence has moved them against what the shapes say: the level is done again with less of it.
    Where they describe them far shorter, the mean surface has moved since the control points were
    placed on it: the level is done again with new ones.
    """
    settings = problem.settings
    rng = np.random.default_rng(settings.seed)
    spread = root_mean_square_spread(population.aligned, problem.weights)
    cut_offs = annealed_cut_offs(problem.l_cut, spread**2, settings.levels)
    results: list[LevelResult] = []
    interior = boundary = no_control_points()
    strength = settings.coherence
    for number in range(2, settings.levels + REPEATS + 1):
        mean_shape = population.aligned.mean(axis=0)
        if number <= settings.levels:
            l_cut = cut_offs[number - 2]
            interior = insert_interior(interior, problem.coarse, mean_shape, number)
            boundary = boundary_control_points(problem.circles, number)
        elif not results:
            break
        else:
            share = _length_over_start(problem, population)
            if strength > 0.0 and share > LONGEST:
                strength *= RELIEF
            elif number == settings.levels + 1 and share < POOR_START:
                interior = no_control_points()
                for depth in range(2, settings.levels + 1):
                    interior = insert_interior(interior, problem.coarse, mean_shape, depth)
            else:
                break
        if number in callbacks.resumed:
            for _ in range(callbacks.resumed[number].sweeps):
                rng.permutation(len(problem.shapes))  # drawn by the sweeps of the earlier run
        coherence = coherence_about(mean_shape, problem.weights, strength)
        level = level_of(problem, _basis(problem, interior, boundary))
        objective = _length_objective(problem, level, l_cut, coherence, rng)
        end = _swept(problem, population, level, ("optimal", number), objective, callbacks)
        population = end.population
        left = end.steps, end.records, end.status
        results.append(LevelResult(*left, level.basis, interior, boundary, l_cut, strength))
    return tuple(results), population


def _length_over_start(problem: Problem, population: Population) -> float:
    """Return the description length of a population over that of the conformal start."""
    length = description_length(population.aligned, problem.weights, problem.l_cut)
    return length / problem.start_length


def annealed_cut_offs(l_cut: float, variance: float, levels: int) -> tuple[float, ...]:
    """Return the cut-off (mm^2) of levels 2 to `levels`: geometric, from the variance to l_cut.

    With the cut-off at the total variance F is the variance itself, which pulls every shape
    towards the mean alike; lower cut-offs leave alone what the population's modes explain. The
    last level always has l_cut itself.

    Parameters
    ----------
    l_cut : float
        mm^2.
    variance : float
        Total variance per point before level 2, mm^2.
    levels : int
    """
    above = max(variance / l_cut, 1.0)
    count = levels - 1
    return tuple(l_cut * above ** ((count - 1 - k) / max(count - 1, 1)) for k in range(count))


def sweep_batches(
    n_shapes: int, size: int | None, rng: np.random.Generator
) -> tuple[tuple[int, ...], ...]:
    """Return the shapes in random batches of about one size; all in one, in order, for None."""
    order = rng.permutation(n_shapes)
    if size is None or size >= n_shapes:
        return (tuple(range(n_shapes)),)
    return tuple(
        tuple(int(index) for index in batch)
        for batch in np.array_split(order, -(-n_shapes // size))
    )


def _length_objective(
    problem: Problem,
    level: WarpLevel,
    l_cut: float,
    coherence: Coherence,
    rng: np.random.Generator,
) -> SweepObjective:
    def charged(aligned: FloatArray) -> dict[str, float]:
        return {
            "length": description_length(aligned, problem.weights, l_cut),
            "coherence": coherence_value(coherence, aligned),
        }

    def forms_of(current: Population) -> Terms:
        form = majoriser(spectrum(current.aligned, problem.weights), problem.weights, l_cut)
        return {"length": form, "coherence": coherence_form(coherence, form.target)}

    def majorise(current: Population) -> tuple[Population, SweepOutcome]:
        batches = sweep_batches(len(current.states), problem.settings.batch, rng)
        return batched_sweep(problem.shapes, current, level, forms_of, batches)

    def descend(current: Population) -> tuple[Population, SweepOutcome]:
        return conjugate_gradient_sweep(problem.shapes, current, level, l_cut, coherence, rng)

    take = majorise if problem.settings.optimiser == "majorise" else descend
    return _objective(problem, level, charged, take)


def _objective(
    problem: Problem,
    level: WarpLevel,
    charged: Callable[[FloatArray], dict[str, float]],
    take: Callable[[Population], tuple[Population, SweepOutcome]],
) -> SweepObjective:
    """Return the objective of a level, with what it charges aligned points (N, Q, 3) for."""
    nothing = [None] * len(problem.shapes)
    marks: Sequence[SurfaceMarks | None] = nothing
    if problem.marks is not None:
        marks = problem.shapes.each(marks_of, nothing, None)

    def values(current: Population) -> dict[str, float]:
        metric = current_metric(current, level)
        terms = [shape_terms({}, level, metric, own) for own in marks]
        others = population_values(terms, current.states, current.transforms)
        return {**charged(current.aligned), **others}

    def realign(current: Population) -> Population:
        return realigned(
            current,
            problem.weights,
            problem.settings.alignment,
            problem.groups,
            lambda aligned: sum(charged(aligned).values()),
        )

    return SweepObjective(values, take, realign)


def level_of(problem: Problem, basis: FieldBasis) -> WarpLevel:
    """Return what shapes share at a level whose fields are given."""
    settings = problem.settings
    return warp_level(
        problem.template,
        settings.n_optimised,
        problem.weights,
        basis,
        (settings.stretch, settings.offset),
        problem.metric,
        problem.marks,
    )


def _basis(problem: Problem, interior: ControlPoints, boundary: ControlPoints) -> FieldBasis:
    n_spheres = int(problem.template.sphere.max()) + 1
    return basis_of(interior, boundary, problem.circles, n_spheres)


def _swept(
    problem: Problem,
    population: Population,
    level: WarpLevel,
    labels: tuple[str, int],
    objective: SweepObjective,
    callbacks: Callbacks,
) -> Checkpoint:
    limits = (problem.settings.sweeps, problem.settings.tolerance)
    return run_sweeps(population, len(level.basis), objective, labels, limits, callbacks)
