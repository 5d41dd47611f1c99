"""New beating hearts: the distribution of whole cycles over subjects, and what can be made of it.

A subject's cycle is one point: the Fourier coefficients of its trajectory in the modes of all
shapes. Distance between cycles is the RMS over the cycle of the distance of their shapes, so that
the constant counts once and every other coefficient by a half. The principal components over
subjects couple how a heart looks with how it beats.
"""

from typing import Annotated

import numpy as np
from scipy.linalg import svd
from scipy.special import ndtr, ndtri

from ostiform.arrays import FloatArray
from ostiform.errors import InputError
from ostiform.model.dynamics import DynamicModel
from ostiform.model.trajectories import fourier_design
from ostiform.model.types import ShapeModel
from ostiform.values import Axes, value


@value
class CycleModel:
    """A Gaussian distribution of whole cycles.

    Attributes
    ----------
    basis : ShapeModel
        The modes of all shapes, in whose scores (K of them) the cycles are written.
    mean : (2 H + 1, K) float64, mm
        Fourier coefficients of the mean cycle.
    modes : (M, 2 H + 1, K) float64
        Fourier coefficients; orthonormal under the RMS over the cycle.
    variances : (M,) float64, mm^2 per point
        Over subjects (S - 1), mean over the cycle; largest first.
    """

    basis: Annotated[ShapeModel, Axes("K")]
    mean: Annotated[FloatArray, Axes("T", "K")]
    modes: Annotated[FloatArray, Axes("M", "T", "K")]
    variances: Annotated[FloatArray, Axes("M")]


def fit_cycle_model(model: DynamicModel) -> CycleModel:
    """Return the principal components of the subjects' cycles.

    Raises
    ------
    InputError
        If there are fewer than two subjects.
    """
    cycles = model.trajectories.coefficients  # (S, 2H + 1, K)
    if len(cycles) < 2:
        raise InputError(
            f"a model of cycles: expected at least 2 subjects, found {len(cycles)}: with one there "
            "is no variation between cycles to learn"
        )
    mean = cycles.mean(axis=0)
    scale = _coefficient_scale(cycles.shape[1])  # (2H + 1,)
    rows = ((cycles - mean) * scale[:, None]).reshape(len(cycles), -1) / np.sqrt(len(cycles) - 1)
    _, singular, right = svd(rows, full_matrices=False)
    kept = singular > max(rows.shape) * np.finfo(np.float64).eps * singular[0]
    modes = right[kept].reshape(-1, *mean.shape) / scale[:, None]
    return CycleModel(model.total, mean, modes, singular[kept] ** 2)


def cycle_shapes(model: CycleModel, scores: FloatArray, times: FloatArray) -> FloatArray:
    """Return the shapes (..., T, P, 3) in mm at times (T,) of cycles with scores (..., M).

    Scores are in mm, one per mode of cycles; missing ones are zero.

    Raises
    ------
    InputError
        If there are more scores than modes.
    """
    given = np.asarray(scores, dtype=np.float64)
    if given.shape[-1] > len(model.modes):
        raise InputError(
            f"scores of a cycle: expected at most {len(model.modes)}, one per mode, "
            f"found {given.shape[-1]}"
        )
    curves = model.mean + np.tensordot(given, model.modes[: given.shape[-1]], axes=1)
    design = fourier_design(times, (len(model.mean) - 1) // 2)  # (T, 2H + 1)
    return model.basis.reconstruct(design @ curves)


def random_cycles(
    model: CycleModel, count: int, times: FloatArray, rng: np.random.Generator, limit: float = 3.0
) -> FloatArray:
    """Return the shapes (count, T, P, 3) in mm of random beating hearts at times (T,).

    Scores are normal with the variances of the modes, truncated at `limit` standard deviations.
    """
    below = ndtr(-limit)
    uniform = rng.uniform(size=(count, len(model.modes)))
    standard = ndtri(below + uniform * (1.0 - 2.0 * below))
    return cycle_shapes(model, standard * np.sqrt(model.variances), times)


def beating_shape(model: DynamicModel, scores: FloatArray, times: FloatArray) -> FloatArray:
    """Return the shapes (T, P, 3) in mm of a heart with chosen between-subject scores.

    Its mean shape over the cycle has the scores in the modes of ``model.between``; it beats with
    the mean motion of the population.

    Parameters
    ----------
    model : DynamicModel
    scores : (M,) float64, mm
    times : (T,) float64
        Fractions of the cycle.

    Raises
    ------
    InputError
        If there are more scores than modes between subjects.
    """
    motion = np.array(model.trajectories.coefficients.mean(axis=0))  # (2H + 1, K)
    motion[0] = model.total.project(model.between.reconstruct(scores))
    return model.total.reconstruct(fourier_design(times, model.trajectories.harmonics) @ motion)


def _coefficient_scale(count: int) -> FloatArray:
    scale = np.full(count, np.sqrt(0.5))
    scale[0] = 1.0
    return scale
