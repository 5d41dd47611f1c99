"""The strong part of a spectrum from a stream of shapes, by random projection.

Subspace iteration from a random start on the covariance, which is never formed (Halko, Martinsson
and Tropp 2011, algorithm 4.4 applied to the covariance): every pass over the shapes multiplies a
block of directions by it, and memory holds this block and one chunk of shapes. What lies below the
cut-off needs no directions: its sum is the trace less the strong eigenvalues, which is all that
the description length asks of it.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.errors import ConvergenceError, InputError

FIRST_BLOCK = 32
GROWTH = 2
BEYOND = 1.5
"""Directions over strong eigenvalues: those in excess make the others converge fast."""

TOLERANCE = 1e-7
"""Relative change of every strong eigenvalue in a pass, below which they are accepted."""

MOST_PASSES = 60


@dataclass(frozen=True, slots=True, eq=False)
class StrongSpectrum:
    """The eigenvalues above a cut-off, their eigenvectors, and the sum of the others.

    Attributes
    ----------
    count : int
        Shapes.
    mean : (P, 3) float64, mm
    eigenvalues : (R,) float64, mm^2 per point
        In descending order.
    modes : (R, 3P) float64
        Orthonormal rows in the space of sqrt(weight)-scaled landmarks.
    rest : float
        Sum of all other eigenvalues, mm^2 per point.
    passes : int
        Over the shapes.
    """

    count: int
    mean: FloatArray
    eigenvalues: FloatArray
    modes: FloatArray
    rest: float
    passes: int


def streamed_spectrum(
    chunks: Callable[[], Iterable[FloatArray]],
    weights: FloatArray,
    l_cut: float,
    rng: np.random.Generator,
) -> StrongSpectrum:
    """Return the eigenvalues above a cut-off of the covariance of shapes that come in chunks.

    Parameters
    ----------
    chunks : callable
        Gives the aligned shapes (n, P, 3) in mm afresh at every call, in chunks of any size.
    weights : (P,) float64
        Sum 1.
    l_cut : float
        mm^2.
    rng : numpy.random.Generator
        Of the first directions. The result depends on it below the tolerance only.

    Raises
    ------
    InputError
        If there are fewer than two shapes.
    ConvergenceError
        If the eigenvalues still change after 60 passes: two of them lie at the cut-off.
    """
    roots = np.sqrt(weights)
    count, mean = _count_and_mean(chunks())
    if count < 2:
        raise InputError(
            f"description length: expected at least 2 shapes, found {count}; add shapes"
        )
    size = mean.size
    most = min(count - 1, size)

    def multiplied(block: FloatArray) -> tuple[FloatArray, float]:
        product, trace = np.zeros_like(block), 0.0
        for chunk in chunks():
            scaled = ((chunk - mean) * roots[:, None]).reshape(len(chunk), -1)  # (n, 3P)
            product += scaled.T @ (scaled @ block)
            trace += float(np.einsum("nk,nk->", scaled, scaled))
        return product / (count - 1.0), trace / (count - 1.0)

    block = np.linalg.qr(rng.normal(size=(size, min(FIRST_BLOCK, most))))[0]
    before = np.zeros(0)
    for passes in range(2, MOST_PASSES + 2):
        product, trace = multiplied(block)
        values, vectors = np.linalg.eigh(block.T @ product)  # Rayleigh and Ritz, ascending
        values, vectors = values[::-1], vectors[:, ::-1]
        strong = int((values > l_cut).sum())
        is_wide = len(values) >= min(BEYOND * strong, most)
        if is_wide and strong == len(before):
            change = np.abs(values[:strong] - before) / values[:strong]
            if change.max(initial=0.0) < TOLERANCE:
                modes = np.ascontiguousarray((block @ vectors[:, :strong]).T)
                rest = max(trace - float(values[:strong].sum()), 0.0)
                return StrongSpectrum(count, mean, values[:strong], modes, rest, passes)
        before = values[:strong]
        if not is_wide:
            wanted = min(max(GROWTH * len(values), int(np.ceil(BEYOND * strong))), most)
            product = np.hstack([product, rng.normal(size=(size, wanted - len(values)))])
        block = np.linalg.qr(product)[0]
    raise ConvergenceError(
        f"spectrum of {count} shapes: expected eigenvalues that settle within {MOST_PASSES} "
        f"passes, found the {strong} above {l_cut:.3g} mm^2 still changing; lower the cut-off"
    )


def streamed_length(found: StrongSpectrum, l_cut: float) -> float:
    """Return the description length F, exactly: its weak part is linear in the eigenvalues.

    Parameters
    ----------
    found : StrongSpectrum
    l_cut : float
        mm^2; that of the spectrum.
    """
    return float((1.0 + np.log(found.eigenvalues / l_cut)).sum()) + found.rest / l_cut


def _count_and_mean(chunks: Iterable[FloatArray]) -> tuple[int, FloatArray]:
    count, total = 0, np.zeros((0, 3))
    for chunk in chunks:
        total = chunk.sum(axis=0) if count == 0 else total + chunk.sum(axis=0)
        count += len(chunk)
    return count, total / max(count, 1)
