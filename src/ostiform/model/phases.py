"""When the phases of a cycle are, and how much of the cycle each of them stands for."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.errors import InputError
from ostiform.study import ShapeId


def phase_weights(ids: Sequence[ShapeId]) -> FloatArray:
    """Return the weight (N,) of every shape: 1 / S per subject, shared by the cycle's course.

    Within a subject a phase stands for half of the way to the phase before and half of the way
    to the phase after, on the closed cycle (design 6).
    """
    subjects = np.array([id.subject for id in ids])
    times = np.array([id.time for id in ids])
    weights = np.empty(len(ids))
    names = np.unique(subjects)
    for name in names:
        chosen = np.flatnonzero(subjects == name)
        order = chosen[np.argsort(times[chosen], kind="stable")]
        to_next = np.diff(times[order], append=times[order[0]] + 1.0)  # (n,)
        weights[order] = 0.5 * (to_next + np.roll(to_next, 1)) / len(names)
    return weights


def with_landmarks_aligned(
    ids: Sequence[ShapeId], landmarks: Mapping[str, Sequence[float]]
) -> tuple[ShapeId, ...]:
    """Return the shapes with times warped so that landmarks in time fall together.

    The time of every subject is mapped piecewise linearly, 0 to 0 and 1 to 1, so that each of its
    landmarks (end-systole, say) goes to the mean of that landmark over the subjects.

    Parameters
    ----------
    ids : sequence of ShapeId
    landmarks : mapping of str to sequence of float
        For every subject the same number of increasing fractions of the cycle, within (0, 1).

    Raises
    ------
    InputError
        If a subject has none, or they are not increasing or not within the cycle, or their number
        differs.
    """
    subjects = sorted({id.subject for id in ids})
    for subject in subjects:
        found = landmarks.get(subject)
        if found is None or len(found) != len(landmarks[subjects[0]]):
            raise InputError(
                f"landmarks in time of subject {subject}: expected as many as subject "
                f"{subjects[0]} has, found {'none' if found is None else len(found)}"
            )
        if (np.diff([0.0, *found, 1.0]) <= 0.0).any():
            raise InputError(
                f"landmarks in time of subject {subject}: expected increasing fractions of the "
                f"cycle between 0 and 1, found {', '.join(f'{time:g}' for time in found)}"
            )
    means = np.mean([landmarks[subject] for subject in subjects], axis=0)
    target = np.concatenate([[0.0], means, [1.0]])
    warped = []
    for id in ids:
        source = np.concatenate([[0.0], landmarks[id.subject], [1.0]])
        warped.append(replace(id, time=float(np.interp(id.time, source, target))))
    return tuple(warped)
