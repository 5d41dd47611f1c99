"""The distribution of new beating shapes: whole cycles, and what cycles have beyond the modes.

A cycle is ``x(t) = mean + modes W(t) + field F(t)`` with the modes and the smooth field of
`FitPrior` in space and Fourier series in time, ``W(t) = sum_h phi_h(t) W_h``. The coefficients W of
the training subjects' trajectories give their mean and covariance. A few subjects do not know a
covariance of hundreds of numbers, so it is shrunk towards the independent one,
``(1 - g) S + g diag(v)`` (Ledoit & Wolf 2004): S couples how a heart looks with how it beats, v
lets each vary by itself. The share g is the likeliest of subjects left out in turn. Of the field's
energy, the share of every harmonic is what left-out cycles have there beyond the others' modes.
"""

from typing import Annotated

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from ostiform.arrays import FloatArray
from ostiform.errors import InputError
from ostiform.fitting.prior import FitPrior, fit_prior
from ostiform.model import (
    DynamicModel,
    StoredModel,
    cycle_energies,
    dynamic_model_of,
    fourier_design,
    rest_energies,
)
from ostiform.values import Axes, value

ENOUGH_MOTION = 0.998
"""Harmonics are taken until this share of the motion's energy is held."""

MOST_HARMONICS = 6
FIELD_HARMONICS, ENOUGH_FIELD = 3, 0.98
"""Of what cycles have beyond the modes; fewer where they hold this share of its energy."""

SHRINKAGES = (0.02, 0.05, 0.1, 0.2, 0.4, 0.7, 1.0)
"""Candidates of the independent covariance's share."""

FEWEST_SUBJECTS = 3
"""With fewer, how subjects differ is not known: as much as one moves."""

LEAST_VARIANCE = 1e-4
"""Of a coefficient, relative to that of the mode over the population."""


@value
class SequencePrior:
    """A Gaussian distribution of new cycles.

    Attributes
    ----------
    space : FitPrior
        Modes and field in space.
    mean : (2 H + 1, K) float64
        Expected coefficients of the K modes, in their standard deviations, by temporal function.
    precision : ((2 H + 1) K, (2 H + 1) K) float64
        Of these coefficients, by rows.
    field_variances : (2 G + 1,) float64
        Of the field's coefficients by temporal function; at any time they sum to 1.
    shrinkage : float
        Share of the independent covariance.
    subjects : int
        That it was learnt from.
    """

    space: FitPrior
    mean: Annotated[FloatArray, Axes("T", "K")]
    precision: Annotated[FloatArray, Axes(None, None)]
    field_variances: Annotated[FloatArray, Axes(None)]
    shrinkage: float
    subjects: int

    @property
    def harmonics(self) -> int:
        """H."""
        return (len(self.mean) - 1) // 2

    def design(self, times: FloatArray) -> FloatArray:
        """Return the temporal functions (n, 2 H + 1) at times (n,)."""
        return fourier_design(np.asarray(times, dtype=np.float64), self.harmonics)


def sequence_prior(stored: StoredModel) -> SequencePrior:
    """Return the distribution of new cycles that a model of subjects with phases states.

    Parameters
    ----------
    stored : StoredModel

    Raises
    ------
    InputError
        If the model has no training shapes, or no subject has two phases.
    """
    dynamic = dynamic_model_of(stored)
    if dynamic.trajectories.harmonics < 1:
        raise InputError(
            "a fit to a sequence: expected a model of subjects with several phases, found one "
            "phase per subject; fit each phase by itself"
        )
    space = fit_prior(StoredModel(dynamic.total, dynamic.scores, dynamic.ids, stored.template))
    n_modes = space.modes.shape[2]
    energies = rest_energies(dynamic)
    harmonics = _harmonics(dynamic)
    spread: FloatArray = np.sqrt(space.leftover.growth * dynamic.total.variances[:n_modes])
    cycles = _coefficients(dynamic, harmonics)[:, :, :n_modes] / spread  # (S, T, K)
    mean = cycles.mean(axis=0)
    tail = _tail(dynamic, energies, harmonics, n_modes) / spread**2  # (H + 1, K)
    if len(cycles) < FEWEST_SUBJECTS:
        variances = _as_motion(mean)
        precision = np.diag(1.0 / variances.ravel())
        share = 1.0
    else:
        share = _likeliest_share(cycles, tail)
        precision = np.asarray(np.linalg.inv(_covariance(cycles, tail, share)), dtype=np.float64)
    return SequencePrior(
        space=space,
        mean=mean,
        precision=0.5 * (precision + precision.T),
        field_variances=_field_variances(dynamic, harmonics),
        shrinkage=share,
        subjects=len(cycles),
    )


def _coefficients(dynamic: DynamicModel, harmonics: int) -> FloatArray:
    """Return the subjects' Fourier coefficients (S, 2 H + 1, K), mm, up to some harmonic."""
    known = dynamic.trajectories.coefficients
    found = np.zeros((known.shape[0], 2 * harmonics + 1, known.shape[2]))
    shared = min(found.shape[1], known.shape[1])
    found[:, :shared] = known[:, :shared]
    return found


def _harmonics(dynamic: DynamicModel) -> int:
    moving = cycle_energies(dynamic.trajectories.coefficients)[1:]
    held = np.cumsum(moving) / max(float(moving.sum()), np.finfo(np.float64).tiny)
    return min(int(np.searchsorted(held, ENOUGH_MOTION)) + 1, MOST_HARMONICS, len(held))


def _tail(dynamic: DynamicModel, energies: FloatArray, harmonics: int, n_modes: int) -> FloatArray:
    """Return the variance (H + 1, K), mm^2, of motion that the training phases cannot resolve.

    Its energies by harmonic are those that the trajectories leave of their phases, shared out over
    the modes as the motion is.
    """
    cycles = dynamic.trajectories.coefficients
    explained = cycle_energies(cycles - cycles.mean(axis=0))
    beyond = np.zeros(harmonics + 1)
    shared = min(len(beyond), len(energies))
    beyond[:shared] = energies[:shared]
    known = min(len(beyond), len(explained))
    beyond[:known] -= explained[:known]
    motion = (cycles[:, 1:] ** 2).sum(axis=(0, 1))
    share = motion / max(float(motion.sum()), np.finfo(np.float64).tiny)
    spread: FloatArray = np.outer(np.maximum(beyond, 0.0), share[:n_modes])
    spread[0] = 0.0
    return spread


def _covariance(cycles: FloatArray, tail: FloatArray, share: float) -> FloatArray:
    """Return the shrunken covariance (T K, T K) of the coefficients of new cycles.

    A new cycle differs from the mean of S by the factor ``1 + 1 / S`` more than they vary.
    """
    count = len(cycles)
    departures = (cycles - cycles.mean(axis=0)).reshape(count, -1) / np.sqrt(count - 1.0)
    variances = (departures**2).sum(axis=0).reshape(cycles.shape[1:])
    waves = 0.5 * (variances[1::2] + variances[2::2])  # of a harmonic's cosine and sine alike
    variances[1::2], variances[2::2] = waves, waves
    further = np.repeat(tail, [1, *[2] * (len(tail) - 1)], axis=0)
    independent = np.maximum(share * variances + further, LEAST_VARIANCE)
    joint = (1.0 - share) * departures.T @ departures + np.diag(independent.ravel())
    covariance: FloatArray = (1.0 + 1.0 / count) * joint
    return covariance


def _likeliest_share(cycles: FloatArray, tail: FloatArray) -> float:
    """Return the share under which subjects left out in turn are likeliest."""
    best, chosen = -np.inf, SHRINKAGES[-1]
    for share in SHRINKAGES:
        total = 0.0
        for index in range(len(cycles)):
            others = np.delete(cycles, index, axis=0)
            factor = cho_factor(_covariance(others, tail, share), lower=True)
            apart = (cycles[index] - others.mean(axis=0)).ravel()
            total -= 0.5 * float(apart @ cho_solve(factor, apart))
            total -= float(np.log(np.diag(factor[0])).sum())
        if total > best:
            best, chosen = total, share
    return chosen


def _as_motion(mean: FloatArray) -> FloatArray:
    """Return variances (T, K) where one or two subjects say nothing of how subjects differ."""
    variances = np.ones_like(mean)
    motion = (mean[1:] ** 2).reshape(-1, 2, mean.shape[1]).mean(axis=1)  # (H, K)
    level = motion.mean(axis=1, keepdims=True)
    variances[1:] = np.repeat(np.maximum(motion, level), 2, axis=0)
    return np.maximum(variances, LEAST_VARIANCE)


def _field_variances(dynamic: DynamicModel, harmonics: int) -> FloatArray:
    """Return the share (2 G + 1,) of every temporal function in the energy beyond the modes."""
    highest = min(FIELD_HARMONICS, harmonics)
    cycles = dynamic.trajectories.coefficients  # (S, T, K)
    shares = np.zeros(highest + 1)
    rest = []
    if len(cycles) >= FEWEST_SUBJECTS:
        subjects = np.array([id.subject for id in dynamic.ids])
        for index, name in enumerate(dynamic.subjects):
            rest.append(_beyond(cycles, dynamic.scores[subjects != name], index))
        found = cycle_energies(np.stack(rest))
        count = min(len(found), highest + 1)
        shares[:count] = found[:count]
        shares[-1] += float(found[count:].sum())
    if not shares.sum() > 0.0:
        moving = cycle_energies(cycles)[1 : highest + 1]
        shares[0] = 1.0
        shares[1:] = moving / max(float(moving.sum()), np.finfo(np.float64).tiny)
    shares /= shares.sum()
    highest = int(np.searchsorted(np.cumsum(shares), ENOUGH_FIELD))
    shares[highest] = shares[highest:].sum()
    return np.repeat(shares[: highest + 1], [1, *[2] * highest])


def _beyond(cycles: FloatArray, others: FloatArray, index: int) -> FloatArray:
    """Return what a subject's cycle (T, K) has beyond the span of the others' shapes (n, K)."""
    mean = others.mean(axis=0)
    _, singular, directions = np.linalg.svd(others - mean, full_matrices=False)
    directions = directions[singular > 1e-9 * max(float(singular[0]), 1e-300)]
    own = cycles[index].copy()
    own[0] -= mean
    rest: FloatArray = own - own @ directions.T @ directions
    return rest
