"""What is tested and what is adjusted for, as orthonormal columns."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.errors import InputError
from ostiform.statistics.covariates import Covariate
from ostiform.values import Axes, value

COLLINEAR = 1e-9
"""Least norm of a column beyond the columns before it, over its own norm: far above rounding."""


@value
class Design:
    """A linear model of subjects: ``Y = Z g + X b + noise``.

    Attributes
    ----------
    interest : (S, q) float64
        X, the columns under test.
    nuisance : (S, r) float64
        Z, the constant first, then what is adjusted for.
    names : tuple of str, q
        Of the columns of X.
    adjusted : tuple of str
        The covariates in Z.
    """

    interest: Annotated[FloatArray, Axes("S", "names")]
    nuisance: Annotated[FloatArray, Axes("S", None)]
    names: Annotated[tuple[str, ...], Axes("names")]
    adjusted: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check what annotations cannot say."""
        if self.degrees < 1:
            raise InputError(
                f"a linear model: expected more subjects than its "
                f"{self.interest.shape[1] + self.nuisance.shape[1]} columns, "
                f"found {len(self.nuisance)}: add subjects or adjust for less"
            )
        _orthonormal(np.concatenate([self.nuisance, self.interest], axis=1), self)

    @property
    def degrees(self) -> int:
        """Degrees of freedom of the noise: S - r - q."""
        return len(self.nuisance) - int(self.nuisance.shape[1]) - int(self.interest.shape[1])

    def bases(self) -> tuple[FloatArray, FloatArray]:
        """Return orthonormal bases of Z (S, r) and of what X adds to it (S, q)."""
        both = np.concatenate([self.nuisance, self.interest], axis=1)
        basis = _orthonormal(both, self)
        rank = self.nuisance.shape[1]
        return basis[:, :rank], basis[:, rank:]

    def coefficients(self, values: FloatArray) -> FloatArray:
        """Return b (q, ...) of values (S, ...) by least squares, per unit of each column of X."""
        both = np.concatenate([self.nuisance, self.interest], axis=1)
        flat = values.reshape(len(values), -1)
        solved = np.linalg.lstsq(both, flat, rcond=None)[0][self.nuisance.shape[1] :]
        found: FloatArray = solved.reshape(-1, *values.shape[1:])
        return found


def design_of(interest: Covariate, adjusted: Sequence[Covariate] = ()) -> Design:
    """Return the design that tests one covariate and adjusts for others.

    Raises
    ------
    InputError
        If the covariate is explained by those adjusted for, or there are too few subjects.
    """
    columns, names = interest.columns()
    nuisance = [np.ones((len(interest.values), 1))]
    nuisance += [covariate.columns()[0] for covariate in adjusted]
    return Design(
        interest=columns,
        nuisance=np.concatenate(nuisance, axis=1),
        names=names,
        adjusted=tuple(covariate.name for covariate in adjusted),
    )


def permutations(n_subjects: int, count: int, rng: np.random.Generator) -> IntArray:
    """Return random orders (count, S) of the subjects, each drawn anew.

    Raises
    ------
    InputError
        If there is less than one.
    """
    if count < 1:
        raise InputError(f"permutations: expected at least 1, found {count}")
    orders = np.tile(np.arange(n_subjects), (count, 1))
    shuffled: IntArray = rng.permuted(orders, axis=1)
    return shuffled


def _orthonormal(columns: FloatArray, design: Design) -> FloatArray:
    basis, triangle = np.linalg.qr(columns)
    lengths = np.linalg.norm(columns, axis=0)
    if (np.abs(np.diag(triangle)) <= COLLINEAR * np.maximum(lengths, 1e-300)).any():
        raise InputError(
            f"a linear model of {', '.join(design.names)}"
            + (f" adjusted for {', '.join(design.adjusted)}" if design.adjusted else "")
            + ": expected columns that are not explained by the others, found one that is: leave "
            "out one of the covariates"
        )
    result: FloatArray = basis
    return result
