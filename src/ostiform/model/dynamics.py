"""Who and when: a population of beating shapes split into subjects and motion (design 6).

Multilevel principal component analysis: with weights a_sf (1 / S per subject, within a subject by
the share of the cycle that each phase stands for) the covariance of all shapes is exactly the sum
of that of the subjects' mean shapes and that of the shapes about their subject's mean; the latter
is exactly the sum of the motion common to all and of each subject's departure from it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.linalg import eigh

from ostiform.arrays import FloatArray, frozen_floats
from ostiform.errors import InputError
from ostiform.model.algebra import principal_modes, weighted_size
from ostiform.model.intervals import FEWEST_SUBJECTS, jackknife_half_width
from ostiform.model.levels import (
    common_motion,
    group_means,
    level_scores,
    level_shares,
    subject_indices,
)
from ostiform.model.mesh import ModelMesh
from ostiform.model.pca import model_in_span
from ostiform.model.phases import phase_weights
from ostiform.model.trajectories import (
    Trajectories,
    TrajectorySettings,
    fit_trajectories,
    fourier_design,
    interpolation_errors,
)
from ostiform.model.types import ShapeModel, StoredModel
from ostiform.study import ShapeId
from ostiform.values import Axes, value


@value
class DynamicModel:
    """The variation of beating shapes, by its sources.

    All models share mean, mesh and point weights; variances are weighted by a_sf, without the
    correction N / (N - 1) of a sample.

    Attributes
    ----------
    ids : tuple of ShapeId
        The N shapes.
    phase_weights : (N,) float64
        a_sf, sum 1.
    total : ShapeModel
        Of all shapes; between + within.
    between : ShapeModel
        Of the S subjects' mean shapes.
    within : ShapeModel
        Of the shapes about their subject's mean; common + departure.
    common : ShapeModel
        Of the motion that all subjects share.
    departure : ShapeModel
        Of each subject's motion about the common one.
    between_corrected : ShapeModel
        ``between - within / n_eff``: what the subjects' means vary beyond what averaging few
        phases leaves, negative eigenvalues set to zero.
    clipped_variance : float, mm^2 per point
        Sum of those negative eigenvalues, as a positive number.
    effective_phases : float
        n_eff, the number of equally weighted phases that average as well as a subject's phases.
    scores : (N, K) float64, mm
        Of every shape in the modes of `total`; exact, nothing is left out.
    trajectories : Trajectories
        Each subject's closed curve in the space of these scores.
    """

    ids: Annotated[tuple[ShapeId, ...], Axes("N")]
    phase_weights: Annotated[FloatArray, Axes("N")]
    total: Annotated[ShapeModel, Axes("K")]
    between: ShapeModel
    within: ShapeModel
    common: ShapeModel
    departure: ShapeModel
    between_corrected: ShapeModel
    clipped_variance: float
    effective_phases: float
    scores: Annotated[FloatArray, Axes("N", "K")]
    trajectories: Trajectories

    @property
    def subjects(self) -> tuple[str, ...]:
        """The S subjects, in study order."""
        return self.trajectories.subjects


@dataclass(frozen=True, slots=True)
class VarianceShare:
    """A share of the total variance, with its interval over subjects.

    Attributes
    ----------
    value : float
    low, high : float or None
        Ends of the 95 % interval (jackknife over subjects, t); None below three subjects.
    """

    value: float
    low: float | None
    high: float | None


@dataclass(frozen=True, slots=True)
class PhasePrediction:
    """How well left-out phases are predicted from the other phases, mm.

    Attributes
    ----------
    trajectory : float
        Mean over phases of the weighted RMS error of the trajectories fitted without the phase.
    interpolation : float
        The same for the straight line between the neighbouring phases.
    phases : int
        Number of phases that could be left out.
    """

    trajectory: float
    interpolation: float
    phases: int


def fit_dynamic_model(
    aligned: FloatArray,
    ids: Sequence[ShapeId],
    weights: FloatArray,
    mesh: ModelMesh,
    settings: TrajectorySettings | None = None,
) -> DynamicModel:
    """Split the variation of shapes into subjects and motion, and fit every subject's cycle.

    Parameters
    ----------
    aligned : (N, P, 3) float64, mm
        Aligned with one transform per subject: per shape, motion would be aligned away.
    ids : (N,) sequence of ShapeId
    weights : (P,) float64
        Area shares, sum 1.
    mesh : ModelMesh
    settings : TrajectorySettings, optional

    Raises
    ------
    InputError
        If there are fewer than two shapes, or the arrays do not fit each other.
    """
    shapes = frozen_floats(aligned, (len(ids), len(mesh.part), 3), "aligned shapes")
    if len(ids) < 2:
        raise InputError(f"a dynamic model: expected at least 2 shapes, found {len(ids)}")
    share = phase_weights(ids)  # (N,) a_sf
    mean = np.tensordot(share, shapes, axes=1)
    size = weighted_size(mean, weights)
    deviations = np.sqrt(share)[:, None, None] * (shapes - mean)
    modes, variances = principal_modes(deviations, weights, size)
    total = ShapeModel(mean, modes, variances, weights, mesh, 0.0, len(ids))
    scores = total.project(shapes)  # (N, K)
    times = np.array([id.time for id in ids])
    trajectories = fit_trajectories(scores, [id.subject for id in ids], times, settings)
    return dynamic_model(total, scores, ids, trajectories)


def dynamic_model(
    total: ShapeModel, scores: FloatArray, ids: Sequence[ShapeId], trajectories: Trajectories
) -> DynamicModel:
    """Return the dynamic model whose trajectories are fitted: the levels follow from the scores.

    Parameters
    ----------
    total : ShapeModel
        Of all shapes, weighted by `phase_weights`.
    scores : (N, K) float64, mm
    ids : (N,) sequence of ShapeId
    trajectories : Trajectories
    """
    share = phase_weights(ids)  # (N,) a_sf
    subject = subject_indices(ids)
    centres = group_means(scores, share, subject)  # (S, K)
    motion = scores - centres[subject]
    times = np.array([id.time for id in ids])
    shared = common_motion(motion, share, times, int(np.median(np.bincount(subject))) // 2)
    root = np.sqrt(share)[:, None]
    subject_root = np.sqrt(1.0 / len(centres))
    effective = 1.0 / (len(centres) * float((share**2).sum()))
    corrected, clipped = _difference(
        total, subject_root * centres, root * motion / np.sqrt(effective)
    )
    return DynamicModel(
        ids=tuple(ids),
        phase_weights=share,
        total=total,
        between=model_in_span(total, subject_root * centres, len(centres)),
        within=model_in_span(total, root * motion, len(ids)),
        common=model_in_span(total, root * shared, len(ids)),
        departure=model_in_span(total, root * (motion - shared), len(ids)),
        between_corrected=corrected,
        clipped_variance=clipped,
        effective_phases=effective,
        scores=scores,
        trajectories=trajectories,
    )


def dynamic_model_of(
    stored: StoredModel, settings: TrajectorySettings | None = None
) -> DynamicModel:
    """Split the variation of the training shapes that a model file holds.

    The scores of an untruncated model are the shapes, so the file needs to hold nothing more.

    Raises
    ------
    InputError
        If the training shapes are not known, or the model was truncated.
    """
    if not stored.ids or stored.model.residual_variance > 0.0:
        raise InputError(
            "a dynamic model: expected a model with all its modes and the scores of its training "
            f"shapes, found {len(stored.ids)} shapes and a residual variance of "
            f"{stored.model.residual_variance:g} mm^2"
        )
    model = stored.model
    return fit_dynamic_model(
        model.reconstruct(stored.scores), stored.ids, model.weights, model.mesh, settings
    )


def subject_means(model: DynamicModel) -> FloatArray:
    """Return the mean shape over the cycle (S, P, 3) in mm of every subject."""
    subject = subject_indices(model.ids)
    return model.total.reconstruct(group_means(model.scores, model.phase_weights, subject))


def within_shapes(model: DynamicModel) -> FloatArray:
    """Return the shapes (N, P, 3) in mm with their subject's mean replaced by the population's."""
    subject = subject_indices(model.ids)
    centres = group_means(model.scores, model.phase_weights, subject)
    return model.total.reconstruct(model.scores - centres[subject])


def level_shapes(model: DynamicModel) -> dict[str, FloatArray]:
    """Return the training shapes of every level, about the population's mean, mm.

    Returns
    -------
    shapes : dict of str to (n, P, 3) float64
        ``between``: the S subjects' means; ``within``: every shape with its subject's mean
        replaced by the population's; ``common`` and ``departure``: the two parts of its motion.
    """
    subject = subject_indices(model.ids)
    centres, common, departure = level_scores(model.scores, model.phase_weights, subject, model.ids)
    return {
        "between": model.total.reconstruct(centres),
        "within": model.total.reconstruct(common + departure),
        "common": model.total.reconstruct(common),
        "departure": model.total.reconstruct(departure),
    }


def between_share(model: DynamicModel) -> VarianceShare:
    """Return the share of the variance that lies between subjects; the rest is motion.

    The interval is that of the jackknife: the share is computed again without each subject.
    """
    return variance_shares(model)["between"]


def variance_shares(model: DynamicModel) -> dict[str, VarianceShare]:
    """Return the share of every level in the total variance.

    ``between + within = 1`` and ``common + departure = within``. The intervals are those of the
    jackknife over subjects.
    """
    subject = subject_indices(model.ids)
    values = level_shares(model.scores, model.phase_weights, subject, model.ids)
    count = len(model.subjects)
    if count < FEWEST_SUBJECTS:
        return {name: VarianceShare(value, None, None) for name, value in values.items()}
    left_out: dict[str, list[float]] = {name: [] for name in values}
    for s in range(count):
        kept = np.flatnonzero(subject != s)
        found = level_shares(
            model.scores[kept],
            model.phase_weights[kept],
            subject[kept],
            [model.ids[index] for index in kept],
        )
        for name, share in found.items():
            left_out[name].append(share)
    shares = {}
    for name, share in values.items():
        half = float(jackknife_half_width(np.array(left_out[name])))
        shares[name] = VarianceShare(share, max(0.0, share - half), min(1.0, share + half))
    return shares


def resampled_cycle(model: DynamicModel, subject: str, times: FloatArray) -> FloatArray:
    """Return the shapes (T, P, 3) in mm of one subject at any times (T,), fractions of the cycle.

    Raises
    ------
    InputError
        If the model has no such subject.
    """
    if subject not in model.subjects:
        raise InputError(
            f"subject of a dynamic model: expected one of {', '.join(model.subjects)}, "
            f"found {subject}"
        )
    curve = model.trajectories.coefficients[model.subjects.index(subject)]  # (2H + 1, K)
    return model.total.reconstruct(fourier_design(times, model.trajectories.harmonics) @ curve)


def mean_cycle(model: DynamicModel, times: FloatArray) -> FloatArray:
    """Return the mean over the subjects' cycles (T, P, 3) in mm at any times (T,)."""
    curve = model.trajectories.coefficients.mean(axis=0)  # (2H + 1, K)
    return model.total.reconstruct(fourier_design(times, model.trajectories.harmonics) @ curve)


def phase_prediction(model: DynamicModel) -> PhasePrediction:
    """Return the leave-one-phase-out error of the trajectories and of linear interpolation."""
    times = np.array([id.time for id in model.ids])
    lines = interpolation_errors(model.scores, [id.subject for id in model.ids], times)
    curves = model.trajectories.left_out_errors
    known = np.isfinite(lines) & np.isfinite(curves)
    if not known.any():
        raise InputError(
            "prediction of left-out phases: expected a subject with at least 2 phases, found none"
        )
    return PhasePrediction(
        float(curves[known].mean()), float(lines[known].mean()), int(known.sum())
    )


def _difference(total: ShapeModel, plus: FloatArray, minus: FloatArray) -> tuple[ShapeModel, float]:
    """Return the model of ``plus^T plus - minus^T minus`` without its negative part, and that."""
    values, vectors = eigh(plus.T @ plus - minus.T @ minus)  # (K,), (K, K)
    kept = values > 0.0
    rows = (vectors[:, kept] * np.sqrt(values[kept])).T
    return model_in_span(total, rows, len(plus)), float(-values[~kept].sum())
