"""From embedded shapes to the three models of the paper in one run (HY 2.3, 3; design 5, 6)."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.correspondence.alignment import align
from ostiform.correspondence.coherence import coherence_about, coherence_form, joined_forms
from ostiform.correspondence.description_length import (
    QuadraticForm,
    cut_off_eigenvalue,
    description_length,
    euclidean_form,
    majoriser,
    spectrum,
)
from ostiform.correspondence.euclidean import root_mean_square_spread
from ostiform.correspondence.hierarchy import (
    REPEATS,
    LevelResult,
    Problem,
    coarse_template,
    euclidean_level,
    first_population,
    level_of,
    optimal_levels,
)
from ostiform.correspondence.landmarks import template_marks
from ostiform.correspondence.mean_template import population_template
from ostiform.correspondence.metric import metric_term, with_reference
from ostiform.correspondence.sampling import ShapeSampler, sample
from ostiform.correspondence.settings import CorrespondenceSettings
from ostiform.correspondence.shapes import GivenShapes, Shapes, as_shapes, sampled
from ostiform.correspondence.spreading import spread
from ostiform.correspondence.sweeps import Journal, Keep, LevelState, Progress, area_shares
from ostiform.correspondence.trained import Kind, TrainedCorrespondence, Yardstick
from ostiform.correspondence.types import Correspondence
from ostiform.correspondence.warps import circle_table
from ostiform.domain import BaseDomain, Template
from ostiform.errors import InputError
from ostiform.study import ShapeId
from ostiform.surface import median_edge_length

# Noise per coordinate of a surface whose noise is not stated, over the median edge of its mesh.
NOISE_OVER_EDGE = 0.2


def build_yardstick(
    shapes: GivenShapes,
    ids: Sequence[ShapeId],
    domain: BaseDomain,
    poses: FloatArray,
    settings: CorrespondenceSettings,
) -> Yardstick:
    """Build the template of a population and fix what its models are measured with.

    Parameters
    ----------
    shapes : Shapes or sequence of ShapeSampler
    ids : sequence of ShapeId
        As many, in study order.
    domain : BaseDomain
    poses : (N, 4, 4) float64
        From input coordinates to the population's common pose.
    settings : CorrespondenceSettings

    Raises
    ------
    InputError
        If there are fewer than two shapes or the numbers of shapes and ids differ.
    """
    _check_population(shapes, ids)
    template = population_template(shapes, domain, settings.n_points, poses)
    return yardstick_of_template(shapes, ids, domain, template, settings)


def yardstick_of_template(
    shapes: GivenShapes,
    ids: Sequence[ShapeId],
    domain: BaseDomain,
    template: Template,
    settings: CorrespondenceSettings,
) -> Yardstick:
    """Fix weights, alignment and l_cut from the conformal sampling of a given template.

    Parameters and errors are those of `build_yardstick`.
    """
    _check_population(shapes, ids)
    surveyed = as_shapes(shapes).each(_surveyed, [None] * len(ids), template)
    points = np.stack([own for own, _ in surveyed])  # (N, P, 3)
    weights = area_shares(points, template.faces).mean(axis=0)
    weights /= weights.sum()
    noise_mm = settings.noise_mm
    if noise_mm is None:
        edges = [edge for _, of_shape in surveyed for edge in of_shape]
        noise_mm = NOISE_OVER_EDGE * float(np.median(edges))
    return Yardstick(
        domain=domain,
        template=template,
        weights=weights,
        noise_mm=noise_mm,
        l_cut=cut_off_eigenvalue(noise_mm, len(ids), len(template.points)),
        alignment=settings.alignment,
        groups=_groups(ids, settings),
    )


def correspond(
    shapes: GivenShapes,
    ids: Sequence[ShapeId],
    yardstick: Yardstick,
    settings: CorrespondenceSettings,
    progress: Progress | None = None,
    *,
    begun: Sequence[LevelState] = (),
    keep: Keep | None = None,
) -> Mapping[Kind, TrainedCorrespondence]:
    """Build the conformal, the minimum-Euclidean and the optimal model in one run.

    Each starts from the one before. The objective is evaluated on a coarse level of the template;
    all points are carried along by the same warps.

    Parameters
    ----------
    shapes : Shapes or sequence of ShapeSampler
    ids : sequence of ShapeId
    yardstick : Yardstick
        Of the same shapes.
    settings : CorrespondenceSettings
    progress : callable, optional
        Called with a `SweepRecord` after every sweep.
    begun : sequence of LevelState, optional
        Where an interrupted run on the same input stood: its levels from the first, all but the
        last one ended. The result is that of a run without interruption, bit for bit.
    keep : callable, optional
        Called with the `LevelState` after every sweep, the last of each level with its status.

    Raises
    ------
    InputError
        If there are fewer than two shapes, the numbers of shapes and ids differ, or the levels
        begun are not of this population.
    """
    _check_population(shapes, ids)
    problem = _problem(as_shapes(shapes), yardstick, settings)
    _check_begun(begun, problem)
    journal = Journal(progress, keep, {state.level: state for state in begun})
    template_points = np.broadcast_to(
        yardstick.template.points, (len(ids), *yardstick.template.points.shape)
    )
    population = first_population(problem, template_points)
    trained: dict[Kind, TrainedCorrespondence] = {
        "conformal": _trained("conformal", problem, template_points, ids, yardstick, ())
    }
    first = euclidean_level(problem, population, journal)
    population = first.population
    trained["euclidean"] = _trained(
        "euclidean", problem, _directions(first), ids, yardstick, (first,)
    )
    results = (first, *optimal_levels(problem, population, journal))
    template, directions = spread(
        problem.shapes, yardstick.template, problem.circles, _directions(results[-1])
    )
    trained["optimal"] = _trained(
        "optimal",
        _on_template(problem, template),
        directions,
        ids,
        replace(yardstick, template=template),
        results,
    )
    return trained


def _check_population(shapes: GivenShapes, ids: Sequence[ShapeId]) -> None:
    if len(shapes) != len(ids) or len(ids) < 2:
        raise InputError(
            "correspondence: expected at least 2 shapes and one sampler per shape, found "
            f"{len(ids)} shapes and {len(shapes)} samplers"
        )


def _check_begun(begun: Sequence[LevelState], problem: Problem) -> None:
    n_shapes, n_points, n_coarse = (
        len(problem.shapes),
        len(problem.template.points),
        len(problem.coarse.points),
    )
    for number, state in enumerate(begun, start=1):
        is_ended = state.status is not None or number == len(begun)
        fits = len(state.population.states) == n_shapes and all(
            len(one.directions) == n_points and len(one.landmarks) == n_coarse
            for one in state.population.states
        )
        most = problem.settings.levels + REPEATS
        if state.level != number or number > most or not is_ended or not fits:
            raise InputError(
                f"correspondence: expected to go on from levels 1 to {problem.settings.levels} of "
                f"{n_shapes} shapes with {n_points} points, found level {state.level} of "
                f"{len(state.population.states)} shapes of another run; begin afresh"
            )


def _groups(ids: Sequence[ShapeId], settings: CorrespondenceSettings) -> IntArray:
    if settings.per == "shape":
        return np.arange(len(ids))
    names = list(dict.fromkeys(id.subject for id in ids))
    return np.array([names.index(id.subject) for id in ids], dtype=np.int64)


def _surveyed(
    shape: ShapeSampler, _item: None, template: Template
) -> tuple[FloatArray, list[float]]:
    """Return the conformal sampling (P, 3) of a shape and the median edges of its components."""
    edges = [median_edge_length(part.vertices, part.faces) for part in shape.components]
    return sample(shape, template, template.points), edges


def _problem(shapes: Shapes, yardstick: Yardstick, settings: CorrespondenceSettings) -> Problem:
    template = yardstick.template
    coarse, index = coarse_template(template, settings.n_optimised)
    points = np.stack(shapes.each(sampled, [coarse.points] * len(shapes), coarse))
    weights = area_shares(points, coarse.faces).mean(axis=0)
    weights /= weights.sum()
    aligned = align(points, weights, yardstick.alignment, yardstick.groups).aligned
    metric = metric_term(coarse, aligned.mean(axis=0), settings.metric)
    unit_mm = settings.euclidean_noise_mm
    if unit_mm is None:
        unit_mm = max(root_mean_square_spread(aligned, weights), yardstick.noise_mm)
    return Problem(
        shapes=shapes,
        template=template,
        coarse=coarse,
        index=index,
        weights=weights,
        circles=circle_table(yardstick.domain, template),
        groups=yardstick.groups,
        metric=with_reference(metric, points),
        l_cut=yardstick.l_cut,
        start_length=description_length(aligned, weights, yardstick.l_cut),
        unit_mm=unit_mm,
        settings=settings,
        marks=template_marks(shapes, coarse),
    )


def _on_template(problem: Problem, template: Template) -> Problem:
    """Return the problem of the same triangles with their points elsewhere."""
    coarse, index = coarse_template(template, problem.settings.n_optimised)
    marks = template_marks(problem.shapes, coarse)
    return replace(problem, template=template, coarse=coarse, index=index, marks=marks)


def _directions(result: LevelResult) -> FloatArray:
    return np.stack([state.directions for state in result.population.states])


def _trained(
    kind: Kind,
    problem: Problem,
    directions: FloatArray,
    ids: Sequence[ShapeId],
    yardstick: Yardstick,
    results: Sequence[LevelResult],
) -> TrainedCorrespondence:
    points = np.stack(problem.shapes.each(sampled, list(directions), yardstick.template))
    alignment = align(points, yardstick.weights, yardstick.alignment, yardstick.groups)
    correspondence = Correspondence(
        template=yardstick.template,
        ids=tuple(ids),
        directions=directions,
        points=points,
        aligned=alignment.aligned,
        transforms=alignment.transforms,
        weights=yardstick.weights,
    )
    found = spectrum(alignment.aligned, yardstick.weights)
    strong = found.eigenvalues > yardstick.l_cut
    coarse = alignment.aligned[:, problem.index]  # (N, Q, 3)
    metric = with_reference(problem.metric, coarse)
    return TrainedCorrespondence(
        kind=kind,
        correspondence=correspondence,
        yardstick=yardstick,
        mean=alignment.mean,
        eigenvalues=found.eigenvalues[strong],
        modes=found.modes[strong],
        levels=tuple(
            level_of(replace(problem, metric=metric), result.level.basis) for result in results
        ),
        forms=_placing_forms(problem, coarse, results),
        history=tuple(record for result in results for record in result.records),
        statuses=tuple(result.status for result in results),
        coherence=results[-1].coherence if results else 0.0,
        interior=results[-1].interior if results else None,
        boundary=results[-1].boundary if results else None,
    )


def _placing_forms(
    problem: Problem, aligned: FloatArray, results: Sequence[LevelResult]
) -> tuple[QuadraticForm, ...]:
    """Return what a further shape minimises: the distance to the mean, then ``y^T W y``.

    W is that of the majoriser and the coherence term together.
    """
    found = spectrum(aligned, problem.weights)
    nearest = euclidean_form(found.mean, problem.weights, problem.unit_mm**2)
    shortest = []
    for result in results[1:]:
        coherence = coherence_about(found.mean, problem.weights, result.coherence)
        form = majoriser(found, problem.weights, result.l_cut)
        shortest.append(joined_forms(form, coherence_form(coherence, found.mean)))
    return (nearest, *shortest)[: len(results)]
