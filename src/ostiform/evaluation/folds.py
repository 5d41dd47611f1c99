"""How a population is divided for cross-validation (design 6; HY 2.4 leaves out one subject)."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from ostiform.arrays import IntArray
from ostiform.errors import InputError
from ostiform.study import ShapeId

FEWEST_SUBJECTS = 3
"""With fewer subjects, leaving one out trains on a single subject or on none."""

MOST_SUBJECT_FOLDS = 20
GROUPED_FOLDS = 10
PHASE_BLOCKS = 5


class Division(Enum):
    """What is left out together; the value is the sentence shown with the results."""

    SUBJECTS = "every subject left out in turn, with all its phases"
    SUBJECT_GROUPS = "groups of whole subjects left out in turn"
    PHASE_BLOCKS = (
        f"contiguous blocks of phases left out in turn: fewer than {FEWEST_SUBJECTS} subjects, so "
        "no subject is new to the model and no interval can be given"
    )


@dataclass(frozen=True, slots=True)
class Fold:
    """One division into training and test shapes, indices in study order.

    Attributes
    ----------
    label : str
        What is left out.
    train, test : tuple of int
    """

    label: str
    train: tuple[int, ...]
    test: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Folds:
    """All folds of a cross-validation: every shape is tested exactly once, by others only.

    Attributes
    ----------
    division : Division
    count : int
        Number of shapes.
    folds : tuple of Fold
    """

    division: Division
    count: int
    folds: tuple[Fold, ...]

    def __post_init__(self) -> None:
        """Check that every shape is tested exactly once and never by itself."""
        tested = sorted(index for fold in self.folds for index in fold.test)
        if tested != list(range(self.count)):
            raise InputError(
                f"folds: expected each of {self.count} shapes to be tested exactly once, "
                f"found {len(tested)} tests of {len(set(tested))} shapes"
            )
        for fold in self.folds:
            shared = set(fold.train) & set(fold.test)
            if shared:
                raise InputError(
                    f"fold {fold.label}: expected no shape in its own training set, found "
                    f"shape {min(shared)} in both"
                )

    def mode_counts(self, most: int) -> tuple[int, ...]:
        """Return the numbers of modes, from 0 to at most so many, that every fold's model has.

        A model of n shapes has n - 1 modes; with more, averages over the numbers of modes would
        count the last one several times.
        """
        return tuple(range(min(most, min(len(fold.train) for fold in self.folds) - 1) + 1))


def cross_validation_folds(ids: Sequence[ShapeId], most: int | None = None) -> Folds:
    """Divide shapes for leave-one-subject-out cross-validation.

    One fold per subject; of more than 20 subjects, 10 folds of whole subjects, dealt in study
    order; of fewer than 3 subjects, 5 contiguous blocks of each subject's phases in order of
    time (fewer where a subject has fewer phases).

    Parameters
    ----------
    ids : (N,) sequence of ShapeId
    most : int, optional
        Most folds, at least 2, in place of the 20, 10 and 5: as many groups of whole subjects
        where there are more subjects.

    Raises
    ------
    InputError
        If a fold would train on fewer than two shapes.
    """
    subjects = list(dict.fromkeys(id.subject for id in ids))
    if len(subjects) < FEWEST_SUBJECTS:
        blocks = PHASE_BLOCKS if most is None else max(most // len(subjects), 1)
        division, groups = Division.PHASE_BLOCKS, _phase_blocks(ids, subjects, blocks)
    elif len(subjects) <= (MOST_SUBJECT_FOLDS if most is None else most):
        division, groups = Division.SUBJECTS, [(s, _of_subjects(ids, [s])) for s in subjects]
    else:
        division, count = Division.SUBJECT_GROUPS, GROUPED_FOLDS if most is None else most
        groups = [
            (f"group {number + 1}", _of_subjects(ids, subjects[number::count]))
            for number in range(count)
        ]
    folds = []
    for label, test in groups:
        train = np.setdiff1d(np.arange(len(ids)), test)
        if len(train) < 2:
            raise InputError(
                f"cross-validation: expected at least 2 training shapes, found {len(train)} when "
                f"{label} is left out of {len(ids)} shapes; add shapes to the study"
            )
        folds.append(Fold(label, tuple(map(int, train)), tuple(map(int, test))))
    return Folds(division, len(ids), tuple(folds))


def _of_subjects(ids: Sequence[ShapeId], subjects: Sequence[str]) -> IntArray:
    chosen = set(subjects)
    return np.array([index for index, id in enumerate(ids) if id.subject in chosen], dtype=np.int64)


def _phase_blocks(
    ids: Sequence[ShapeId], subjects: Sequence[str], count: int
) -> list[tuple[str, IntArray]]:
    blocks = []
    for subject in subjects:
        indices = _of_subjects(ids, [subject])
        times = np.array([ids[index].time for index in indices])
        ordered = indices[np.argsort(times, kind="stable")]
        for block in np.array_split(ordered, min(count, len(ordered))):
            first, last = ids[block[0]], ids[block[-1]]
            name = f"{subject}, phases {first.phase} to {last.phase}" if first.phase else subject
            blocks.append((name, np.sort(block)))
    return blocks
