"""What a population teaches about predicting cycles, learnt by predicting its own subjects.

Where a heart lies in space says nothing of how it beats. So all training subjects are first turned
to the pose that the given phases alone would have: with the pose of the whole cycle the size of
the motion would show in the position of a single phase.

Two numbers decide how the joint model (`ostiform.model.prediction`) fits reality and are learnt by
predicting every training subject from the others, from its own phases nearest to the given times:
over how many directions the rest spreads, which decides how closely the b follow the given phases,
and a factor of the variance.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.optimize import linear_sum_assignment

from ostiform.arrays import FloatArray, frozen_floats
from ostiform.domain import best_rotations, homogeneous
from ostiform.errors import InputError
from ostiform.model.conditioning import CyclePrior, cycle_energies, cycle_posterior
from ostiform.model.dynamics import DynamicModel, mean_cycle
from ostiform.model.trajectories import fourier_design
from ostiform.values import Axes, value

ENOUGH_SUBJECTS = 20
"""With fewer training subjects the distribution of cycles is hardly known."""

FEWEST_SUBJECTS = 3

DIRECTIONS = (0.0, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0)
"""Candidates for the number of directions of the rest; with 0 the given phases say nothing of the
b, and the prediction from one phase is that phase moved as the mean moves."""

SAME_TIME_DIGITS = 9
"""Decimals of a fraction of the cycle beyond which two times are the same."""

TAIL = 3
"""Motion that the phases cannot resolve is given to harmonics up to so many times the highest that
they can."""


@value
class CyclePredictor:
    """What a model has learnt about predicting the cycle from phases at certain times.

    Attributes
    ----------
    model : DynamicModel
    times : (J,) float64
        Fractions of the cycle at which a new heart is to be seen, about.
    energies : (R,) float64, mm^2 per point
        Of the rest: of its anatomy, then of the harmonics of its motion.
    directions : float
        Number of directions that the rest spreads over.
    variance_factor : float
        By which predicted variances are multiplied to agree with left-out subjects.
    spread : (P,) float64
        How the variance of the rest varies over the points; mean 1 under the weights.
    left_out_errors : (S,) float64, mm
        RMS error over its other phases of every training subject predicted from the others; NaN
        for a subject with too few phases.
    mean_motion_errors, nearest_subject_errors : (S,) float64, mm
        The same for the given phase nearest in time, moved as the others' mean cycle moves, or as
        the one of the others moves that looks most like the given phases.
    """

    model: DynamicModel
    times: Annotated[FloatArray, Axes(None)]
    energies: Annotated[FloatArray, Axes(None)]
    directions: float
    variance_factor: float
    spread: Annotated[FloatArray, Axes(None)]
    left_out_errors: Annotated[FloatArray, Axes(..., gaps=True)]
    mean_motion_errors: Annotated[FloatArray, Axes(..., gaps=True)]
    nearest_subject_errors: Annotated[FloatArray, Axes(..., gaps=True)]

    @property
    def is_weak(self) -> bool:
        """Whether there are too few training subjects to rely on (`ENOUGH_SUBJECTS`)."""
        return len(self.model.subjects) < ENOUGH_SUBJECTS


def pose_to_mean_cycle(model: DynamicModel, points: FloatArray, times: FloatArray) -> FloatArray:
    """Return the rigid transform (4, 4) that best carries phases onto the mean cycle.

    Parameters
    ----------
    model : DynamicModel
    points : (J, P, 3) float64, mm
        Phases of one heart in correspondence, in a common frame of their own.
    times : (J,) float64
        Fractions of the cycle.
    """
    shapes = frozen_floats(points, (len(times), *model.total.mean.shape), "given phases")
    transform: FloatArray = _poses(model, shapes[None], np.asarray(times, dtype=np.float64))[0]
    return transform


def fit_cycle_predictor(model: DynamicModel, times: Sequence[float]) -> CyclePredictor:
    """Learn to predict whole cycles from phases at given times.

    Parameters
    ----------
    model : DynamicModel
    times : sequence of float
        Fractions of the cycle, distinct.

    Raises
    ------
    InputError
        If no time is given or two are equal, there are fewer than three subjects, or fewer than
        two of them have more phases than are given.
    """
    given = distinct_times(times)
    if len(model.subjects) < FEWEST_SUBJECTS:
        raise InputError(
            f"prediction of a cycle: expected at least {FEWEST_SUBJECTS} training subjects, found "
            f"{len(model.subjects)}"
        )
    trials = [trial for s in range(len(model.subjects)) if (trial := _trial(model, s, given))]
    if len(trials) < 2:
        raise InputError(
            f"prediction of a cycle from {len(given)} phases: expected at least 2 training "
            f"subjects with more phases than that, found {len(trials)}"
        )
    cycles = posed_cycles(model, given)
    energies = rest_energies(model, cycles)
    judged = _judged(model, cycles, energies, trials)
    best = min(judged, key=lambda item: item.squared)
    left_out = np.full((3, len(model.subjects)), np.nan)
    for trial, error in zip(trials, best.errors, strict=True):
        left_out[:, trial.subject] = (error, *_baseline_errors(cycles, trial))
    total = float(model.total.weights @ best.spread)
    return CyclePredictor(
        model=model,
        times=given,
        energies=energies,
        directions=best.directions,
        variance_factor=best.squared / best.expected if best.expected > 0.0 else 1.0,
        spread=best.spread / total if total > 0.0 else np.ones(len(best.spread)),
        left_out_errors=left_out[0],
        mean_motion_errors=left_out[1],
        nearest_subject_errors=left_out[2],
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Trial:
    """A training subject to be predicted from the others, posed by its given phases."""

    subject: int
    given: FloatArray  # (J,) times of its phases taken as given
    seen: FloatArray  # (J, D)
    times: FloatArray  # (n,) of its other phases
    true: FloatArray  # (n, D)


@dataclass(slots=True, eq=False)
class _Judgement:
    """How well one number of directions does over all trials."""

    directions: float
    spread: FloatArray
    errors: list[float]
    squared: float = 0.0
    expected: float = 0.0


def _trial(model: DynamicModel, subject: int, given: FloatArray) -> _Trial | None:
    """Take the phases of a subject nearest to the given times, each once, as given."""
    own = np.array([i for i, id in enumerate(model.ids) if id.subject == model.subjects[subject]])
    times = np.array([model.ids[i].time for i in own])
    if len(own) <= len(given):
        return None
    apart = np.abs((given[:, None] - times + 0.5) % 1.0 - 0.5)  # (J, n)
    _, chosen = linear_sum_assignment(apart)
    other = np.setdiff1d(np.arange(len(own)), chosen)
    shapes = model.total.reconstruct(model.scores[own])
    pose = pose_to_mean_cycle(model, shapes[chosen], times[chosen])
    placed = (shapes @ pose[:3, :3].T + pose[:3, 3]) * np.sqrt(model.total.weights)[:, None]
    flat = placed.reshape(len(own), -1)
    return _Trial(subject, times[chosen], flat[chosen], times[other], flat[other])


def _judged(
    model: DynamicModel, cycles: FloatArray, energies: FloatArray, trials: Sequence[_Trial]
) -> list[_Judgement]:
    """Predict all trials from the other subjects with every number of directions."""
    points = len(model.total.mean)
    judged = [_Judgement(directions, np.zeros(points), []) for directions in DIRECTIONS]
    nothing = np.zeros((0, len(trials[0].given), cycles.shape[2]))
    for trial in trials:
        others = np.delete(cycles, trial.subject, axis=0)
        count = len(trial.times)
        for item in judged:
            prior = CyclePrior(others, energies, item.directions)
            found = cycle_posterior(prior, trial.given, trial.seen, nothing, trial.times)
            error = (found.mean - trial.true) ** 2  # (n, D)
            item.spread += error.sum(axis=0).reshape(-1, 3).sum(axis=1) / model.total.weights
            item.errors.append(float(np.sqrt(error.sum() / count)))
            item.squared += item.errors[-1] ** 2
            item.expected += float((found.shares**2).sum() + found.rest_variance.sum()) / count
    return judged


def _baseline_errors(cycles: FloatArray, trial: _Trial) -> tuple[float, float]:
    """Return the RMS errors of a trial by the mean motion, and by the nearest subject's."""
    others = np.delete(cycles, trial.subject, axis=0)
    harmonics = (cycles.shape[1] - 1) // 2
    before = fourier_design(trial.given, harmonics) @ others  # (S - 1, J, D)
    after = fourier_design(trial.times, harmonics) @ others  # (S - 1, n, D)
    apart = np.abs((trial.times[:, None] - trial.given + 0.5) % 1.0 - 0.5)
    nearest = apart.argmin(axis=1)  # (n,) given phase nearest in time
    moved = trial.true - trial.seen[nearest]
    motions = after - before[:, nearest]
    twin = int(((before - trial.seen) ** 2).sum(axis=(1, 2)).argmin())
    mean_motion, of_twin = (
        float(np.sqrt(((moved - motion) ** 2).sum() / len(moved)))
        for motion in (motions.mean(axis=0), motions[twin])
    )
    return mean_motion, of_twin


def posed_cycles(model: DynamicModel, given: FloatArray) -> FloatArray:
    """Return the subjects' cycles (S, 2 H + 1, D), flat, posed by their shapes at some times."""
    curves = np.tensordot(model.trajectories.coefficients, model.total.modes, axes=1)
    curves[:, 0] += model.total.mean  # (S, 2H + 1, P, 3)
    design = fourier_design(given, model.trajectories.harmonics)
    poses = _poses(model, np.tensordot(curves, design, axes=(1, 1)).transpose(0, 3, 1, 2), given)
    turned = np.einsum("shpi,sji->shpj", curves, poses[:, :3, :3])
    turned[:, 0] += poses[:, None, :3, 3]
    scaled = turned * np.sqrt(model.total.weights)[:, None]
    flat: FloatArray = scaled.reshape(*scaled.shape[:2], -1)
    return flat


def _poses(model: DynamicModel, shapes: FloatArray, times: FloatArray) -> FloatArray:
    """Return the transforms (n, 4, 4) that carry hearts (n, J, P, 3) onto the mean cycle."""
    weights = model.total.weights
    source, target = shapes.mean(axis=1), mean_cycle(model, times).mean(axis=0)  # (n, P, 3)
    here, there = np.einsum("npi,p->ni", source, weights), weights @ target
    centred = (source - here[:, None]) * weights[:, None]
    rotations, _ = best_rotations(np.swapaxes(centred, 1, 2) @ (target - there))
    shifts = there - np.einsum("nij,nj->ni", rotations, here)
    transforms: FloatArray = homogeneous(rotations, shifts)
    return transforms


def rest_energies(model: DynamicModel, cycles: FloatArray | None = None) -> FloatArray:
    """Return the energies (R,) of the rest: what cycles depart from their mean, and a tail.

    The tail is what the trajectories leave of the phases (their left-out errors), shared out over
    the harmonics from half of a subject's phases up, by their fourth power (a smooth process).

    Parameters
    ----------
    model : DynamicModel
    cycles : (S, 2 H + 1, D) float64, mm, optional
        Fourier coefficients in any orthonormal coordinates; default the scores.
    """
    known = model.trajectories.coefficients if cycles is None else cycles
    departures = cycle_energies(known - known.mean(axis=0))  # (H + 1,)
    errors = model.trajectories.left_out_errors
    lowest = max(1, len(model.ids) // (2 * len(model.subjects)))
    energies = np.zeros(max(len(departures), TAIL * lowest + 1))
    energies[: len(departures)] = departures
    orders = np.arange(lowest, len(energies))
    finite = np.isfinite(errors)
    energy = float((errors[finite] ** 2).mean()) if finite.any() else 0.0
    energies[lowest:] += energy * orders**-4.0 / (orders**-4.0).sum()
    return energies


def distinct_times(times: Sequence[float]) -> FloatArray:
    """Return the times (J,) of given phases within the cycle, at least one and all different."""
    given = np.asarray(times, dtype=np.float64) % 1.0
    if (
        not len(given)
        or not np.isfinite(given).all()
        or len(np.unique(given.round(SAME_TIME_DIGITS))) < len(given)
    ):
        raise InputError(
            "times of given phases: expected at least one, and different ones, found "
            + (", ".join(f"{time:g}" for time in times) or "none")
        )
    return given
