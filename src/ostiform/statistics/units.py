"""One shape per subject: what the statistics compare, however many phases a subject has.

Phases of one heart are not independent of each other, so a test that shuffled them as if they
were would find differences that are none. A subject counts once: by its mean over the cycle, or
by one chosen phase.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.errors import InputError
from ostiform.model import StoredModel, SurfaceField, phase_weights
from ostiform.study import ShapeId
from ostiform.values import Axes, value


@value
class SubjectShapes:
    """One shape per subject, as scores of a model.

    Attributes
    ----------
    subjects : tuple of str
    scores : (S, K) float64, mm
    what : str
        What stands for a subject: its mean over the cycle, or a phase.
    """

    subjects: Annotated[tuple[str, ...], Axes("S")]
    scores: Annotated[FloatArray, Axes("S", "K")]
    what: str

    def chosen(self, subjects: Sequence[str]) -> "SubjectShapes":
        """Return the shapes of some of the subjects, in the order given."""
        rows = [self.subjects.index(subject) for subject in subjects]
        return SubjectShapes(tuple(subjects), self.scores[rows], self.what)


@value
class SubjectField:
    """One field, one surface per subject.

    Attributes
    ----------
    name, units : str
    subjects : tuple of str
    values : (S, P) float64
        NaN where a subject has none.
    what : str
        As `SubjectShapes`.
    """

    name: str
    units: str
    subjects: Annotated[tuple[str, ...], Axes("S")]
    values: Annotated[FloatArray, Axes("S", "P", gaps=True)]
    what: str

    def chosen(self, subjects: Sequence[str]) -> "SubjectField":
        """Return the field of some of the subjects, in the order given."""
        rows = [self.subjects.index(subject) for subject in subjects]
        return replace(self, subjects=tuple(subjects), values=self.values[rows])


def subject_shapes(stored: StoredModel, phase: str | None = None) -> SubjectShapes:
    """Return one shape per subject of a model's training shapes.

    Parameters
    ----------
    stored : StoredModel
    phase : str, optional
        The phase that stands for every subject; subjects without it are left out. If absent, the
        mean over the cycle does, every phase weighted by the share of the cycle it stands for.

    Raises
    ------
    InputError
        If the training shapes are not known, or no subject has the phase.
    """
    if not stored.ids:
        raise InputError(
            "shapes of subjects: expected a model with the scores of its training shapes, found "
            "none in it"
        )
    return SubjectShapes(*_one_per_subject(stored.ids, stored.scores, phase))


def subject_field(
    ids: Sequence[ShapeId], field: SurfaceField, phase: str | None = None
) -> SubjectField:
    """Return one surface per subject of a field of shapes, as `subject_shapes`.

    Subjects without any value are left out; a phase without a value at a point has no say there.

    Raises
    ------
    InputError
        If the field holds labels, or no subject has the phase.
    """
    if field.is_label:
        raise InputError(
            f"field {field.name}: expected numbers to test, found labels: state it with "
            'kind = "number" where they measure something, as 0 and 1 of a scar'
        )
    subjects, values, what = _one_per_subject(ids, field.values, phase)
    rows = np.flatnonzero(~np.isnan(values).all(axis=1))
    known = tuple(subjects[row] for row in rows)
    return SubjectField(field.name, field.units, known, values[rows], what)


def _one_per_subject(
    ids: Sequence[ShapeId], values: FloatArray, phase: str | None
) -> tuple[tuple[str, ...], FloatArray, str]:
    if phase is not None:
        return _of_phase(ids, values, phase)
    names = tuple(dict.fromkeys(id.subject for id in ids))
    share = phase_weights(ids) * len(names)  # sums to one within a subject
    rows = [names.index(id.subject) for id in ids]
    known = ~np.isnan(values)
    sums = np.zeros((len(names), values.shape[1]))
    np.add.at(sums, rows, share[:, None] * np.where(known, values, 0.0))
    if not known.all():
        held = np.zeros_like(sums)
        np.add.at(held, rows, share[:, None] * known)
        sums = np.where(held > 0.0, sums / np.where(held > 0.0, held, 1.0), np.nan)
    what = "mean over the cycle" if len(names) < len(ids) else "the one shape"
    return names, sums, what


def _of_phase(
    ids: Sequence[ShapeId], values: FloatArray, phase: str
) -> tuple[tuple[str, ...], FloatArray, str]:
    rows = [row for row, id in enumerate(ids) if id.phase == phase]
    if not rows:
        known = ", ".join(dict.fromkeys(id.phase for id in ids))
        raise InputError(f"phase of the subjects: expected one of {known}, found {phase}")
    return tuple(ids[row].subject for row in rows), values[rows], f"phase {phase}"
