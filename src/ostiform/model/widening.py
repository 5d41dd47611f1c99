"""Widening a model built from few shapes by a smooth Gaussian process.

Few samples span few directions: whatever lies outside them a model calls impossible. Adding the
covariance of a Gaussian process of smooth displacements to that of the samples lets shapes move
in every smooth way a little (Luethi, Gerig, Jud, Vetter, "Gaussian process morphable models",
IEEE TPAMI 40(8), 2018: sum of a sample covariance and an analytic kernel). The sum is again a
low-rank model with orthonormal modes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.errors import InputError
from ostiform.model.algebra import principal_modes, weighted_size
from ostiform.model.types import ShapeModel, StoredModel
from ostiform.values import Above, value

KernelShape = Literal["gaussian", "compact"]

LEFT_OUT = 0.01
"""Share of the kernel's variance that its low-rank factor may leave out, by default."""

MOST_FIELDS = 400
"""Most columns of the factor, by default: three modes each."""


@value(eq=True)
class Kernel:
    """A covariance of displacements: ``k(x, y) I_3``, the same for the three coordinates.

    Attributes
    ----------
    sd_mm : float
        Standard deviation of each coordinate of the displacement: a point gets a variance of
        three times its square.
    length_mm : float
        How far displacements go together.
    shape : {"gaussian", "compact"}
        ``sd^2 exp(-r^2 / (2 length^2))``, or Wendland's C2 function
        ``sd^2 (1 - r/R)^4 (4 r/R + 1)`` of the same width, ``R = 3.75 length``, zero beyond R.
    """

    sd_mm: Annotated[float, Above(0)]
    length_mm: Annotated[float, Above(0)]
    shape: KernelShape = "gaussian"


COMPACT_RADIUS = 3.75
"""Of Wendland's function, in lengths: at half height it is then as wide as the Gaussian."""


@dataclass(frozen=True, slots=True, eq=False)
class Widened:
    """A widened model, and what was added to it.

    Attributes
    ----------
    model : ShapeModel
    added_variance : float, mm^2 per point
        Total variance that the kernel's factor added.
    kernel_variance : float, mm^2 per point
        That of the kernels themselves, ``3 sum sd^2``: the factor leaves out the difference.
    n_fields : int
        Columns of the factor.
    """

    model: ShapeModel
    added_variance: float
    kernel_variance: float
    n_fields: int


def kernel_values(kernels: Sequence[Kernel], first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the sum of kernels (n, m), mm^2, between points (n, 3) and (m, 3) in mm."""
    squared = (
        (first**2).sum(axis=1)[:, None] + (second**2).sum(axis=1) - 2.0 * first @ second.T
    )  # (n, m)
    squared = np.maximum(squared, 0.0)
    values = np.zeros(squared.shape)
    for kernel in kernels:
        if kernel.shape == "gaussian":
            values += kernel.sd_mm**2 * np.exp(-squared / (2.0 * kernel.length_mm**2))
        else:
            ratio = np.minimum(np.sqrt(squared) / (COMPACT_RADIUS * kernel.length_mm), 1.0)
            values += kernel.sd_mm**2 * (1.0 - ratio) ** 4 * (4.0 * ratio + 1.0)
    return values


def kernel_factor(
    kernels: Sequence[Kernel],
    points: FloatArray,
    weights: FloatArray,
    left_out: float = LEFT_OUT,
    most: int = MOST_FIELDS,
) -> FloatArray:
    """Return the pivoted Cholesky factor L (P, R), mm, of kernels on points: ``L L^T ~ K``.

    The pivot is the point whose weighted variance is least explained yet; columns are added until
    what is left out falls below a share of the weighted trace (Harbrecht, Peters, Schneider,
    "On the low-rank approximation by the pivoted Cholesky decomposition", Applied Numerical
    Mathematics 62(4), 2012). Needs R columns of the kernel matrix, never all of it.

    Parameters
    ----------
    kernels : sequence of Kernel
    points : (P, 3) float64, mm
    weights : (P,) float64
        Sum 1.
    left_out : float
        From 0; with 0 the factor is exact up to rounding.
    most : int
        Most columns.
    """
    total = sum(kernel.sd_mm**2 for kernel in kernels)
    rest = np.full(len(points), total)  # diagonal of K - L L^T
    columns: list[FloatArray] = []
    rounding = len(points) * np.finfo(np.float64).eps * total
    while len(columns) < min(most, len(points)) and weights @ rest > left_out * total:
        pivot = int(np.argmax(np.where(rest > rounding, weights * rest, -1.0)))
        if rest[pivot] <= rounding:
            break
        column = kernel_values(kernels, points, points[pivot][None])[:, 0]
        if columns:
            done = np.stack(columns, axis=1)  # (P, r)
            column = column - done @ done[pivot]
        column = column / np.sqrt(rest[pivot])
        rest = np.maximum(rest - column**2, 0.0)
        rest[pivot] = 0.0
        columns.append(column)
    return np.stack(columns, axis=1) if columns else np.empty((len(points), 0))


def widened(
    model: ShapeModel,
    kernels: Sequence[Kernel],
    left_out: float = LEFT_OUT,
    most_fields: int = MOST_FIELDS,
) -> Widened:
    """Return a model whose covariance is the given one's plus that of kernels on its mean shape.

    Parameters
    ----------
    model : ShapeModel
    kernels : sequence of Kernel
        At least one; several scales add up.
    left_out : float
        Share of the kernels' variance that may be left out to keep the rank low.
    most_fields : int
        Most columns of the kernels' factor; each gives three modes.

    Returns
    -------
    Widened
        The mean, the weights and the residual variance are the given model's; the number of
        training shapes too.

    Raises
    ------
    InputError
        If there is no kernel or `left_out` is not from 0 to below 1.
    """
    if not kernels:
        raise InputError("widening a model: expected at least one kernel, found none")
    if not 0.0 <= left_out < 1.0:
        raise InputError(
            f"widening a model: expected a share from 0 to below 1 to leave out, found {left_out:g}"
        )
    if most_fields < 1:
        raise InputError(f"widening a model: expected at least 1 field, found {most_fields}")
    factor = kernel_factor(kernels, model.mean, model.weights, left_out, most_fields)  # (P, R)
    fields = np.zeros((3, factor.shape[1], *model.mean.shape))
    for axis in range(3):
        fields[axis, :, :, axis] = factor.T
    deviations = np.concatenate(
        [
            model.modes * model.deviations[:, None, None],
            fields.reshape(-1, *model.mean.shape),
        ]
    )
    size = weighted_size(model.mean, model.weights)
    modes, variances = principal_modes(deviations, model.weights, size)
    return Widened(
        model=replace(model, modes=modes, variances=variances),
        added_variance=3.0 * float(model.weights @ (factor**2).sum(axis=1)),
        kernel_variance=3.0 * sum(kernel.sd_mm**2 for kernel in kernels),
        n_fields=factor.shape[1],
    )


def widened_stored(
    stored: StoredModel,
    kernels: Sequence[Kernel],
    left_out: float = LEFT_OUT,
    most_fields: int = MOST_FIELDS,
) -> tuple[StoredModel, Widened]:
    """Widen a stored model; the scores of its training shapes are those on the new modes.

    Parameters and errors are those of `widened`.
    """
    result = widened(stored.model, kernels, left_out, most_fields)
    scores = result.model.project(stored.model.reconstruct(stored.scores))
    return StoredModel(result.model, scores, stored.ids, stored.template), result
