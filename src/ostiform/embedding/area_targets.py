"""Target areas that leave each part of a joint map the size of its region of the sphere."""

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.domain import Sphere
from ostiform.surface import Component, face_areas, spherical_areas, split_ostium_name

# Half of the width, radians, of the band about a seam's circle in which scales pass into another.
BAND = np.radians(45.0)


def part_scales(component: Component, sphere: Sphere, directions: FloatArray) -> FloatArray:
    """Return the length scale (F,) of each triangle's reference, 1 without seams.

    Parts of one component have one scale on their surface but regions of the sphere that are
    larger or smaller: a seam left free would wander off its circle to even that out. The scale
    passes smoothly from one part's to the other's across a seam, so a smooth map stays smooth.

    Parameters
    ----------
    component : Component
    sphere : Sphere
    directions : (V, 3) float64
        A map with seams on their circles and rims on theirs.
    """
    count = len(component.parts)
    surface = np.bincount(
        component.face_part, face_areas(component.vertices, component.faces), count
    )
    region = np.bincount(component.face_part, spherical_areas(directions, component.faces), count)
    log_scale = 0.5 * np.log(region / surface)  # (n_parts,)
    middles = directions[component.faces].sum(axis=1)
    middles = middles / np.linalg.norm(middles, axis=1, keepdims=True)
    total = np.zeros(len(component.faces))
    for seam, circle in sphere.seams.items():
        first, second = (
            component.parts.index(split_ostium_name(name)[0]) for name in (seam.first, seam.second)
        )
        depth = circle.radius - np.arccos(np.clip(middles @ circle.center, -1.0, 1.0))
        band = min(BAND, 0.5 * circle.radius, 0.5 * (np.pi - circle.radius))
        t = np.clip(0.5 * (1.0 + depth / band), 0.0, 1.0)
        total += (log_scale[second] - log_scale[first]) * t**2 * (3.0 - 2.0 * t)
    scales: FloatArray = np.exp(total)
    return scales
