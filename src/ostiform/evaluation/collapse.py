"""The alarm for collapse: a model that is compact because its points left the surfaces' variation.

A description length can be shortened without end by moving points to where the surfaces agree.
Three signs give that away, none of which a better correspondence of the same surfaces shows.
"""

from ostiform.evaluation.types import Evaluation

LEAST_NORMAL_SHARE = 0.75
"""Least normal variance over what the surfaces allow; models of docs/evidence.md: from 0.86."""

MOST_COVERAGE_LOSS = 1.15
"""Most ratio of the shapes' mean 95 % coverage distance to the start's; there: up to 1.01."""

MOST_WEIGHT_DRIFT = 0.05
"""Most share of the weight that the points' areas have moved away from; there: up to 0.02."""

ROUNDING = 1e-6
"""Of the diameter: a start that covers the surfaces better than this covers them exactly."""


def signs_of_collapse(model: Evaluation, start: Evaluation) -> tuple[str, ...]:
    """Return what gives away that a correspondence has collapsed; nothing for a sound one.

    Parameters
    ----------
    model : Evaluation
        Of the optimised correspondence.
    start : Evaluation
        Of the conformal start, of the same shapes.

    Returns
    -------
    signs : tuple of str
        One clause per sign: what was expected and what was found.
    """
    signs = []
    if model.spread is not None:
        normal, allowed = model.spread.variance.normal, model.spread.surface_variance
        if normal < LEAST_NORMAL_SHARE * allowed:
            signs.append(
                f"variance along the normals of at least {LEAST_NORMAL_SHARE:g} of the "
                f"{allowed:.2f} mm^2 by which the surfaces differ, found {normal:.2f} mm^2"
            )
        drift = model.spread.weight_drift
        if drift > MOST_WEIGHT_DRIFT:
            signs.append(
                f"at most {100 * MOST_WEIGHT_DRIFT:.0f} % of the area to be at other points than "
                f"at the start, found {100 * drift:.0f} %"
            )
    loss = _mean_coverage(model) / max(_mean_coverage(start), ROUNDING * model.coverage[0].diameter)
    if loss > MOST_COVERAGE_LOSS:
        signs.append(
            f"surfaces covered to at most {MOST_COVERAGE_LOSS:g} of the start's distance, found "
            f"{loss:.2f}"
        )
    return tuple(signs)


def _mean_coverage(evaluation: Evaluation) -> float:
    return sum(item.p95 for item in evaluation.coverage) / len(evaluation.coverage)
