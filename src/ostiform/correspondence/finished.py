"""Placing further shapes in a correspondence that is finished, from what its file holds.

`place` warps shapes against a `TrainedCorrespondence`, which a run leaves in memory only. What it
needs follows from the finished points: their mean and spectrum give the forms, and control points
are inserted on the finished mean surface as the run inserted them on the mean of its time.
"""

from collections.abc import Sequence

import numpy as np

from ostiform.correspondence.coherence import coherence_about, coherence_form, joined_forms
from ostiform.correspondence.control_points import (
    ControlPoints,
    basis_of,
    boundary_control_points,
    insert_interior,
    no_control_points,
)
from ostiform.correspondence.description_length import (
    QuadraticForm,
    euclidean_form,
    majoriser,
    spectrum,
)
from ostiform.correspondence.euclidean import root_mean_square_spread
from ostiform.correspondence.hierarchy import annealed_cut_offs, coarse_template
from ostiform.correspondence.metric import metric_term, with_reference
from ostiform.correspondence.penalty import displacement_penalty
from ostiform.correspondence.settings import CorrespondenceSettings
from ostiform.correspondence.shape_step import WarpLevel, warp_level
from ostiform.correspondence.sweeps import area_shares
from ostiform.correspondence.trained import TrainedCorrespondence, Yardstick
from ostiform.correspondence.types import Correspondence
from ostiform.correspondence.warps import circle_table
from ostiform.domain import BaseDomain


def trained_from(
    correspondence: Correspondence,
    domain: BaseDomain,
    settings: CorrespondenceSettings,
    noise_mm: float,
    l_cut: float,
) -> TrainedCorrespondence:
    """Return what places further shapes in a finished, optimal correspondence.

    Parameters
    ----------
    correspondence : Correspondence
    domain : BaseDomain
        That its template was drawn on.
    settings : CorrespondenceSettings
        Of the run.
    noise_mm : float
    l_cut : float
        mm^2; both as the run recorded them.

    Returns
    -------
    TrainedCorrespondence
        Without history: no sweep was run. Its correspondence is the given one.
    """
    template = correspondence.template
    coarse, index = coarse_template(template, settings.n_optimised)
    aligned = correspondence.aligned[:, index]  # (N, Q, 3)
    weights = area_shares(correspondence.points[:, index], coarse.faces).mean(axis=0)
    weights /= weights.sum()
    mean = aligned.mean(axis=0)
    metric = with_reference(metric_term(coarse, mean, settings.metric), aligned)
    penalty = displacement_penalty(coarse, weights, settings.stretch, settings.offset)
    circles = circle_table(domain, template)
    n_spheres = int(template.sphere.max()) + 1

    def level(interior: ControlPoints, boundary: ControlPoints) -> WarpLevel:
        basis = basis_of(interior, boundary, circles, n_spheres)
        return warp_level(template, coarse, index, basis, penalty, metric)

    spread = root_mean_square_spread(aligned, weights)
    found = spectrum(aligned, weights)
    unit_mm = settings.euclidean_noise_mm or max(spread, noise_mm)
    interior, boundary = no_control_points(), boundary_control_points(circles, 1)
    levels = [level(interior, boundary)]
    forms: list[QuadraticForm] = [euclidean_form(found.mean, weights, unit_mm**2)]
    smooth = coherence_form(coherence_about(found.mean, weights, settings.coherence), found.mean)
    cut_offs: Sequence[float] = annealed_cut_offs(l_cut, spread**2, settings.levels)
    for number, cut_off in zip(range(2, settings.levels + 1), cut_offs, strict=True):
        interior = insert_interior(interior, coarse, mean, number)
        boundary = boundary_control_points(circles, number)
        levels.append(level(interior, boundary))
        forms.append(joined_forms(majoriser(found, weights, cut_off), smooth))
    full = spectrum(correspondence.aligned, correspondence.weights)
    strong = full.eigenvalues > l_cut
    return TrainedCorrespondence(
        kind="optimal",
        correspondence=correspondence,
        yardstick=Yardstick(
            domain=domain,
            template=template,
            weights=correspondence.weights,
            noise_mm=noise_mm,
            l_cut=l_cut,
            alignment=settings.alignment,
            groups=np.arange(len(correspondence.ids)),
        ),
        mean=correspondence.aligned.mean(axis=0),
        eigenvalues=full.eigenvalues[strong],
        modes=full.modes[strong],
        levels=tuple(levels),
        forms=tuple(forms),
        history=(),
        statuses=(),
        coherence=settings.coherence,
        interior=interior,
        boundary=boundary,
    )
