"""From coarse to fine: level 1 is Euclidean, the later levels minimise the description length."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.correspondence.alignment import align
from ostiform.correspondence.coherence import (
    Coherence,
    coherence_about,
    coherence_form,
    coherence_value,
    joined_forms,
)
from ostiform.correspondence.conjugate_gradient import conjugate_gradient_sweep
from ostiform.correspondence.control_points import (
    ControlPoints,
    basis_of,
    boundary_control_points,
    insert_interior,
    no_control_points,
)
from ostiform.correspondence.description_length import (
    QuadraticForm,
    description_length,
    majoriser,
    spectrum,
)
from ostiform.correspondence.euclidean import (
    euclidean_forms,
    euclidean_value,
    medoid,
    root_mean_square_spread,
)
from ostiform.correspondence.landmarks import LandmarkTerm, TemplateMarks, landmark_term
from ostiform.correspondence.metric import MetricTerm
from ostiform.correspondence.penalty import displacement_penalty
from ostiform.correspondence.settings import CorrespondenceSettings
from ostiform.correspondence.shape_step import WarpLevel, WarpState, warp_level
from ostiform.correspondence.shapes import Shapes, marks_of, sampled
from ostiform.correspondence.sweeps import (
    Journal,
    LevelStatus,
    Population,
    SweepObjective,
    SweepOutcome,
    SweepRecord,
    area_shares,
    batched_sweep,
    current_metric,
    joint_sweep,
    realigned,
    run_sweeps,
)
from ostiform.correspondence.warps import FieldBasis
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
        See `warps.circle_table`.
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
    population : Population
    level : WarpLevel
        With the fields of the level, to place further shapes.
    interior, boundary : ControlPoints
    l_cut : float
        The level's own cut-off, mm^2.
    coherence : float
        Strength of the level's coherence term.
    records : tuple of SweepRecord
    status : LevelStatus
    """

    population: Population
    level: WarpLevel
    interior: ControlPoints
    boundary: ControlPoints
    l_cut: float
    coherence: float
    records: tuple[SweepRecord, ...]
    status: LevelStatus


def coarse_template(template: Template, least: int) -> tuple[Template, IntArray]:
    """Return the coarsest level of a template with at least so many points, and their indices.

    The whole template where no level has as many.
    """
    for level in template.levels:
        if least <= len(level.index) < len(template.points):
            index = level.index
            coarse = Template(
                points=template.points[index],
                sphere=template.sphere[index],
                part=template.part[index],
                faces=level.faces,
                face_part=level.face_part,
                parts=template.parts,
                curve=template.curve[index],
                curves=template.curves,
                loops={},
            )
            return coarse, index
    return template, np.arange(len(template.points))


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


def euclidean_level(problem: Problem, population: Population, journal: Journal) -> LevelResult:
    """Return level 1: every shape as near as its penalty allows to the medoid.

    The fields are few and smooth: six conformal fields per sphere (rotations and boosts, cut off
    at the circles) and the sliding of every circle as a whole.
    """
    control = no_control_points(), boundary_control_points(problem.circles, 1)
    reference = medoid(population.aligned, problem.weights)

    def forms(aligned: FloatArray) -> tuple[QuadraticForm, ...]:
        shares = area_shares(aligned, problem.coarse.faces)
        return euclidean_forms(aligned, shares, reference, problem.unit_mm)

    def take(current: Population, level: WarpLevel) -> tuple[Population, SweepOutcome]:
        metric = current_metric(current, level)
        return joint_sweep(problem.shapes, current, level, forms(current.aligned), metric)

    def value(aligned: FloatArray) -> float:
        return euclidean_value(forms(aligned), aligned)

    objective = SweepObjective(value, take, _realigner(problem, value))
    labels = ("euclidean", 1)
    return _swept(problem, population, control, labels, objective, (problem.l_cut, 0.0), journal)


def optimal_levels(
    problem: Problem, population: Population, journal: Journal
) -> tuple[LevelResult, ...]:
    """Return levels 2 and finer: the description length of the whole set and its coherence.

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
                for level in range(2, settings.levels + 1):
                    interior = insert_interior(interior, problem.coarse, mean_shape, level)
            else:
                break
        if number in journal.begun:
            for _ in range(journal.begun[number].sweeps):
                rng.permutation(len(problem.shapes))  # drawn by the sweeps of the earlier run
        coherence = coherence_about(mean_shape, problem.weights, strength)
        result = _swept(
            problem,
            population,
            (interior, boundary),
            ("optimal", number),
            _length_objective(problem, l_cut, coherence, rng),
            (l_cut, strength),
            journal,
        )
        population = result.population
        results.append(result)
    return tuple(results)


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
    problem: Problem, l_cut: float, coherence: Coherence, rng: np.random.Generator
) -> SweepObjective:
    def value(aligned: FloatArray) -> float:
        length = description_length(aligned, problem.weights, l_cut)
        return length + coherence_value(coherence, aligned)

    def form_of(current: Population) -> QuadraticForm:
        form = majoriser(spectrum(current.aligned, problem.weights), problem.weights, l_cut)
        return joined_forms(form, coherence_form(coherence, form.target))

    def majorise(current: Population, level: WarpLevel) -> tuple[Population, SweepOutcome]:
        batches = sweep_batches(len(current.states), problem.settings.batch, rng)
        return batched_sweep(problem.shapes, current, level, form_of, batches)

    def descend(current: Population, level: WarpLevel) -> tuple[Population, SweepOutcome]:
        return conjugate_gradient_sweep(problem.shapes, current, level, l_cut, coherence, rng)

    take = majorise if problem.settings.optimiser == "majorise" else descend
    return SweepObjective(value, take, _realigner(problem, value))


def level_of(problem: Problem, basis: FieldBasis) -> WarpLevel:
    """Return what shapes share at a level whose fields are given; without their own landmarks."""
    settings = problem.settings
    penalty = displacement_penalty(
        problem.coarse, problem.weights, settings.stretch, settings.offset
    )
    return warp_level(
        problem.template,
        problem.coarse,
        problem.index,
        basis,
        penalty,
        problem.metric,
        problem.marks,
    )


def _landmark_terms(problem: Problem) -> tuple[LandmarkTerm | None, ...]:
    if problem.marks is None:
        return ()
    own = problem.shapes.each(marks_of, [None] * len(problem.shapes), None)
    return tuple(landmark_term(problem.marks, of_shape) for of_shape in own)


def _realigner(
    problem: Problem, value: Callable[[FloatArray], float]
) -> Callable[[Population], Population]:
    def realign(current: Population) -> Population:
        return realigned(
            current, problem.weights, problem.settings.alignment, problem.groups, value
        )

    return realign


def _swept(
    problem: Problem,
    population: Population,
    control: tuple[ControlPoints, ControlPoints],
    labels: tuple[str, int],
    objective: SweepObjective,
    strengths: tuple[float, float],
    journal: Journal,
) -> LevelResult:
    """Return the result of a level; its cut-off and its coherence are noted with it."""
    n_spheres = int(problem.template.sphere.max()) + 1
    basis = basis_of(*control, problem.circles, n_spheres)
    level = replace(level_of(problem, basis), terms=_landmark_terms(problem))
    limits = (problem.settings.sweeps, problem.settings.tolerance)
    population, records, status = run_sweeps(population, level, objective, labels, limits, journal)
    return LevelResult(population, level, *control, *strengths, records, status)
