"""Where a fit starts: candidate poses, improved together by closest points of the mean shape.

Every candidate turns the mean shape by one rotation of a fixed set and lays its centre on the
data's; then all are moved at once by iterated closest points with Student-t weights (rigid, the
mean shape only). What survives are the best few that differ.
"""

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from ostiform.arrays import FloatArray
from ostiform.domain import best_rotations
from ostiform.errors import InputError
from ostiform.fitting.data import Data
from ostiform.fitting.leftover import spread_points
from ostiform.fitting.prior import FitPrior
from ostiform.fitting.settings import FitSettings
from ostiform.fitting.types import IDENTITY, Pose

SAMPLES = 200
"""Points of the data that the search for the pose looks at."""

ROUNDS = 25
KEPT = 4
"""Candidates that the full fit tries, at most."""

SAME_TURN = np.radians(15.0)
SMALL = 0.75
"""Data of less than this share of the model's size may be a part of it, anywhere on it."""

PLACES = 5
"""Points of the model that the centre of small data is tried at."""

COLLINEAR = 0.02
"""Relative to the size: landmarks this near to one line do not fix a rotation."""


def starting_poses(
    prior: FitPrior, data: Data, settings: FitSettings, size_ratio: float
) -> tuple[Pose, ...]:
    """Return poses to start from, the likeliest first.

    Parameters
    ----------
    prior : FitPrior
    data : Data
    settings : FitSettings
    size_ratio : float
        Size of the data over the model's: the first guess of the scale where that is sought and
        the data are whole surfaces.

    Raises
    ------
    InputError
        If landmarks alone cannot fix the pose.
    """
    if settings.pose == "known":
        return (IDENTITY,)
    anchors = _anchored(prior, data)
    if data.is_labelled_only:
        if anchors is None:
            raise InputError(
                "landmarks to fit to: expected at least three that are not on one line, or a known "
                "pose, found fewer; give more, or --pose known"
            )
        return (_superposed(anchors, settings.scaling == "similarity"),)
    scale = size_ratio if settings.scaling == "similarity" and data.surfaces else 1.0
    samples = _samples(data)
    candidates = _candidates(prior, samples, settings, scale)
    if anchors is not None:
        candidates.insert(0, _superposed(anchors, settings.scaling == "similarity"))
    return _improved(prior, samples, candidates)


def _anchored(prior: FitPrior, data: Data) -> tuple[FloatArray, FloatArray] | None:
    """Return points of the mean and where they are in the target; None where they fix no pose."""
    model, there = [], []
    for point, position in zip(data.labelled.points, data.labelled.positions, strict=True):
        model.append(prior.mean[point])
        there.append(position)
    rims = {**data.labelled.on_rims}
    for surface in data.surfaces:
        rims.update(surface.rims)
    for name, curve in rims.items():
        if len(curve) >= 3:
            model.append(prior.mean[prior.centres[name]])
            there.append(curve.mean(axis=0))
    if len(model) < 3:
        return None
    own = np.array(model)
    spread = np.linalg.svd(own - own.mean(axis=0), compute_uv=False)
    if spread[1] < COLLINEAR * prior.size:
        return None
    return own, np.array(there)


def _superposed(anchors: tuple[FloatArray, FloatArray], scaling: bool) -> Pose:
    model, there = anchors
    offset, goal = model - model.mean(axis=0), there - there.mean(axis=0)
    rotations, gains = best_rotations((offset.T @ goal)[None])
    scale = float(gains[0].sum() / (offset**2).sum()) if scaling else 1.0
    scale = max(scale, 1e-6)
    return Pose(scale, rotations[0], there.mean(axis=0) - scale * rotations[0] @ model.mean(axis=0))


def _samples(data: Data) -> FloatArray:
    """Return points (n, 3) of the data, each target with its share."""
    sets = [surface.samples for surface in data.surfaces]
    sets += [item.points for item in data.point_sets]
    total = sum(len(points) for points in sets)
    stride = max(total / SAMPLES, 1.0)
    chosen = [
        points[np.linspace(0, len(points) - 1, max(round(len(points) / stride), 1)).astype(int)]
        for points in sets
    ]
    return np.concatenate(chosen)


def _candidates(
    prior: FitPrior, samples: FloatArray, settings: FitSettings, scale: float
) -> list[Pose]:
    count = len(prior.model.mean)
    middle = np.median(samples, axis=0)
    own = prior.model.mean
    centre = prior.model.weights @ own
    if settings.pose == "near":
        rotations = [np.eye(3)]
    else:
        rotations = list(Rotation.create_group("I").as_matrix())
    places = [centre]
    span = np.percentile(samples, 95.0, axis=0) - np.percentile(samples, 5.0, axis=0)
    reach = np.percentile(own, 95.0, axis=0) - np.percentile(own, 5.0, axis=0)
    if np.linalg.norm(span) < SMALL * scale * np.linalg.norm(reach):
        places += [own[k] for k in spread_points(own, min(PLACES + 1, count))[1:]]
    poses = [Pose(scale, np.eye(3), middle - scale * middle)] if settings.pose == "near" else []
    poses += [
        Pose(scale, rotation, middle - scale * rotation @ place)
        for place in places
        for rotation in rotations
    ]
    return poses


def _improved(prior: FitPrior, samples: FloatArray, candidates: Sequence[Pose]) -> tuple[Pose, ...]:
    tree = cKDTree(prior.model.mean)
    scale = candidates[0].scale
    rotations = np.array([pose.rotation for pose in candidates])  # (c, 3, 3)
    shifts = np.array([pose.translation for pose in candidates])  # (c, 3)
    floor = np.hypot(prior.deviation, prior.edge)
    alive = np.arange(len(candidates))
    score = np.full(len(candidates), np.inf)
    for round_number in range(ROUNDS):
        turn, shift = rotations[alive], shifts[alive]
        # Into the model's frame: x = R^T (y - t) / s.
        own = np.einsum("cji,cnj->cni", turn, samples[None] - shift[:, None]) / scale
        found, nearest = tree.query(own.reshape(-1, 3))
        distance = np.asarray(found).reshape(len(alive), -1)
        spread = np.maximum(np.median(distance, axis=1), floor)[:, None]
        score[alive] = np.log1p((distance / floor) ** 2 / 3.0).mean(axis=1)
        weights = 1.0 / (3.0 + (distance / spread) ** 2)
        weights /= weights.sum(axis=1, keepdims=True)
        model = prior.model.mean[nearest].reshape(len(alive), -1, 3)
        model_centre = np.einsum("cn,cni->ci", weights, model)
        data_centre = weights @ samples
        correlation = np.einsum(
            "cn,cni,cnj->cij",
            weights,
            model - model_centre[:, None],
            samples[None] - data_centre[:, None],
            optimize=True,
        )
        rotations[alive], _ = best_rotations(correlation)
        shifts[alive] = data_centre - scale * np.einsum(
            "cij,cj->ci", rotations[alive], model_centre
        )
        if round_number in (5, 10, 15):  # the worse half of the candidates is given up
            order = np.argsort(score[alive], kind="stable")
            alive = alive[order[: max(len(order) // 2, KEPT)]]
    kept: list[Pose] = []
    for k in alive[np.argsort(score[alive], kind="stable")]:
        pose = Pose(scale, rotations[k], shifts[k])
        if all(_differ(pose, other, prior.edge) for other in kept):
            kept.append(pose)
        if len(kept) == KEPT:
            break
    return tuple(kept)


def _differ(first: Pose, second: Pose, edge: float) -> bool:
    turn = Rotation.from_matrix(first.rotation @ second.rotation.T).magnitude()
    shift = float(np.linalg.norm(first.translation - second.translation))
    return bool(turn > SAME_TURN or (turn < 1e-3 and shift > 5.0 * edge))
