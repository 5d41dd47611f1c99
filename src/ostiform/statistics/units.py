"""One shape per subject: what the statistics compare, however many phases a subject has.

Phases of one heart are not independent of each other, so a test that shuffled them as if they
were would find differences that are none. A subject counts once: by its mean over the cycle, or
by one chosen phase.
"""

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.errors import InputError
from ostiform.model import StoredModel, phase_weights
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
    if phase is not None:
        return _of_phase(stored.ids, stored.scores, phase)
    names = tuple(dict.fromkeys(id.subject for id in stored.ids))
    share = phase_weights(stored.ids) * len(names)  # sums to one within a subject
    scores = np.zeros((len(names), stored.scores.shape[1]))
    np.add.at(
        scores, [names.index(id.subject) for id in stored.ids], share[:, None] * stored.scores
    )
    several = len(names) < len(stored.ids)
    return SubjectShapes(names, scores, "mean over the cycle" if several else "the one shape")


def _of_phase(ids: Sequence[ShapeId], scores: FloatArray, phase: str) -> SubjectShapes:
    rows = [row for row, id in enumerate(ids) if id.phase == phase]
    if not rows:
        known = ", ".join(dict.fromkeys(id.phase for id in ids))
        raise InputError(f"phase of the subjects: expected one of {known}, found {phase}")
    return SubjectShapes(tuple(ids[row].subject for row in rows), scores[rows], f"phase {phase}")
