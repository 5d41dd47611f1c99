"""Angle and area distortion of a map to the sphere."""

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.domain import ConformalHoles, Sphere
from ostiform.embedding.seam_jumps import seam_jump
from ostiform.embedding.types import Distortion
from ostiform.surface import Component, local_frames, spherical_areas, weighted_quantile


def measure_distortion(
    component: Component, sphere: Sphere, directions: FloatArray, holes: ConformalHoles
) -> Distortion:
    """Return the distortion of a map, weighted by area on the surface.

    Parameters
    ----------
    component : Component
    sphere : Sphere
    directions : (V, 3) float64
        Unit vectors.
    holes : ConformalHoles
        The radii of the openings in the hole-filled conformal map; a rim without one (the
        pole's) has no ratio.
    """
    stretch = angle_distortion(component, directions)
    ratio, weights = area_shares(component, directions)
    return Distortion(
        angle_mean=float(weights @ stretch),
        angle_median=weighted_quantile(stretch, weights, 0.5),
        angle_p99=weighted_quantile(stretch, weights, 0.99),
        area_p01=weighted_quantile(ratio, weights, 0.01),
        area_p99=weighted_quantile(ratio, weights, 0.99),
        circle_ratio={
            name: float(circle.radius / holes.radii[name])
            for name, circle in sphere.rims.items()
            if name in holes.radii
        },
        seam_jump={
            seam: seam_jump(component, sphere, directions, seam) for seam in component.seams
        },
    )


def angle_distortion(component: Component, directions: FloatArray) -> FloatArray:
    """Return the ratio (F,) of the singular values of the map on every triangle, at least 1.

    The triangle's image is the chord triangle. A degenerate image has a very large ratio, not an
    infinite one: the smaller singular value is floored at round-off of the larger.
    """
    frames = local_frames(component.vertices, component.faces)
    derivatives = frames.derivatives(directions, component.faces)  # (F, 3, 2)
    metric = np.einsum("fab,fac->fbc", derivatives, derivatives)  # (F, 2, 2)
    half_trace = 0.5 * (metric[:, 0, 0] + metric[:, 1, 1])
    spread = np.hypot(0.5 * (metric[:, 0, 0] - metric[:, 1, 1]), metric[:, 0, 1])
    largest = half_trace + spread
    # The product of the singular values is the area ratio: no cancellation, unlike trace - spread.
    product = np.linalg.norm(np.cross(derivatives[:, :, 0], derivatives[:, :, 1]), axis=1)
    floor = np.finfo(np.float64).eps * largest
    stretch: FloatArray = largest / np.maximum(np.maximum(product, floor), np.finfo(float).tiny)
    return stretch


def area_shares(component: Component, directions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return each triangle's share of the domain over its share of the surface, and the latter.

    Returns
    -------
    ratio : (F,) float64
        Negative for a flipped triangle.
    share : (F,) float64
        Of the surface, sum 1.
    """
    areas = local_frames(component.vertices, component.faces).areas
    images = spherical_areas(directions, component.faces)
    share = areas / areas.sum()
    ratio: FloatArray = (images / images.sum()) / np.maximum(share, np.finfo(np.float64).tiny)
    return ratio, share
