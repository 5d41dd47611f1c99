"""The landmarks that a study states, as the correspondence takes them."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.correspondence import SurfaceMarks
from ostiform.errors import InputError
from ostiform.exchange import read_landmarks
from ostiform.pipeline.store import file_hash
from ostiform.study import MIRROR, ShapeId, Study, filled_name, internal_factors


def stated_marks(study: Study, ids: Sequence[ShapeId]) -> tuple[SurfaceMarks | None, ...]:
    """Return the landmarks of each shape in mm (LPS); None for a shape without a file.

    A landmark's own uncertainty counts where its file has one (the root mean square of its three
    deviations), else the study's.

    Raises
    ------
    InputError
        If a file is wrong, or no shape has one although the study names them.
    """
    paths = [_path(study, id) for id in ids]
    reflected = {entry.id for entry in study.entries if entry.reflect}
    found = tuple(
        None if path is None else _marks(study, path, MIRROR if id in reflected else np.ones(3))
        for id, path in zip(ids, paths, strict=True)
    )
    if study.settings.landmarks.file is not None and all(marks is None for marks in found):
        raise InputError(
            f"{study.path.name}: landmarks.file: expected the landmarks of some shape at "
            f'"{study.settings.landmarks.file}" in {study.folder}, found none'
        )
    return found


def landmark_inputs(study: Study, ids: Sequence[ShapeId]) -> list[object]:
    """Return what the landmarks of a study depend on, for a key; empty without landmarks."""
    if study.settings.landmarks.file is None:
        return []
    paths = [_path(study, id) for id in ids]
    return [
        study.settings.landmarks.sd_mm,
        [None if path is None else file_hash(path) for path in paths],
    ]


def _path(study: Study, id: ShapeId) -> Path | None:
    stated = study.settings.landmarks.file
    if stated is None:
        return None
    name = filled_name(stated, {"subject": id.subject, "phase": id.phase})
    if name is None:
        raise InputError(
            f"{study.path.name}: landmarks.file: expected the fields {{subject}} and {{phase}}, "
            f'found "{stated}"'
        )
    path = study.folder / name
    return path if path.is_file() else None


def _marks(study: Study, path: Path, mirror: FloatArray) -> SurfaceMarks:
    marks = read_landmarks(path)
    factors = internal_factors(study.settings) * mirror
    size = float(abs(factors[0]))  # millimetres of a unit of the files
    return SurfaceMarks(
        names=tuple(mark.name for mark in marks),
        positions=np.stack([mark.position for mark in marks]) * factors,
        sd_mm=np.array(
            [
                study.settings.landmarks.sd_mm
                if mark.covariance is None
                else size * float(np.sqrt(np.trace(mark.covariance) / 3.0))
                for mark in marks
            ]
        ),
    )
