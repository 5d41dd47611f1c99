"""Placing shapes that a model was not built from: warps against the frozen model (design 6)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from ostiform.arrays import FloatArray, frozen_floats
from ostiform.correspondence.alignment import AlignmentMode, align_to
from ostiform.correspondence.description_length import QuadraticForm
from ostiform.correspondence.landmarks import landmark_term
from ostiform.correspondence.sampling import ShapeSampler, sample
from ostiform.correspondence.shape_step import (
    ShapeGoal,
    WarpLevel,
    WarpState,
    advance,
    objective,
    propose,
    start,
)
from ostiform.correspondence.trained import TrainedCorrespondence
from ostiform.errors import InputError


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
    """

    directions: FloatArray
    points: FloatArray
    transforms: FloatArray

    def __post_init__(self) -> None:
        """Check the arrays and make them read-only."""
        for name, shape in (
            ("directions", (None, None, 3)),
            ("points", (None, None, 3)),
            ("transforms", (None, 4, 4)),
        ):
            object.__setattr__(self, name, frozen_floats(getattr(self, name), shape, name))


def place(
    samplers: Sequence[ShapeSampler],
    trained: TrainedCorrespondence,
    *,
    jointly: bool = True,
    transform: FloatArray | None = None,
    sweeps: int = 8,
    tolerance: float = 1e-3,
) -> Placed:
    """Bring left-out shapes into correspondence with a frozen model.

    Conformal: no warp. Euclidean: level 1 towards the training mean. Optimal: the same, then
    ``y^T W y`` plus the penalty through the finer levels, W of the training set.

    Parameters
    ----------
    samplers : sequence of ShapeSampler
        The phases of one subject when they are aligned jointly.
    trained : TrainedCorrespondence
    jointly : bool
        One transform for all shapes, so that motion is not aligned away; else one each.
    transform : (4, 4) float64, optional
        From input coordinates to the model's frame, where it is known because the model was built
        from other phases of the subject: a fit to some phases alone would align motion away.
    sweeps : int
        Most sweeps per level.
    tolerance : float
        Relative decrease of the objective at which a level ends.

    Raises
    ------
    InputError
        If there is no shape.
    """
    if not samplers:
        raise InputError("placing shapes in a model: expected at least one shape, found none")
    template = trained.yardstick.template
    directions = np.broadcast_to(template.points, (len(samplers), *template.points.shape))
    to_mean: Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
    if transform is None:
        to_mean = partial(_fitted, jointly=jointly, mode=trained.yardstick.alignment)
    else:
        to_mean = partial(_known, transform=transform)
    for level, form in zip(trained.levels, trained.forms, strict=True):
        states = tuple(
            start(shape, level, own) for shape, own in zip(samplers, directions, strict=True)
        )
        states = _swept(samplers, states, level, form, to_mean, (sweeps, tolerance))
        directions = np.stack([state.directions for state in states])
    points = np.stack(
        [sample(shape, template, own) for shape, own in zip(samplers, directions, strict=True)]
    )
    transforms = to_mean(points, trained.mean, trained.yardstick.weights)
    return Placed(directions, points, transforms)


def _fitted(
    points: FloatArray,
    target: FloatArray,
    weights: FloatArray,
    *,
    jointly: bool,
    mode: AlignmentMode,
) -> FloatArray:
    """Return transforms (n, 4, 4) of shapes (n, P, 3) onto a target (P, 3)."""
    if jointly:
        shared = align_to(points, target, weights, mode)
        return np.broadcast_to(shared, (len(points), 4, 4))
    return np.stack([align_to(shape[None], target, weights, mode) for shape in points])


def _known(
    points: FloatArray, target: FloatArray, weights: FloatArray, *, transform: FloatArray
) -> FloatArray:
    """Return the transform of the subject for every shape, whatever the points."""
    return np.broadcast_to(transform, (len(points), 4, 4))


def _swept(
    samplers: Sequence[ShapeSampler],
    states: tuple[WarpState, ...],
    level: WarpLevel,
    form: QuadraticForm,
    to_mean: Callable[[FloatArray, FloatArray, FloatArray], FloatArray],
    limits: tuple[int, float],
) -> tuple[WarpState, ...]:
    """Return the states after the sweeps of one level against the frozen form."""
    most, tolerance = limits
    goals = [
        ShapeGoal(form, level.metric, landmark_term(level.marks, sampler.marks))
        for sampler in samplers
    ]
    weights = form.root_weights**2
    before = np.inf
    for _ in range(most):
        transforms = to_mean(np.stack([state.landmarks for state in states]), form.target, weights)
        value = sum(
            objective(state, level, goal, transform)
            for state, goal, transform in zip(states, goals, transforms, strict=True)
        )
        if before - value < tolerance * value:
            break
        before = value
        advanced = []
        for sampler, state, goal, transform in zip(
            samplers, states, goals, transforms, strict=True
        ):
            step = propose(sampler, state, level, goal, transform).coefficients
            advanced.append(advance(sampler, state, level, goal, transform, step)[0])
        states = tuple(advanced)
    return states
