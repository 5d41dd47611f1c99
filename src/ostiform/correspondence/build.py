"""From embedded shapes to the three models of the paper in one run (HY 2.3, 3; design 5, 6)."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.correspondence.alignment import align
from ostiform.correspondence.checkpoint import Callbacks, Checkpoint, Population, Progress, Save
from ostiform.correspondence.fields import circle_table
from ostiform.correspondence.frozen import FrozenLevel, FrozenModel
from ostiform.correspondence.hierarchy import (
    REPEATS,
    LevelResult,
    Problem,
    euclidean_level,
    first_population,
    optimal_levels,
)
from ostiform.correspondence.level import coarse_template
from ostiform.correspondence.lloyd import MOST_FREEZES, relaxed, squeezed_points
from ostiform.correspondence.mean_template import population_template
from ostiform.correspondence.sampling import ShapeSampler, sample
from ostiform.correspondence.settings import CorrespondenceSettings
from ostiform.correspondence.shapes import GivenShapes, Shapes, as_shapes, sampled
from ostiform.correspondence.sweeps import area_shares
from ostiform.correspondence.terms.coherence import coherence_about, coherence_form
from ostiform.correspondence.terms.description_length import (
    cut_off_eigenvalue,
    description_length,
    majoriser,
    spectrum,
)
from ostiform.correspondence.terms.distance import euclidean_form, root_mean_square_spread
from ostiform.correspondence.terms.landmarks import template_marks
from ostiform.correspondence.terms.metric import metric_term, with_reference
from ostiform.correspondence.terms.quadratic_form import QuadraticForm
from ostiform.correspondence.trained import Kind, SharedMetric, TrainedCorrespondence
from ostiform.correspondence.types import Correspondence
from ostiform.correspondence.warp import Warp, Warps, carried
from ostiform.domain import BaseDomain, Template
from ostiform.errors import InputError
from ostiform.study import ShapeId
from ostiform.surface import median_edge_length

# Noise per coordinate of a surface whose noise is not stated, over the median edge of its mesh.
NOISE_OVER_EDGE = 0.2


def build_shared_metric(
    shapes: GivenShapes,
    ids: Sequence[ShapeId],
    domain: BaseDomain,
    poses: FloatArray,
    settings: CorrespondenceSettings,
) -> SharedMetric:
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
    return shared_metric_of_template(shapes, ids, domain, template, settings)


def shared_metric_of_template(
    shapes: GivenShapes,
    ids: Sequence[ShapeId],
    domain: BaseDomain,
    template: Template,
    settings: CorrespondenceSettings,
) -> SharedMetric:
    """Fix weights, alignment and l_cut from the conformal sampling of a given template.

    Parameters and errors are those of `build_shared_metric`.
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
    return SharedMetric(
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
    shared: SharedMetric,
    settings: CorrespondenceSettings,
    progress: Progress | None = None,
    *,
    resumed: Sequence[Checkpoint] = (),
    save: Save | None = None,
) -> Mapping[Kind, TrainedCorrespondence]:
    """Return the three models of `corresponded`, by kind."""
    models = corresponded(shapes, ids, shared, settings, progress, resumed=resumed, save=save)
    return {model.kind: model for model in models}


def corresponded(
    shapes: GivenShapes,
    ids: Sequence[ShapeId],
    shared: SharedMetric,
    settings: CorrespondenceSettings,
    progress: Progress | None = None,
    *,
    resumed: Sequence[Checkpoint] = (),
    save: Save | None = None,
    surveyed: int | None = None,
) -> Iterator[TrainedCorrespondence]:
    """Build the conformal, the minimum-Euclidean and the optimal model in one run, one by one.

    Each starts from the one before. The objective is evaluated on a coarse level of the template;
    all points are carried along by the same warps.

    Parameters
    ----------
    shapes : Shapes or sequence of ShapeSampler
    ids : sequence of ShapeId
    shared : SharedMetric
        Of the same shapes.
    settings : CorrespondenceSettings
    progress : callable, optional
        Called with a `SweepRecord` after every sweep.
    resumed : sequence of Checkpoint, optional
        Where an interrupted run on the same input stood: its levels from the first, all but the
        last one ended. The result is that of a run without interruption, bit for bit.
    save : callable, optional
        Called with the `Checkpoint` after every sweep, the last of each level with its status.
    surveyed : int, optional
        Shapes, at equal intervals, that the points are relaxed to cover at the end; all by default.

    Raises
    ------
    InputError
        If there are fewer than two shapes, the numbers of shapes and ids differ, or the levels
        resumed are not of this population.
    """
    _check_population(shapes, ids)
    problem = _problem(as_shapes(shapes), shared, settings)
    _check_resumed(resumed, problem)
    callbacks = Callbacks(progress, save, {level.level: level for level in resumed})
    template_points = np.broadcast_to(
        shared.template.points, (len(ids), *shared.template.points.shape)
    )
    population = first_population(problem, template_points)
    yield _trained("conformal", problem, template_points, ids, shared, ())
    first, population = euclidean_level(problem, population, callbacks)
    yield _trained("euclidean", problem, _directions(population), ids, shared, (first,))
    finer, population = optimal_levels(problem, population, callbacks)
    results = (first, *finer)
    start = problem.template, _directions(population)
    del population
    template, directions = _relaxed(problem, start, _warps(ids, results), surveyed or len(ids))
    yield _trained(
        "optimal",
        _on_template(problem, template),
        directions,
        ids,
        replace(shared, template=template),
        results,
    )


def _relaxed(
    problem: Problem, first: tuple[Template, FloatArray], warps: Warps, most: int
) -> tuple[Template, FloatArray]:
    """Return the template with its points relaxed in common, and where the warps carry them.

    They are relaxed to cover so many shapes at most. Points at the corners of triangles that come
    out squeezed are put back.
    """
    count = len(warps.ids)
    chosen = np.linspace(0, count - 1, min(most, count)).round().astype(int).tolist()
    template = relaxed(
        problem.shapes.chosen(chosen), problem.template, problem.circles, first[1][chosen]
    )[0]
    if template is problem.template:
        return first
    each = [warps.at(index) for index in range(count)]
    moved = np.stack(problem.shapes.each(_carried, each, template))
    for _ in range(MOST_FREEZES):
        squeezed = squeezed_points(first, (template.points, moved))
        if not squeezed.any():
            return template, moved
        back = squeezed[:, None]
        template = replace(template, points=np.where(back, first[0].points, template.points))
        moved = np.where(back, first[1], moved)
    return first


def _carried(_shape: ShapeSampler, warp: Warp, template: Template) -> FloatArray:
    return carried(warp, template.points, template.sphere, template.curve)


def _warps(ids: Sequence[ShapeId], results: Sequence[LevelResult]) -> Warps:
    bases = tuple(result.basis for result in results)
    return Warps(tuple(ids), bases, tuple(result.steps for result in results))


def _check_population(shapes: GivenShapes, ids: Sequence[ShapeId]) -> None:
    if len(shapes) != len(ids) or len(ids) < 2:
        raise InputError(
            "correspondence: expected at least 2 shapes and one sampler per shape, found "
            f"{len(ids)} shapes and {len(shapes)} samplers"
        )


def _check_resumed(resumed: Sequence[Checkpoint], problem: Problem) -> None:
    n_shapes, n_points, n_coarse = (
        len(problem.shapes),
        len(problem.template.points),
        len(problem.coarse.points),
    )
    for number, state in enumerate(resumed, start=1):
        is_ended = state.status is not None or number == len(resumed)
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
    meshes = [part.component for part in shape.components]
    edges = [median_edge_length(mesh.vertices, mesh.faces) for mesh in meshes]
    return sample(shape, template, template.points), edges


def _problem(shapes: Shapes, shared: SharedMetric, settings: CorrespondenceSettings) -> Problem:
    template = shared.template
    coarse, index = coarse_template(template, settings.n_optimised)
    points = np.stack(shapes.each(sampled, [coarse.points] * len(shapes), coarse))
    weights = area_shares(points, coarse.faces).mean(axis=0)
    weights /= weights.sum()
    aligned = align(points, weights, shared.alignment, shared.groups).aligned
    metric = metric_term(coarse, aligned.mean(axis=0), settings.metric)
    unit_mm = settings.euclidean_noise_mm
    if unit_mm is None:
        unit_mm = max(root_mean_square_spread(aligned, weights), shared.noise_mm)
    return Problem(
        shapes=shapes,
        template=template,
        coarse=coarse,
        index=index,
        weights=weights,
        circles=circle_table(shared.domain, template),
        groups=shared.groups,
        metric=with_reference(metric, points),
        l_cut=shared.l_cut,
        start_length=description_length(aligned, weights, shared.l_cut),
        unit_mm=unit_mm,
        settings=settings,
        marks=template_marks(shapes, coarse),
    )


def _on_template(problem: Problem, template: Template) -> Problem:
    """Return the problem of the same triangles with their points elsewhere."""
    coarse, index = coarse_template(template, problem.settings.n_optimised)
    marks = template_marks(problem.shapes, coarse)
    return replace(problem, template=template, coarse=coarse, index=index, marks=marks)


def _directions(population: Population) -> FloatArray:
    return np.stack([state.directions for state in population.states])


def _trained(
    kind: Kind,
    problem: Problem,
    directions: FloatArray,
    ids: Sequence[ShapeId],
    shared: SharedMetric,
    results: Sequence[LevelResult],
) -> TrainedCorrespondence:
    points = np.stack(problem.shapes.each(sampled, list(directions), shared.template))
    alignment = align(points, shared.weights, shared.alignment, shared.groups)
    correspondence = Correspondence(
        template=shared.template,
        ids=tuple(ids),
        directions=directions,
        points=points,
        aligned=alignment.aligned,
        transforms=alignment.transforms,
        weights=shared.weights,
    )
    coarse = alignment.aligned[:, problem.index]  # (N, Q, 3)
    settings = problem.settings
    frozen = FrozenModel(
        template=shared.template,
        n_optimised=settings.n_optimised,
        weights=shared.weights,
        mean=alignment.mean,
        coarse_weights=problem.weights,
        stretch=settings.stretch,
        offset=settings.offset,
        metric=with_reference(problem.metric, coarse),
        marks=problem.marks,
        alignment=shared.alignment,
        jointly=settings.per == "subject",
        ids=tuple(ids),
        transforms=alignment.transforms,
        levels=_frozen_levels(problem, coarse, results),
    )
    return TrainedCorrespondence(
        kind=kind,
        correspondence=correspondence,
        shared_metric=shared,
        frozen=frozen,
        warps=_warps(ids, results),
        history=tuple(record for result in results for record in result.records),
        statuses=tuple(result.status for result in results if result.status is not None),
        coherence=results[-1].coherence if results else 0.0,
        interior=results[-1].interior if results else None,
        boundary=results[-1].boundary if results else None,
    )


def _frozen_levels(
    problem: Problem, aligned: FloatArray, results: Sequence[LevelResult]
) -> tuple[FrozenLevel, ...]:
    """Return the levels of further shapes: the distance to the mean, then what W and B charge."""
    found = spectrum(aligned, problem.weights)
    nearest = euclidean_form(found.mean, problem.weights, problem.unit_mm**2)
    forms: list[dict[str, QuadraticForm]] = [{"distance": nearest}]
    if len(results) > 1:
        smooth = coherence_about(found.mean, problem.weights, 1.0)
    for result in results[1:]:
        coherence = replace(smooth, strength=result.coherence * smooth.strength)
        forms.append(
            {
                "length": majoriser(found, problem.weights, result.l_cut),
                "coherence": coherence_form(coherence, found.mean),
            }
        )
    return tuple(
        FrozenLevel(result.basis, own) for result, own in zip(results, forms, strict=False)
    )
