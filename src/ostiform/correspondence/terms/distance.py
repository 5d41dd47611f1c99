"""Level 1: the smallest weighted distance to a reference shape (HY 2.3)."""

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.correspondence.terms.quadratic_form import QuadraticForm, form_value, no_motions

# Relative difference of mean distances below which shapes count as equally central: the tie is
# broken by coordinates, so that the reference does not depend on the order of the files.
TIE = 1e-9


def medoid(aligned: FloatArray, weights: FloatArray) -> int:
    """Return the index of the shape with the least sum of squared distances to all others.

    Parameters
    ----------
    aligned : (N, P, 3) float64, mm
    weights : (P,) float64
    """
    scaled = ((aligned - aligned.mean(axis=0)) * np.sqrt(weights)[:, None]).reshape(
        len(aligned), -1
    )
    squared = np.einsum("ik,ik->i", scaled, scaled)  # (N,) distance to the mean, up to a constant
    tied = np.flatnonzero(squared <= squared.min() + TIE * squared.mean())
    return int(min(tied, key=lambda index: tuple(aligned[index].ravel())))


def root_mean_square_spread(aligned: FloatArray, weights: FloatArray) -> float:
    """Return the root mean square distance (mm) per point of shapes from their mean."""
    squared = ((aligned - aligned.mean(axis=0)) ** 2).sum(axis=2)  # (N, P)
    return float(np.sqrt((squared @ weights).mean()))


def euclidean_form(target: FloatArray, weights: FloatArray, variance: float) -> QuadraticForm:
    """Return the weighted squared distance to a target in units of a variance (mm^2)."""
    return QuadraticForm(
        target,
        np.sqrt(weights),
        1.0 / variance,
        np.zeros((0, 3 * len(target))),
        np.zeros(0),
        *no_motions(target),
    )


def euclidean_forms(
    aligned: FloatArray, shares: FloatArray, reference: int, unit_mm: float
) -> tuple[QuadraticForm, ...]:
    """Return ``E_i = sum_p (w_ip + w_rp) / 2 |x_ip - x_rp|^2 / unit^2`` of every shape.

    Parameters
    ----------
    aligned : (N, P, 3) float64, mm
    shares : (N, P) float64
        Area share of every point on every shape.
    reference : int
    unit_mm : float
    """
    return tuple(
        euclidean_form(aligned[reference], 0.5 * (share + shares[reference]), unit_mm**2)
        for share in shares
    )


def euclidean_value(forms: tuple[QuadraticForm, ...], aligned: FloatArray) -> float:
    """Return the sum of the shapes' forms divided by N - 1."""
    total = sum(form_value(form, shape) for form, shape in zip(forms, aligned, strict=True))
    return total / max(len(aligned) - 1, 1)
