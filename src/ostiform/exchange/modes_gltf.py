"""The modes of a model and its mean cycle as glTF that viewers play."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.linalg import svd

from ostiform.arrays import FloatArray
from ostiform.errors import InputError
from ostiform.exchange.gltf import MorphTarget, SceneMesh, WeightAnimation, write_glb
from ostiform.model import ModelMesh, ShapeModel, StoredModel, reconstruct

SWING = 2.0
"""Standard deviations of a swing to either side (HY Fig. 3)."""
SWING_SECONDS = 3.0
SWING_STEPS = 24
CYCLE_SECONDS = 1.0
MOST_TARGETS = 8
"""Of a cycle: as many as every viewer plays."""


@dataclass(frozen=True, slots=True, eq=False)
class CycleFrames:
    """One closed cycle of shapes on a model's mesh.

    Attributes
    ----------
    times : (T,) float64
        Fractions of the cycle, increasing, in [0, 1).
    shapes : (T, P, 3) float64, mm
    """

    times: FloatArray
    shapes: FloatArray


def write_modes_glb(path: Path, model: ShapeModel, n_modes: int = 5) -> None:
    """Write the mean with the first modes as morph targets, and one animation per mode.

    A weight of 1 is one standard deviation. The animation ``mode 1`` swings from the mean to +2
    and -2 standard deviations and back in 3 s.

    Raises
    ------
    InputError
        If the model has no modes or no triangles.
    ArtifactError
        If the file cannot be written.
    """
    count = min(n_modes, len(model.modes))
    if count < 1:
        raise InputError(f"modes as glTF: expected at least 1 mode, found {count}")
    spread = np.sqrt(model.variances[:count])
    targets = [MorphTarget(f"mode {k + 1}", spread[k] * model.modes[k]) for k in range(count)]
    turn = np.arange(SWING_STEPS + 1) / SWING_STEPS
    animations = [
        WeightAnimation(
            f"mode {k + 1}",
            SWING_SECONDS * turn,
            np.outer(SWING * np.sin(2.0 * np.pi * turn), np.arange(count) == k),
        )
        for k in range(count)
    ]
    facts = {
        "unit of a weight": "standard deviation",
        "standard deviations (mm RMS)": [round(float(value), 6) for value in spread],
    }
    write_glb(path, _scene(model.mean, model.mesh), targets, animations, facts)


def mean_cycle_frames(stored: StoredModel) -> CycleFrames | None:
    """Return the mean cycle of a model's training shapes at the times of its subjects.

    At each time that any subject has, the mean over the subjects of their scores, linear between
    the phases of each (closed). None where no subject has at least two phases.
    """
    subjects = [
        [index for index, id in enumerate(stored.ids) if id.subject == name]
        for name in dict.fromkeys(id.subject for id in stored.ids)
    ]
    cycles = [
        sorted(own, key=lambda index: stored.ids[index].time)
        for own in subjects
        if len({stored.ids[index].time for index in own}) > 1
    ]
    if not cycles:
        return None
    times = np.unique([stored.ids[index].time for own in cycles for index in own])
    scores = np.zeros((len(times), stored.scores.shape[1]))
    for own in cycles:
        known = np.array([stored.ids[index].time for index in own])
        for mode in range(scores.shape[1]):
            scores[:, mode] += np.interp(times, known, stored.scores[own, mode], period=1.0)
    return CycleFrames(times, reconstruct(stored.model, scores / len(cycles)))


def write_cycle_glb(
    path: Path,
    mesh: ModelMesh,
    frames: CycleFrames,
    seconds: float = CYCLE_SECONDS,
    most_targets: int = MOST_TARGETS,
) -> float:
    """Write a cycle of shapes as a mesh with one looping animation named ``cycle``.

    The morph targets are the principal components of the frames: viewers play few targets, and
    a cycle has few directions. Returned, and kept as ``extras``, is the largest distance of a
    point from where its frame has it.

    Parameters
    ----------
    path : Path
    mesh : ModelMesh
    frames : CycleFrames
        At least two.
    seconds : float
        Length of the cycle.
    most_targets : int

    Raises
    ------
    InputError
        If there are fewer than two frames, or the mesh has no triangles.
    ArtifactError
        If the file cannot be written.
    """
    if len(frames.shapes) < 2:
        raise InputError(f"a cycle as glTF: expected at least 2 frames, found {len(frames.shapes)}")
    rest = frames.shapes[0]
    offsets = (frames.shapes - rest).reshape(len(frames.shapes), -1)  # (T, 3P)
    left, singular, right = svd(offsets, full_matrices=False)
    count = min(most_targets, int((singular > 1e-9 * max(singular[0], 1e-300)).sum()))
    amounts = left[:, :count] * singular[:count]  # (T, K)
    largest = np.maximum(np.abs(amounts).max(axis=0, initial=0.0), np.finfo(np.float64).tiny)
    weights = amounts / largest
    targets = [
        MorphTarget(f"component {k + 1}", (largest[k] * right[k]).reshape(rest.shape))
        for k in range(count)
    ]
    error = float(np.linalg.norm((amounts @ right[:count] - offsets).reshape(-1, 3), axis=1).max())
    closed_times = seconds * (np.append(frames.times, frames.times[0] + 1.0) - frames.times[0])
    animation = WeightAnimation("cycle", closed_times, np.vstack([weights, weights[:1]]))
    write_glb(
        path,
        _scene(rest, mesh),
        targets,
        [animation],
        {"largest error (mm)": error, "seconds": seconds},
    )
    return error


def _scene(vertices: FloatArray, mesh: ModelMesh) -> SceneMesh:
    return SceneMesh(vertices, mesh.faces, mesh.face_part, mesh.parts)
