"""What the files of a population share is kept: nothing is turned without evidence (design 2)."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.domain.surface_fit import SurfaceFit, SurfaceSample, fit_at, fitted_rotation

# Nearly round surfaces fit as well turned away, so nothing is turned without evidence. The files
# share a frame where at least half of the shapes fit, as their files have them, at most FRAME_BELOW
# times worse than turned. Such shapes stay as they are, and so do those whose line of landmarks
# points as the reference's does (7 % would by chance), up to TURNED_ABOVE. A phase turns
# with another of its subject where that fits nearly as well. Of real ventricles, warped,
# files of one frame 1.2 to 1.6 times worse in the median and 2.2 at most, turned at random 1.9 to
# 2.2 in the median; two phases of a subject at most 1.15, turned at random 1.17 to 2.6 (5 % below
# 1.3). On others than these (benchmarks/shared_frame.py), as filed and turned at random, in the
# median: generated left hearts, LV 1.12 and 1.95, LA 1.12 and 2.41; implicit atria of four veins
# 1.48 and 2.93, of two 2.33 and 4.45, which are therefore turned though they share a frame.
FRAME_BELOW = 1.6
SAME_LINE_BELOW = np.radians(30.0)
TURNED_ABOVE = 2.5
SUBJECT_BELOW = 1.3


def kept_to_shared_frame(
    fits: Sequence[SurfaceFit],
    samples: Sequence[SurfaceSample],
    axes: FloatArray | None,
    reference: int,
) -> list[SurfaceFit]:
    """Return the fits, those as their files have them that have no reason to turn.

    Parameters
    ----------
    fits : sequence of SurfaceFit
        Of every shape to the reference.
    samples : sequence of SurfaceSample
    axes : (N, 3) float64 or None
        Directions of the lines that the landmarks lie on, where they lie on one.
    reference : int
    """
    unturned = [fit_at(sample, samples[reference], np.eye(3)) for sample in samples]
    residual = np.array([own.residual for own in unturned])
    least = np.array([fit.residual for fit in fits])
    stays = residual <= FRAME_BELOW * least
    if len(fits) < 2 or np.delete(stays, reference).mean() < 0.5:
        return list(fits)
    if axes is not None:
        same = axes @ axes[reference] >= np.cos(SAME_LINE_BELOW)
        stays |= same & (residual <= TURNED_ABOVE * least)
    return [
        replace(fit, rotation=own.rotation, translation=own.translation, residual=own.residual)
        if stay
        else fit
        for own, fit, stay in zip(unturned, fits, stays, strict=True)
    ]


def kept_to_subjects(
    fits: Sequence[SurfaceFit],
    samples: Sequence[SurfaceSample],
    subjects: Sequence[str],
    reference: int,
) -> list[SurfaceFit]:
    """Return the fits, phases turned as the best fitting one of their subject, if that suits.

    Parameters
    ----------
    fits : sequence of SurfaceFit
        Of every shape to the reference.
    samples : sequence of SurfaceSample
    subjects : sequence of str
        Whose each shape is.
    reference : int
    """
    kept = list(fits)
    for subject in dict.fromkeys(subjects):
        own = [index for index, other in enumerate(subjects) if other == subject]
        best = reference if reference in own else min(own, key=lambda index: fits[index].residual)
        for index in own:
            if index == best or (fits[index].rotation == fits[best].rotation).all():
                continue
            turned = fitted_rotation(samples[index], samples[best])
            as_filed = fit_at(samples[index], samples[best], np.eye(3))
            if as_filed.residual <= SUBJECT_BELOW * turned.residual:
                rotation = np.eye(3) if best == reference else fits[best].rotation
                kept[index] = replace(
                    fit_at(samples[index], samples[reference], rotation),
                    reflected_residual=fits[index].reflected_residual,
                )
    return kept
