"""A warp as a value: levels of fields with the coefficients of every step, evaluable anywhere.

A warp is composed: each accepted step carries points for unit time along the stationary velocity
that its coefficients give to the fields of its level, on top of the steps before. Flows do not
add up to one flow, so what is kept is the sequence of coefficients, from which the warp follows
bit for bit.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ostiform.arrays import FloatArray, IntArray, frozen_floats
from ostiform.correspondence.fields import FieldBasis, flow
from ostiform.errors import InputError
from ostiform.study import ShapeId
from ostiform.values import Axes, value

# Radians from a circle at which a direction is on it.
ON_CIRCLE = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """One step of one shape.

    Attributes
    ----------
    coefficients : (D,) float64
        Of the level's fields, radians per unit time; all 0 where no step was taken.
    fastest : float
        Greatest speed of the optimiser's points at the start, which sets how finely the flow is
        integrated, radians per unit time.
    """

    coefficients: FloatArray
    fastest: float


@value
class Steps:
    """The steps of N shapes at one level, in order; a shape that took fewer has zeros.

    Attributes
    ----------
    coefficients : (S, N, D) float64
        See `Step`.
    fastest : (S, N) float64
    """

    coefficients: Annotated[FloatArray, Axes("S", "N", "D")]
    fastest: Annotated[FloatArray, Axes("S", "N")]


@dataclass(frozen=True, slots=True, eq=False)
class _OnSpheres:
    """Which sphere and which circle points lie on."""

    sphere: IntArray
    curve: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Warp:
    """The warp of one shape: where every point of the domain goes on the shape's spheres.

    Attributes
    ----------
    levels : tuple of (FieldBasis, Steps)
        In the order of their composition; the steps are those of one shape, N = 1.
    """

    levels: tuple[tuple[FieldBasis, Steps], ...]

    def __call__(self, directions: FloatArray, sphere: IntArray | int = 0) -> FloatArray:
        """Return where points of the domain go, (n, 3) unit vectors.

        Points on a circle stay on it.

        Parameters
        ----------
        directions : (n, 3) float64
            Unit vectors.
        sphere : int or (n,) int
            Index of the component sphere, as in `Template.sphere`.

        Raises
        ------
        InputError
            If a direction is no unit vector.
        """
        points = frozen_floats(directions, (None, 3), "directions of a warp")
        if len(points) and np.abs(np.linalg.norm(points, axis=1) - 1.0).max() > 1e-6:
            raise InputError(
                "directions of a warp: expected unit vectors, found lengths from "
                f"{np.linalg.norm(points, axis=1).min():g} to "
                f"{np.linalg.norm(points, axis=1).max():g}; normalise them"
            )
        spheres = np.broadcast_to(np.asarray(sphere, np.int64), (len(points),))
        if not self.levels:
            return points
        return carried(self, points, spheres, circles_of(points, spheres, self.levels[0][0]))


@dataclass(frozen=True, slots=True, eq=False)
class Warps:
    """The warps of a population.

    Attributes
    ----------
    ids : tuple of ShapeId
        N shapes.
    bases : tuple of FieldBasis
        Of the levels, in the order of their composition.
    steps : tuple of Steps
        As many, of the N shapes.
    """

    ids: tuple[ShapeId, ...]
    bases: tuple[FieldBasis, ...]
    steps: tuple[Steps, ...]

    def at(self, index: int) -> Warp:
        """Return the warp of one shape."""
        return Warp(tuple(zip(self.bases, self.chosen([index]).steps, strict=True)))

    def chosen(self, indices: Sequence[int]) -> "Warps":
        """Return the warps of some of the shapes, in the order given."""
        rows = list(indices)
        steps = tuple(Steps(own.coefficients[:, rows], own.fastest[:, rows]) for own in self.steps)
        return Warps(tuple(self.ids[row] for row in rows), self.bases, steps)

    def of(self, shape: ShapeId | str) -> Warp:
        """Return the warp of a shape by its identity or as ``SUBJECT/PHASE``.

        Raises
        ------
        InputError
            If there is no such shape.
        """
        return self.at(self.index(shape))

    def index(self, shape: ShapeId | str) -> int:
        """Return the place of a shape among all; parameters and errors as `of`."""
        names = [str(id) for id in self.ids]
        if str(shape) not in names:
            raise InputError(
                f"warp of {shape}: expected one of the {len(names)} shapes of the model such as "
                f"{names[0]}, found none of this name"
            )
        return names.index(str(shape))


def no_step(n_fields: int) -> Step:
    """Return the step of a shape that takes none."""
    return Step(np.zeros(n_fields), 0.0)


def steps_of(steps: Sequence[Sequence[Step]], n_fields: int) -> Steps:
    """Return the steps that each of N shapes took, as arrays."""
    longest = max((len(own) for own in steps), default=0)
    coefficients = np.zeros((longest, len(steps), n_fields))
    fastest = np.zeros((longest, len(steps)))
    for shape, own in enumerate(steps):
        for number, step in enumerate(own):
            coefficients[number, shape] = step.coefficients
            fastest[number, shape] = step.fastest
    return Steps(coefficients, fastest)


def in_order(steps: Sequence[Steps]) -> Steps:
    """Return steps of the same shapes, one after the other; at least one."""
    return Steps(
        np.concatenate([own.coefficients for own in steps]),
        np.concatenate([own.fastest for own in steps]),
    )


def side_by_side(first: Warps, second: Warps) -> Warps:
    """Return the warps of two populations by the same levels as those of one."""
    steps = []
    for own, other in zip(first.steps, second.steps, strict=True):
        count = max(len(own.fastest), len(other.fastest))
        padded = [
            (
                np.pad(one.coefficients, ((0, count - len(one.fastest)), (0, 0), (0, 0))),
                np.pad(one.fastest, ((0, count - len(one.fastest)), (0, 0))),
            )
            for one in (own, other)
        ]
        steps.append(Steps(*(np.concatenate(pair, axis=1) for pair in zip(*padded, strict=True))))
    return Warps((*first.ids, *second.ids), first.bases, tuple(steps))


def carried(warp: Warp, directions: FloatArray, sphere: IntArray, curve: IntArray) -> FloatArray:
    """Return where a warp carries points (P, 3) whose spheres and circles are known.

    Parameters
    ----------
    warp : Warp
    directions : (P, 3) float64
    sphere, curve : (P,) int64
        As in `Template`.
    """
    places = _OnSpheres(sphere, curve)
    for basis, steps in warp.levels:
        for coefficients, fastest in zip(
            steps.coefficients[:, 0], steps.fastest[:, 0], strict=True
        ):
            if coefficients.any():
                directions = flow(basis, places, directions, coefficients, fastest=float(fastest))
    return directions


def circles_of(directions: FloatArray, sphere: IntArray, basis: FieldBasis) -> IntArray:
    """Return the circle (n,) that each direction lies on, -1 where it lies on none."""
    curve = np.full(len(directions), -1)
    for row, circle in enumerate(basis.circles):
        across = np.linalg.norm(np.cross(directions, circle[:3]), axis=1)
        away = np.abs(np.arctan2(across, directions @ circle[:3]) - circle[3])
        curve[(away < ON_CIRCLE) & (sphere == int(circle[7]))] = row
    return curve
