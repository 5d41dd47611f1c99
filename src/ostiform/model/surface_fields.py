"""Quantities of the surface (voltage, thickness, regions) at corresponding points."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.errors import InputError
from ostiform.values import Axes, value


@value
class SurfaceField:
    """One quantity at the P points of every shape.

    Attributes
    ----------
    name : str
    units : str
        Empty where it has none, or they are not known.
    is_label : bool
        Whether the values name things (regions) instead of measuring.
    values : (N, P) float64
        NaN where a shape has no value.
    """

    name: str
    units: str
    is_label: bool
    values: Annotated[FloatArray, Axes("N", "P", gaps=True)]

    @property
    def title(self) -> str:
        """The name with the units."""
        return f"{self.name} ({self.units})" if self.units else self.name


@value
class FieldSummary:
    """A field over a population, point by point.

    Attributes
    ----------
    middle : (P,) float64
        The mean of the shapes that have a value; of labels the most frequent, the least of several.
    spread : (P,) float64
        Their standard deviation, NaN for fewer than two; of labels the share that has `middle`.
    count : (P,) int64
        Shapes that have a value.
    """

    middle: Annotated[FloatArray, Axes("P", gaps=True)]
    spread: Annotated[FloatArray, Axes("P", gaps=True)]
    count: Annotated[IntArray, Axes("P")]

    def arrays(self, field: SurfaceField) -> dict[str, np.ndarray]:
        """Return the summary as arrays of a file, named after its field."""
        spread = "share" if field.is_label else "sd"
        return {
            field.name: self.middle,
            f"{field.name} {spread}": self.spread,
            f"{field.name} count": self.count,
        }


def field_summary(field: SurfaceField) -> FieldSummary:
    """Return the mean and spread of a field over its shapes; missing values are left out."""
    known = ~np.isnan(field.values)
    count = known.sum(axis=0)
    lacking = np.where(count == 0, np.nan, 0.0)
    if field.is_label:
        labels = np.unique(field.values[known])
        votes = np.array([(field.values == label).sum(axis=0) for label in labels])  # (L, P)
        votes = votes.reshape(len(labels), len(count))
        if not len(labels):
            return FieldSummary(lacking, lacking, count)
        middle = labels[votes.argmax(axis=0)] + lacking
        return FieldSummary(middle, votes.max(axis=0) / np.maximum(count, 1) + lacking, count)
    filled = np.where(known, field.values, 0.0)
    middle = filled.sum(axis=0) / np.maximum(count, 1) + lacking
    squared = np.where(known, field.values - middle, 0.0) ** 2
    spread = np.sqrt(squared.sum(axis=0) / np.maximum(count - 1, 1))
    return FieldSummary(middle, np.where(count < 2, np.nan, spread), count)


def field_named(fields: Sequence[SurfaceField], name: str) -> SurfaceField:
    """Return a field by its name.

    Raises
    ------
    InputError
        If there is none of that name.
    """
    for field in fields:
        if field.name == name:
            return field
    raise InputError(
        f"field {name}: expected one of {', '.join(f.name for f in fields) or 'no fields'}, found "
        "none of that name: name it in [fields] of the study and build again"
    )
