"""What the surfaces of a folder say about which files are parts, phases or subjects."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import Literal

import numpy as np
from scipy.spatial import cKDTree

from ostiform.arrays import FloatArray

_OTHER_SIZE, _OTHER_SIZE_OF_ONE = 1.3, 1.6
"""Ratio of sizes, the same way round in several pairs or in one, of shapes of two kinds."""
_OTHER_PLACE = 0.4
"""Likewise the distance of their centres over their size."""
_SAME_AREA = 0.005
_PAIRED = 0.5
"""Phases of one subject are nearer to each other than this share of two subjects' distance."""
_SERIES = 0.6
"""In a series, neighbours are nearer than this share of the mean distance of any two."""
_LEAST_SERIES = 5
_LEAST_MOTION = 0.01
"""Of the size: what differs less are copies of one shape, not a motion (hearts: 0.03 and more)."""
_SPHERE = 1e-3

Relation = Literal["other", "same", "paired", "alike"]


@dataclass(frozen=True, slots=True, eq=False)
class FileLook:
    """What a file looks like, in its own units.

    Attributes
    ----------
    size : float
        Diagonal of the bounding box.
    area : float
        Of the surface; of a label map the number of voxels.
    n_openings : int or None
    samples : (n, 3) float64
        Points spread over it.
    """

    size: float
    area: float
    n_openings: int | None
    samples: FloatArray

    @property
    def center(self) -> FloatArray:
        """Mean of the samples (3,)."""
        mean: FloatArray = self.samples.mean(axis=0)
        return mean

    @property
    def is_sphere(self) -> bool:
        """Whether it is an exact sphere: a parameterisation, not anatomy."""
        middle = 0.5 * (self.samples.min(axis=0) + self.samples.max(axis=0))
        radii = np.linalg.norm(self.samples - middle, axis=1)
        radii = np.linalg.norm(self.samples, axis=1) if radii.std() > 0.1 * radii.mean() else radii
        return bool(radii.std() < _SPHERE * radii.mean())


def relation(pairs: Sequence[tuple[FileLook, FileLook]]) -> Relation:
    """Return how two groups of files are related, from pairs of files that agree in all else.

    ``"other"``: other things, by openings, size or place. ``"same"``: versions of the same
    surfaces. ``"paired"``: nearer to each other than pairs are to pairs, as phases are.
    ``"alike"``: as far from each other as any two, as subjects are.
    """
    openings = [(one.n_openings, two.n_openings) for one, two in pairs]
    if all(a is not None and b is not None and a != b for a, b in openings):
        return "other"
    sizes = np.array([np.log(two.size / one.size) for one, two in pairs])
    least = np.log(_OTHER_SIZE if len(pairs) > 1 else _OTHER_SIZE_OF_ONE)
    if abs(np.median(sizes)) > least and len(set(np.sign(sizes).tolist())) == 1:
        return "other"
    if all(abs(two.area - one.area) <= _SAME_AREA * one.area for one, two in pairs):
        return "same"
    shifts = np.array([(two.center - one.center) / one.size for one, two in pairs])
    mean = float(np.linalg.norm(shifts.mean(axis=0)))
    if len(pairs) > 1 and mean > _OTHER_PLACE and shifts.std(axis=0).max() < 0.5 * mean:
        return "other"
    if len(pairs) == 1:
        return "alike"
    within = np.mean([distance(one, two) for one, two in pairs])
    between = np.mean([distance(p[0], q[0]) for p, q in combinations(pairs, 2)])
    return "paired" if within < _PAIRED * between else "alike"


def is_series(looks: Sequence[FileLook]) -> bool:
    """Return whether files in order show one thing that moves, not one thing after the other."""
    if len(looks) < _LEAST_SERIES:
        return False
    steps = np.mean([distance(one, two) for one, two in pairwise(looks)])
    apart = np.mean([distance(one, two) for one, two in combinations(looks, 2)])
    return bool(steps < _SERIES * apart and apart > _LEAST_MOTION * looks[0].size)


def distance(one: FileLook, two: FileLook) -> float:
    """Return the mean distance of the samples of two files, both ways."""
    there = cKDTree(two.samples).query(one.samples)[0]
    back = cKDTree(one.samples).query(two.samples)[0]
    return float(0.5 * (np.mean(there) + np.mean(back)))
