"""How typical of a model's population a fitted shape is, in the modes and beyond them."""

from dataclasses import dataclass

import numpy as np
from scipy.special import fdtr

from ostiform.arrays import FloatArray
from ostiform.fitting.prior import FitPrior
from ostiform.fitting.types import Typicality

OUTLIER_PERCENTILE = 0.995
"""A shape beyond this share of the population, in all modes or in the leading ones or beyond the
modes, is called an outlier."""

LEADING_SHARE = 0.9
"""The leading modes hold this share of the variance; many small modes would hide them."""

MISFIT = 3.0
"""Median distance over the expected one beyond which the data are no shape of this model."""

FIELD_DOF = (4.0, 50.0)
"""Bounds of the degrees of freedom of the field's variance, which few groups hardly tell."""

SEEN = 0.02
"""Share of the field's energy below which the data say nothing about it."""


@dataclass(frozen=True, slots=True)
class FieldEnergy:
    """Mean square over the surface of what the field adds beyond the modes, mm^2.

    Attributes
    ----------
    found : float
        Of the field's posterior mean.
    unseen : float
        Its posterior variance.
    prior : float
        Its prior variance.
    dof : float
        Number of independent patches of the field (Satterthwaite).
    """

    found: float
    unseen: float
    prior: float
    dof: float


def field_energy(
    prior: FitPrior, coefficients: FloatArray, covariance: FloatArray, to_scores: FloatArray
) -> FieldEnergy:
    """Return the energy of the field beyond the span of the model's modes.

    Parameters
    ----------
    prior : FitPrior
    coefficients : (C,) float64
    covariance : (C, C) float64
    to_scores : (K, C) float64
        From coefficients to scores in all modes.
    """
    n_modes = prior.modes.shape[2]
    field = prior.field[: len(prior.model.mean)]
    if not field.shape[1]:
        return FieldEnergy(0.0, 0.0, 0.0, 1.0)
    within = to_scores[:, n_modes:]
    metric = np.kron((field * prior.model.weights[:, None]).T @ field, np.eye(3))
    metric = metric - within.T @ within  # (3 M, 3 M)
    own = coefficients[n_modes:]
    total = float(np.trace(metric))
    return FieldEnergy(
        found=float(own @ metric @ own),
        unseen=float((metric * covariance[n_modes:, n_modes:]).sum()),
        prior=total,
        dof=total**2 / float((metric * metric).sum()),
    )


def field_scale(prior: FitPrior, energy: FieldEnergy) -> float:
    """Return the variance of the field that this shape and the training groups make likely.

    New subjects differ in how much they depart from the modes as the training groups did: the
    variance has an inverse gamma prior of the leftover's degrees of freedom about 1, which makes
    the field a Student-t process. What the data do not see counts with its posterior variance, so
    that sparse data leave the variance where it was.
    """
    if energy.prior <= 0.0:
        return 1.0
    dof = float(np.clip(prior.leftover.energy_dof, *FIELD_DOF))
    ratio = (energy.found + energy.unseen) / energy.prior
    return (energy.dof * ratio + dof) / (energy.dof + dof)


def typicality(
    prior: FitPrior,
    coefficients: FloatArray,
    covariance: FloatArray,
    energy: FieldEnergy,
    misfit: float,
) -> Typicality:
    """Return how typical of the population a shape's coefficients are.

    Under the prior the posterior mean z of the modes' coefficients is normal with covariance
    G = I - C, C their posterior covariance, so |z|^2 has the mean tr G; it is compared with a
    scaled chi-squared distribution of the same mean and variance (Satterthwaite). The prior's own
    variances were estimated from few groups, which makes the reference an F distribution. The
    field's energy is compared likewise, with the scatter that the training groups showed.

    Parameters
    ----------
    prior : FitPrior
    coefficients : (C,) float64
    covariance : (C, C) float64
        Posterior covariance of the coefficients, under the prior's own field variance.
    energy : FieldEnergy
    misfit : float
        Median distance of data and fitted surface over what is expected.
    """
    n_modes = prior.modes.shape[2]
    beyond = prior.leftover
    found = coefficients[:n_modes]
    gain = np.eye(n_modes) - covariance[:n_modes, :n_modes]
    squared, mean = float(found @ found), float(np.trace(gain))
    variances = np.cumsum((prior.modes[: len(prior.model.mean)] ** 2).sum(axis=(0, 1)))
    n_leading = int(np.searchsorted(variances, LEADING_SHARE * variances[-1])) + 1 if n_modes else 0
    percentile = _percentile(found, gain, beyond.groups)
    leading = _percentile(found[:n_leading], gain[:n_leading, :n_leading], beyond.groups)
    seen = energy.prior - energy.unseen
    ratio, field_percentile = 0.0, 0.0
    if seen > SEEN * energy.prior:
        ratio = energy.found / seen
        own = min(energy.dof, beyond.energy_dof)
        field_percentile = float(fdtr(own, beyond.groups * own, ratio))
    reasons = []
    if max(percentile, leading) > OUTLIER_PERCENTILE:
        reasons.append(
            f"its Mahalanobis distance {np.sqrt(squared):.1f} (in the leading modes "
            f"{np.linalg.norm(found[:n_leading]):.1f}) is beyond "
            f"{100.0 * OUTLIER_PERCENTILE:.1f} % of the population"
        )
    if field_percentile > OUTLIER_PERCENTILE:
        reasons.append(
            f"it departs from the modes {ratio:.1f} times as much (in energy) as left-out "
            "training shapes do"
        )
    if misfit > MISFIT:
        reasons.append(
            f"the fitted surface stays {misfit:.1f} times further from the data than expected"
        )
    return Typicality(
        mahalanobis=float(np.sqrt(squared)),
        dof=mean,
        percentile=percentile,
        leading_percentile=leading,
        leftover_ratio=ratio,
        leftover_percentile=field_percentile,
        is_outlier=bool(reasons),
        reasons=tuple(reasons),
    )


def _percentile(found: FloatArray, gain: FloatArray, groups: int) -> float:
    """Return the share of the population nearer to the mean than coefficients with their gain."""
    mean = float(np.trace(gain))
    if mean <= SEEN:
        return 0.0
    dof = mean**2 / float((gain * gain).sum())
    return float(fdtr(dof, max(groups - 1.0, 1.0), float(found @ found) / mean))
