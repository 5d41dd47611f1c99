"""Facts about subjects as numbers: continuous and categorical columns of a sheet.

A sheet has one row per shape. What is compared are subjects, so a column must say the same thing
in all rows of a subject.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Annotated

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.errors import InputError
from ostiform.values import Axes, value

MISSING = frozenset({"", "na", "n/a", "nan", "none", "null", "?", "-"})
"""What a cell without a value holds, in small letters."""

FEWEST_PER_LEVEL = 2
"""Subjects that a category needs: with one, its mean and its scatter are the same subject."""


@value
class Covariate:
    """One fact about every subject.

    Attributes
    ----------
    name : str
        The column.
    values : (S,) float64
        The numbers of a continuous covariate; the indices into `levels` of a categorical one.
    levels : tuple of str
        The categories, the reference first; empty for a continuous covariate.
    """

    name: str
    values: Annotated[FloatArray, Axes("S")]
    levels: tuple[str, ...] = ()

    @property
    def is_categorical(self) -> bool:
        """Whether the values are categories."""
        return bool(self.levels)

    def columns(self) -> tuple[FloatArray, tuple[str, ...]]:
        """Return the columns (S, q) of a design and their names.

        A continuous covariate is one column, its values about their mean; a categorical one has
        one column of 0 and 1 for every category but the reference.
        """
        if not self.levels:
            return (self.values - self.values.mean())[:, None], (self.name,)
        numbers = np.arange(1, len(self.levels))
        columns = (self.values[:, None] == numbers).astype(np.float64)
        names = tuple(f"{self.name}: {level} - {self.levels[0]}" for level in self.levels[1:])
        return columns, names


def subject_values(
    rows: Sequence[tuple[str, Mapping[str, str]]], column: str
) -> dict[str, str | None]:
    """Return what a column says about every subject, None where it says nothing.

    Parameters
    ----------
    rows : sequence of (subject, mapping of column to cell)
    column : str

    Raises
    ------
    InputError
        If there is no such column, or it says two things about one subject.
    """
    names = sorted({name for _, cells in rows for name in cells})
    if column not in names:
        raise InputError(
            f'covariate "{column}": expected a column of the sheet, found '
            f"{', '.join(names) if names else 'no further columns'}"
        )
    found: dict[str, str | None] = {}
    for subject, cells in rows:
        cell = cells.get(column, "").strip()
        value = None if cell.lower() in MISSING else cell
        known = found.setdefault(subject, value)
        if known is None:
            found[subject] = value
        elif value is not None and value != known:
            raise InputError(
                f'covariate "{column}": expected one value per subject, found {known} and {value} '
                f"for subject {subject}: give every row of a subject the same, or choose one phase"
            )
    return found


def complete_subjects(
    subjects: Sequence[str], columns: Mapping[str, Mapping[str, str | None]]
) -> tuple[list[str], dict[str, str]]:
    """Return the subjects that have every value, and why each of the others is left out.

    Parameters
    ----------
    subjects : sequence of str
    columns : mapping of str to mapping of str to (str or None)
        For every covariate what `subject_values` returned.
    """
    left_out = {}
    for subject in subjects:
        missing = [name for name, values in columns.items() if values.get(subject) is None]
        if missing:
            left_out[subject] = f"no value of {', '.join(missing)}"
    return [subject for subject in subjects if subject not in left_out], left_out


def covariate_of(name: str, texts: Sequence[str], is_categorical: bool | None = None) -> Covariate:
    """Return a column of texts as a covariate.

    A column whose cells are all numbers (decimal point or comma) is continuous, any other one
    categorical. The first category in alphabetical order is the reference.

    Parameters
    ----------
    name : str
    texts : (S,) sequence of str
        None missing.
    is_categorical : bool, optional
        Says which, where the cells do not: groups that are numbered, for example.

    Raises
    ------
    InputError
        If a number was asked for and a cell is none, or the covariate does not vary, or a
        category has one subject only.
    """
    numbers = [_number(text) for text in texts]
    unreadable = [text for text, value in zip(texts, numbers, strict=True) if value is None]
    if is_categorical is False and unreadable:
        raise InputError(
            f'covariate "{name}": expected numbers, found "{unreadable[0]}": correct the cell, or '
            "treat the column as categorical"
        )
    if is_categorical is None:
        is_categorical = bool(unreadable)
    if len(set(texts)) < 2:
        raise InputError(
            f'covariate "{name}": expected it to differ between subjects, found '
            f"{f'only {texts[0]}' if texts else 'no subject'}"
        )
    if not is_categorical:
        return Covariate(name, np.array([value for value in numbers if value is not None]))
    levels = tuple(sorted(set(texts)))
    for level in levels:
        count = sum(text == level for text in texts)
        if count < FEWEST_PER_LEVEL:
            raise InputError(
                f'covariate "{name}": expected at least {FEWEST_PER_LEVEL} subjects in every '
                f'category, found {count} in "{level}": leave the subject out or merge categories'
            )
    return Covariate(name, np.array([levels.index(text) for text in texts], dtype=float), levels)


def _number(text: str) -> float | None:
    try:
        value = float(text.replace(",", "."))
    except ValueError:
        return None
    return value if math.isfinite(value) else None
