"""The simplified description length of a set of shapes and its quadratic majoriser (design 5).

``F = sum_m [1 + log(l_m / l_cut) if l_m >= l_cut, l_m / l_cut otherwise]`` over the eigenvalues
l_m (mm^2 per point) of the covariance of the aligned, centred, sqrt(weight)-scaled landmarks
(Thodberg 2003; Davies et al. 2002). F is a concave spectral function of the covariance C, so
``F(C') <= F(C) + <G, C' - C>`` with ``G = Q diag(min(1 / l_m, 1 / l_cut)) Q^T``: a quadratic form
in the landmarks that touches F where it was built.
"""

from typing import Annotated

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.correspondence.terms.quadratic_form import (
    QuadraticForm,
    form_product,
    no_motions,
)
from ostiform.errors import InputError
from ostiform.values import Axes, value


@value
class Spectrum:
    """Eigenvalues and eigenvectors of the covariance of weighted landmarks.

    Attributes
    ----------
    mean : (P, 3) float64, mm
    eigenvalues : (M,) float64, mm^2 per point
        In descending order; M = min(N - 1, 3 P).
    modes : (M, 3P) float64
        Orthonormal rows in the space of sqrt(weight)-scaled landmarks.
    """

    mean: Annotated[FloatArray, Axes(None, 3)]
    eigenvalues: Annotated[FloatArray, Axes("M")]
    modes: Annotated[FloatArray, Axes("M", None)]


def cut_off_eigenvalue(noise_mm: float, n_shapes: int, n_points: int) -> float:
    """Return l_cut (mm^2): what noise of one standard deviation per coordinate puts in each mode.

    Independent noise of standard deviation s per coordinate has variance 3 s^2 per point, spread
    over min(N - 1, 3 P) eigenvalues.
    """
    if not noise_mm > 0.0 or n_shapes < 2 or n_points < 1:
        raise InputError(
            "description length: expected at least 2 shapes, 1 point and a noise above 0 mm, "
            f"found {n_shapes} shapes, {n_points} points and {noise_mm:g} mm"
        )
    return 3.0 * noise_mm**2 / min(n_shapes - 1, 3 * n_points)


def spectrum(aligned: FloatArray, weights: FloatArray) -> Spectrum:
    """Return the spectrum of the covariance of aligned landmarks, by the N x N Gram matrix.

    Parameters
    ----------
    aligned : (N, P, 3) float64, mm
    weights : (P,) float64
        Sum 1.

    Raises
    ------
    InputError
        If there are fewer than two shapes.
    """
    count = len(aligned)
    if count < 2:
        raise InputError(
            f"description length: expected at least 2 shapes, found {count}; add shapes"
        )
    mean = aligned.mean(axis=0)
    scaled = ((aligned - mean) * np.sqrt(weights)[:, None]).reshape(count, -1)  # (N, 3P)
    scaled /= np.sqrt(count - 1.0)
    keep = min(count - 1, scaled.shape[1])
    if count <= scaled.shape[1]:
        values, vectors = np.linalg.eigh(scaled @ scaled.T)  # ascending
        values = np.maximum(values[::-1][:keep], 0.0)
        modes = vectors[:, ::-1][:, :keep].T @ scaled  # (M, 3P), lengths sqrt(l_m)
        modes /= np.maximum(np.linalg.norm(modes, axis=1, keepdims=True), np.finfo(float).tiny)
    else:
        values, vectors = np.linalg.eigh(scaled.T @ scaled)
        values = np.maximum(values[::-1][:keep], 0.0)
        modes = vectors[:, ::-1][:, :keep].T
    return Spectrum(mean, values, np.ascontiguousarray(modes))


def length_of_spectrum(eigenvalues: FloatArray, l_cut: float) -> float:
    """Return F of eigenvalues (M,) in mm^2."""
    ratio = eigenvalues / l_cut
    return float(np.where(ratio >= 1.0, 1.0 + np.log(np.maximum(ratio, 1.0)), ratio).sum())


def description_length(aligned: FloatArray, weights: FloatArray, l_cut: float) -> float:
    """Return the description length F of aligned landmarks (design 5).

    Comparable only at equal N, template, weights, alignment and l_cut.

    Parameters
    ----------
    aligned : (N, P, 3) float64, mm
    weights : (P,) float64
        Sum 1.
    l_cut : float
        mm^2; see `cut_off_eigenvalue`.
    """
    return length_of_spectrum(spectrum(aligned, weights).eigenvalues, l_cut)


def description_length_gradient(
    aligned: FloatArray, weights: FloatArray, l_cut: float
) -> FloatArray:
    """Return the derivative (N, P, 3) of F by the aligned landmarks, 1 / mm.

    ``dF/dx_i = 2 / (N - 1) W^(1/2) G y_i`` with G of the module's first lines and y_i the scaled
    deviation from the mean (Ericsson and Astrom 2003).
    """
    found = spectrum(aligned, weights)
    form = majoriser(found, weights, l_cut)
    gradients = [form_product(form, shape) * form.root_weights[:, None] for shape in aligned]
    gradient: FloatArray = np.stack(gradients) * (2.0 / (len(aligned) - 1.0))
    return gradient


def majoriser(found: Spectrum, weights: FloatArray, l_cut: float) -> QuadraticForm:
    """Return the form whose sum over the shapes, divided by N - 1, majorises F up to a constant."""
    strong = found.eigenvalues > l_cut
    gains = 1.0 / l_cut - 1.0 / found.eigenvalues[strong]
    return QuadraticForm(
        found.mean,
        np.sqrt(weights),
        1.0 / l_cut,
        np.asfortranarray(found.modes[strong]),
        gains,
        *no_motions(found.mean),
    )
