"""What each level holds, in scores: subjects' means, the motion that is common, departures from it.

Weights a_sf (1 / S per subject, within a subject by the share of the cycle of each phase) make the
levels orthogonal, so that their variances add up exactly (design 6).
"""

from collections.abc import Sequence

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.model.trajectories import fourier_design
from ostiform.study import ShapeId


def subject_indices(ids: Sequence[ShapeId]) -> IntArray:
    """Return the number (N,) of every shape's subject, in study order."""
    order = {name: index for index, name in enumerate(dict.fromkeys(id.subject for id in ids))}
    return np.array([order[id.subject] for id in ids])


def group_means(values: FloatArray, share: FloatArray, groups: IntArray) -> FloatArray:
    """Return the weighted means (S, K) of values (N, K) of groups (N,), by rising group."""
    _, index = np.unique(groups, return_inverse=True)
    weight = np.bincount(index, weights=share)
    sums = np.zeros((len(weight), values.shape[1]))
    np.add.at(sums, index, share[:, None] * values)
    means: FloatArray = sums / weight[:, None]
    return means


def level_scores(
    scores: FloatArray, share: FloatArray, groups: IntArray, ids: Sequence[ShapeId]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the means of the groups (S, K), and common motion and departures (N, K)."""
    _, index, counts = np.unique(groups, return_inverse=True, return_counts=True)
    centres = group_means(scores, share, groups)
    motion = scores - centres[index]
    times = np.array([id.time for id in ids])
    common = common_motion(motion, share, times, int(np.median(counts)) // 2)
    return centres, common, motion - common


def level_shares(
    scores: FloatArray, share: FloatArray, groups: IntArray, ids: Sequence[ShapeId]
) -> dict[str, float]:
    """Return the share of every level in the total variance, for shapes with scores (N, K)."""
    weights = share / share.sum()
    _, common, departure = level_scores(scores, weights, groups, ids)
    total = weights @ ((scores - weights @ scores) ** 2).sum(axis=1)
    if total <= 0.0:
        return {"between": 0.0, "within": 0.0, "common": 0.0, "departure": 0.0}
    parts = [float(weights @ (part**2).sum(axis=1) / total) for part in (common, departure)]
    within = float(weights @ ((common + departure) ** 2).sum(axis=1) / total)
    return {
        "between": 1.0 - within,
        "within": within,
        "common": parts[0],
        "departure": parts[1],
    }


def common_motion(
    motion: FloatArray, share: FloatArray, times: FloatArray, harmonics: int
) -> FloatArray:
    """Return the weighted least-squares Fourier series of all subjects' motion, at their phases.

    Fitted values and residuals of least squares are orthogonal under its weights, which is what
    makes the two covariances add up exactly. With half as many harmonics as a subject has phases
    and equal times in all subjects, the series is the mean over the subjects, phase by phase.
    """
    root = np.sqrt(share)[:, None]
    design = fourier_design(times, harmonics)
    coefficients = np.linalg.lstsq(root * design, root * motion, rcond=None)[0]
    common: FloatArray = design @ coefficients
    return common
