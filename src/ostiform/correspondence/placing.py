"""Placing shapes that a model was not built from: warps against the frozen model (design 6)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from ostiform.arrays import FloatArray, frozen_floats
from ostiform.correspondence.alignment import align_to
from ostiform.correspondence.frozen import FrozenLevel, FrozenModel
from ostiform.correspondence.level import WarpLevel, warp_level
from ostiform.correspondence.objective import Terms, shape_terms, value
from ostiform.correspondence.sampling import ShapeSampler, sample
from ostiform.correspondence.shape_step import advance, propose, start
from ostiform.correspondence.shapes import GivenShapes, as_shapes
from ostiform.correspondence.state import WarpState
from ostiform.correspondence.warp import Step, Steps, Warps, side_by_side, steps_of
from ostiform.errors import InputError
from ostiform.study import ShapeId

SWEEPS, TOLERANCE = 8, 1e-3
"""Most sweeps per level, and the relative decrease of the objective at which a level ends."""


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """Shapes in correspondence with a model that was built without them.

    Attributes
    ----------
    directions : (n, P, 3) float64
    points : (n, P, 3) float64, mm
        In input coordinates.
    transforms : (n, 4, 4) float64
        From input coordinates to the model's frame.
    warps : Warps
    """

    directions: FloatArray
    points: FloatArray
    transforms: FloatArray
    warps: Warps

    def __post_init__(self) -> None:
        """Check the arrays and make them read-only."""
        for name, shape in (
            ("directions", (None, None, 3)),
            ("points", (None, None, 3)),
            ("transforms", (None, 4, 4)),
        ):
            object.__setattr__(self, name, frozen_floats(getattr(self, name), shape, name))


def place(shapes: GivenShapes, ids: Sequence[ShapeId], model: FrozenModel) -> Placed:
    """Bring shapes into correspondence with a model that was built without them.

    Conformal: no warp. Euclidean: level 1 towards the training mean. Optimal: the same, then
    ``y^T W y`` and the other terms through the finer levels, W of the training set.

    Where the model aligns the phases of a subject jointly they are placed jointly, and with the
    transform of the subject where the model has other phases of it.

    Parameters
    ----------
    shapes : Shapes or sequence of ShapeSampler
        n.
    ids : sequence of ShapeId
        As many.
    model : FrozenModel

    Raises
    ------
    InputError
        If there is no shape, or the numbers of shapes and ids differ.
    """
    if not ids or len(shapes) != len(ids):
        raise InputError(
            f"placing shapes in a model: expected at least one shape and its identity, found "
            f"{len(shapes)} and {len(ids)}"
        )
    kept = as_shapes(shapes)
    levels = [_level(model, own) for own in model.levels]
    placed, order = [], []
    for subject in dict.fromkeys(id.subject for id in ids):
        own = [index for index, id in enumerate(ids) if id.subject == subject]
        samplers = [kept.at(index) for index in own]
        placed.append(_placed(samplers, [ids[index] for index in own], model, levels, subject))
        order += own
    back = np.argsort(order)
    warps = placed[0].warps
    for further in placed[1:]:
        warps = side_by_side(warps, further.warps)
    return Placed(
        np.concatenate([one.directions for one in placed])[back],
        np.concatenate([one.points for one in placed])[back],
        np.concatenate([one.transforms for one in placed])[back],
        warps.chosen(back.tolist()),
    )


def _level(model: FrozenModel, level: FrozenLevel) -> WarpLevel:
    return warp_level(
        model.template,
        model.n_optimised,
        model.coarse_weights,
        level.basis,
        (model.stretch, model.offset),
        model.metric,
        model.marks,
    )


def _placed(
    samplers: Sequence[ShapeSampler],
    ids: Sequence[ShapeId],
    model: FrozenModel,
    levels: Sequence[WarpLevel],
    subject: str,
) -> Placed:
    """Return the shapes of one subject in correspondence."""
    template = model.template
    directions = np.broadcast_to(template.points, (len(samplers), *template.points.shape))
    fitted = partial(_transforms, model=model, known=model.transform_of(subject))
    steps: list[Steps] = []
    for own, level in zip(model.levels, levels, strict=True):
        states = [start(shape, level, at) for shape, at in zip(samplers, directions, strict=True)]
        terms = [shape_terms(own.forms, level, level.metric, shape.marks) for shape in samplers]
        form = next(iter(own.forms.values()))
        fit = partial(fitted, target=form.target, weights=form.root_weights**2)
        states, taken = _swept(samplers, states, level, terms, fit)
        steps.append(steps_of(taken, len(level.basis)))
        directions = np.stack([state.directions for state in states])
    points = np.stack(
        [sample(shape, template, own) for shape, own in zip(samplers, directions, strict=True)]
    )
    transforms = fitted(points, target=model.mean, weights=model.weights)
    warps = Warps(tuple(ids), tuple(level.basis for level in model.levels), tuple(steps))
    return Placed(directions, points, transforms, warps)


def _transforms(
    points: FloatArray,
    target: FloatArray,
    weights: FloatArray,
    *,
    model: FrozenModel,
    known: FloatArray | None,
) -> FloatArray:
    """Return transforms (n, 4, 4) of a subject's shapes (n, P, 3) onto a target (P, 3)."""
    if known is not None:
        return np.broadcast_to(known, (len(points), 4, 4))
    if model.jointly:
        shared = align_to(points, target, weights, model.alignment)
        return np.broadcast_to(shared, (len(points), 4, 4))
    each = [align_to(shape[None], target, weights, model.alignment) for shape in points]
    return np.stack(each)


def _swept(
    samplers: Sequence[ShapeSampler],
    states: list[WarpState],
    level: WarpLevel,
    terms: Sequence[Terms],
    fit: Callable[[FloatArray], FloatArray],
) -> tuple[list[WarpState], list[list[Step]]]:
    """Return the states after the sweeps of one level against frozen forms, and all steps."""
    before = np.inf
    taken: list[list[Step]] = [[] for _ in samplers]
    for _ in range(SWEEPS):
        transforms = fit(np.stack([state.landmarks for state in states]))
        reached = sum(
            value(own, state, transform)
            for own, state, transform in zip(terms, states, transforms, strict=True)
        )
        if before - reached < TOLERANCE * reached:
            break
        before = reached
        for shape, (sampler, state, own, transform) in enumerate(
            zip(samplers, states, terms, transforms, strict=True)
        ):
            wanted = propose(sampler, state, level, own, transform).coefficients
            states[shape], step = advance(sampler, state, level, own, transform, wanted)
            taken[shape].append(step)
    return states, taken
