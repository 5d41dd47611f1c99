"""How noisy the data are: Student-t weights, outliers, and the scale of every kind of data."""

from dataclasses import dataclass

import numpy as np

from ostiform.arrays import BoolArray, FloatArray
from ostiform.fitting.data import CONTOURS, KINDS, POINTS
from ostiform.fitting.linear import LinearSystem
from ostiform.fitting.observations import Observations
from ostiform.fitting.prior import FitPrior
from ostiform.fitting.settings import FitSettings

STUDENT_DOF = 3.0
"""Of the data's distribution: heavy enough for a fifth of outliers."""

STUDENT_PEAK = 2.0 / (np.pi * np.sqrt(3.0))
"""Density of that distribution, of scale 1, at zero."""

OUTLIER_REACH = 0.25
"""Of the shape's size: outliers are spread over distances from 0 to this."""

SHARE_BOUNDS = (0.5, 0.99)
"""Of the share of the data that is no outlier: with fewer than half there is no telling."""

NOISE_DOF = 5.0
"""How many observations the guess of the noise is worth."""

LEAST_SHARE = 0.2
"""At least this share of the observations counts for the noise, whatever the unknowns took."""


def student_weights(seen: Observations, system: LinearSystem, noise: FloatArray) -> FloatArray:
    """Return the weight (m,) of every observation."""
    scaled = system.squared / noise[seen.kind] ** 2
    weights: FloatArray = seen.weight * (STUDENT_DOF + seen.size) / (STUDENT_DOF + scaled)
    return weights


def inlier_probabilities(
    prior: FitPrior,
    seen: Observations,
    system: LinearSystem,
    noise: FloatArray,
    shares: FloatArray,
) -> FloatArray:
    """Return the probability (m,) that each observation is of the shape.

    Points and contours may be outliers, spread evenly over distances up to a quarter of the
    shape's size; all else is of the shape.
    """
    scale = noise[seen.kind]
    scaled = system.squared / scale**2
    density = STUDENT_PEAK / scale * (1.0 + scaled / STUDENT_DOF) ** (-0.5 * (STUDENT_DOF + 1.0))
    background = 1.0 / (OUTLIER_REACH * prior.size)
    own = np.clip(shares, *SHARE_BOUNDS)[seen.kind]
    probability = own * density / (own * density + (1.0 - own) * background)
    found: FloatArray = np.where(np.isin(seen.kind, (POINTS, CONTOURS)), probability, 1.0)
    return found


def inlier_shares(seen: Observations, belongs: FloatArray) -> FloatArray:
    """Return the share (5,) of every kind of data that is of the shape."""
    total = np.bincount(seen.kind, seen.weight, minlength=len(KINDS))
    inside = np.bincount(seen.kind, seen.weight * belongs, minlength=len(KINDS))
    shares: FloatArray = np.where(total > 0.0, inside / np.maximum(total, 1e-300), 1.0)
    return shares


def independent_share(prior: FitPrior, seen: Observations) -> float:
    """Return the share of the observations that are independent where the field is noise.

    Misfits of neighbours within the field's length are one and the same.
    """
    patches = prior.area / (np.pi * prior.leftover.length**2)
    return float(min(1.0, max(patches, 10.0) / float((seen.weight * seen.size).sum())))


def guessed_noise(prior: FitPrior, settings: FitSettings) -> float:
    """Return what the noise is taken to be before the data say, mm: half an edge of the model."""
    return 0.5 * prior.edge if settings.noise_mm is None else settings.noise_mm


def starting_noise(
    prior: FitPrior,
    seen: Observations,
    system: LinearSystem,
    settings: FitSettings,
    use_field: bool,
) -> FloatArray:
    """Return scales (5,) that take in most of the data where they start."""
    floor = np.hypot(guessed_noise(prior, settings), 0.0 if use_field else prior.deviation)
    noise = np.full(len(KINDS), floor)
    for kind in np.unique(seen.kind):
        root = np.sqrt((system.squared / seen.size)[seen.kind == kind])
        noise[kind] = max(floor, 1.5 * float(np.median(root)))
    return noise


@dataclass(frozen=True, slots=True)
class Evidence:
    """What one kind of data says about its noise.

    Attributes
    ----------
    count : float
        Independent rows.
    taken : float
        Of these, how many the unknowns took.
    energy : float, mm^2
        Weighted sum of the squared misfits.
    """

    count: float
    taken: float
    energy: float


def evidence_of(
    chosen: BoolArray, counts: FloatArray, energies: FloatArray, taken: float
) -> Evidence:
    """Gather the evidence of the chosen (m,) among observations with counts and energies (m,)."""
    return Evidence(float(counts[chosen].sum()), taken, float(energies[chosen].sum()))


def updated_noise(
    prior: FitPrior, settings: FitSettings, evidence: Evidence, use_field: bool
) -> float:
    """Return the scale of one kind of data for the next iteration, mm."""
    floor = prior.noise_variance if use_field else prior.deviation**2
    if settings.noise_mm is not None:
        return float(np.sqrt(settings.noise_mm**2 + floor))
    left = max(evidence.count - evidence.taken, LEAST_SHARE * evidence.count)
    guess = guessed_noise(prior, settings) ** 2 + prior.noise_variance
    energy = evidence.energy + NOISE_DOF * guess
    return float(np.sqrt(max(energy / (left + NOISE_DOF), floor)))
