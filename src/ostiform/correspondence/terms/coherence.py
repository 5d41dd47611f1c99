"""The coherence term: shapes should differ from their mean by smooth motions of space.

Where points slide along a surface the description length sees little, and neither do maps made
shape by shape. Anatomy that grows and beats carries neighbouring tissue along: the deviation of a
shape from the mean of its population is taken for a sample of a Gaussian process over space
(motion coherence: Yuille and Grzywacz 1989, Myronenko and Song 2010; as a shape prior: Luethi et
al. 2018) plus noise, and the term charges what such a process does not explain.

With z the deviation of the aligned landmarks scaled by root weights, B the kernel matrix between
the mean's landmarks scaled likewise on both sides, and e the ratio of the variances of noise and
process, a shape's term is ``strength / radius^2 * z^T (I - B (B + e I)^-1) z`` for each
coordinate: a quadratic form of the kind that the description length is majorised with.
"""

from dataclasses import dataclass

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.correspondence.terms.quadratic_form import QuadraticForm

# The kernel: Gaussians with these standard deviations in units of the mean's radius (root mean
# square distance from its centre) and these shares of the variance: mostly whole chambers, some
# regions of a chamber, little of the size of a vessel.
SCALES = ((1.0, 1.0), (0.5, 0.1), (0.25, 0.01))

# Variance of the noise over that of the process, per point.
NOISE_RATIO = 0.01

# Eigenvectors of the kernel that explain less than this share of their own variance are left out.
LEAST_GAIN = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Coherence:
    """What smooth motions of a mean shape's Q landmarks are.

    Attributes
    ----------
    strength : float
        1 / mm^2.
    root_weights : (Q,) float64
    motions : (R, Q) float64
        Orthonormal rows: eigenvectors of the scaled kernel, the same for each coordinate.
    gains : (R,) float64
        Share of its variance along a motion that the process explains, 0 to 1.
    """

    strength: float
    root_weights: FloatArray
    motions: FloatArray
    gains: FloatArray


def coherence_about(mean: FloatArray, weights: FloatArray, strength: float) -> Coherence:
    """Return the term for deviations from a mean shape.

    Parameters
    ----------
    mean : (Q, 3) float64, mm
    weights : (Q,) float64
        Sum 1.
    strength : float
        In units of one over the squared radius of the mean, so independent of the unit of length;
        0 leaves shapes free.
    """
    root = np.sqrt(weights)
    if strength == 0.0:
        return Coherence(strength, root, np.zeros((0, len(mean))), np.zeros(0))
    centred = mean - weights @ mean
    radius = float(np.sqrt(weights @ np.einsum("qk,qk->q", centred, centred)))
    squares = np.einsum("qk,qk->q", centred, centred) / radius**2
    distances = np.maximum(
        squares[:, None] + squares - 2.0 / radius**2 * centred @ centred.T, 0.0
    )  # (Q, Q), squared, in units of the radius
    kernel = sum(share * np.exp(-0.5 * distances / scale**2) for scale, share in SCALES)
    values, vectors = np.linalg.eigh(kernel * root[:, None] * root)
    noise = NOISE_RATIO / len(mean)  # the scaled kernel has trace 1 (about), the noise this each
    kept = values > LEAST_GAIN * noise
    values = values[kept]
    motions = np.ascontiguousarray(vectors[:, kept].T)
    return Coherence(strength / radius**2, root, motions, values / (values + noise))


def coherence_form(term: Coherence, target: FloatArray) -> QuadraticForm:
    """Return a shape's term as a form about a target (Q, 3)."""
    return QuadraticForm(
        target,
        term.root_weights,
        term.strength,
        np.zeros((0, 3 * len(target))),
        np.zeros(0),
        term.motions,
        term.strength * term.gains,
    )


def coherence_value(term: Coherence, aligned: FloatArray) -> float:
    """Return the term of all shapes (N, Q, 3) about their mean, over N - 1, as it goes with F."""
    if term.strength == 0.0:
        return 0.0
    scaled = (aligned - aligned.mean(axis=0)) * term.root_weights[:, None]  # (N, Q, 3)
    along = np.einsum("rq,nqk->nrk", term.motions, scaled, optimize=True)
    explained = np.einsum("r,nrk,nrk->", term.gains, along, along)
    rough = float(np.einsum("nqk,nqk->", scaled, scaled) - explained)
    return term.strength * rough / max(len(aligned) - 1, 1)
