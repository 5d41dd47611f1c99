"""Labels of parts and of what they open into, on one grid of nearly equal steps.

Isotropic maps are taken as they are; slices that lie far apart are interpolated by the shape of
every label, so that what follows sees one kind of map.
"""

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from scipy import ndimage

from ostiform.arrays import BoolArray, FloatArray, IntArray
from ostiform.surface import LevelField, is_coarse, level_field
from ostiform.values import Axes, value

MARGIN = 4
"""Empty voxels on every side."""
BY_FACES = ndimage.generate_binary_structure(3, 1)
BY_EDGES = ndimage.generate_binary_structure(3, 2)
BY_CORNERS = np.ones((3, 3, 3), dtype=np.bool_)


@value
class LabelGrid:
    """Which region every voxel belongs to.

    Attributes
    ----------
    owner : (I, J, K) int64
        0 for none, else one more than the index of the region.
    affine : (4, 4) float64
        From voxel indices (of centres) to mm.
    slice_mm : float
        The largest step of the map that it was made from.
    slice_normal : (3,) float64
        Its direction.
    """

    owner: Annotated[IntArray, Axes(None, None, None)]
    affine: Annotated[FloatArray, Axes(4, 4)]
    slice_mm: float
    slice_normal: Annotated[FloatArray, Axes(3)]

    @property
    def steps(self) -> FloatArray:
        """Sizes of the voxels (3,), mm."""
        sizes: FloatArray = np.linalg.norm(self.affine[:3, :3], axis=0)
        return sizes

    @property
    def step(self) -> float:
        """The smallest size of the voxels, mm."""
        return float(self.steps.min())

    def place(self, index: FloatArray) -> FloatArray:
        """Return points (..., 3) in mm at places in indices."""
        point: FloatArray = index @ self.affine[:3, :3].T + self.affine[:3, 3]
        return point

    def volume_mm3(self, n_voxels: int) -> float:
        """Return the volume of some voxels."""
        return float(n_voxels * self.steps.prod())


def label_grid(masks: Sequence[BoolArray], n_parts: int, affine: FloatArray) -> LabelGrid:
    """Return the regions of some masks on one grid, cropped to the parts.

    Parameters
    ----------
    masks : sequence of (I, J, K) bool
        The parts, then what they open into; where they overlap the first one counts.
    n_parts : int
    affine : (4, 4) float64
    """
    steps = np.linalg.norm(affine[:3, :3], axis=0)
    union = np.logical_or.reduce(list(masks[:n_parts]))
    reach = np.ceil(_BESIDE_MM / steps).astype(np.int64)
    low, high = box_of(union)
    low, high = np.maximum(low - reach, 0), np.minimum(high + reach, union.shape)
    box = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
    moved = affine.copy()
    moved[:3, 3] += affine[:3, :3] @ low
    inner = [mask[box] for mask in masks]
    if is_coarse(steps):
        owner, moved = _interpolated(inner, moved)
    else:
        owner = np.zeros(inner[0].shape, dtype=np.int64)
        for k in reversed(range(len(inner))):
            owner[inner[k]] = k + 1
    moved = moved.copy()
    moved[:3, 3] -= MARGIN * moved[:3, :3].sum(axis=1)
    through = int(np.argmax(steps))
    normal = affine[:3, through] / steps[through]
    return LabelGrid(np.pad(owner, MARGIN), moved, float(steps.max()), normal)


_BESIDE_MM = 12.0
"""How far beyond the parts the labels that they open into are looked at."""


def box_of(mask: BoolArray) -> tuple[IntArray, IntArray]:
    """Return the first voxel (3,) of a mask along every axis, and the one after its last."""
    first, last = np.zeros(3, dtype=np.int64), np.zeros(3, dtype=np.int64)
    for axis in range(3):
        filled = np.flatnonzero(mask.any(axis=tuple(a for a in range(3) if a != axis)))
        first[axis], last[axis] = filled[0], filled[-1] + 1
    return first, last


def spread(owner: IntArray, into: BoolArray) -> IntArray:
    """Return the regions grown step by step into voxels of none, the nearest one first."""
    owner = owner.copy()
    left = into & (owner == 0)
    while left.any():
        low, high = box_of(left)
        box = tuple(
            slice(max(a - 1, 0), b + 1) for a, b in zip(low.tolist(), high.tolist(), strict=True)
        )
        own = owner[box]
        beside = ndimage.grey_dilation(own, footprint=BY_FACES)
        reached = left[box] & (beside > 0)
        if not reached.any():
            break
        own[reached] = beside[reached]
        left[box] &= ~reached
    return owner


def _interpolated(masks: Sequence[BoolArray], affine: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return regions between the slices: what is inside the union goes to the largest field."""
    whole = level_field(np.logical_or.reduce(list(masks)), affine)
    best = np.full(whole.values.shape, -np.inf)
    owner = np.zeros(whole.values.shape, dtype=np.int64)
    for k, mask in enumerate(masks):
        if not mask.any():
            continue
        own = level_field(mask, affine)
        scale = float(np.sqrt(max(own.values.max(), 1e-300)))
        values, here = _on_grid_of(whole, own)
        values = values / scale
        better = values > best[here]
        best[here] = np.where(better, values, best[here])
        owner[here] = np.where(better, k + 1, owner[here])
    owner[whole.values <= 0.0] = 0
    return spread(owner, whole.values > 0.0), whole.affine


def _on_grid_of(whole: LevelField, own: LevelField) -> tuple[FloatArray, tuple[slice, ...]]:
    """Return the part of a field that lies on another's grid, and where it lies there."""
    offset = np.linalg.solve(whole.affine[:3, :3], own.affine[:3, 3] - whole.affine[:3, 3])
    start = np.rint(offset).astype(np.int64)
    first = np.maximum(start, 0)
    last = np.minimum(start + own.values.shape, whole.values.shape)
    there = tuple(slice(a, b) for a, b in zip(first, last, strict=True))
    here = tuple(slice(a, b) for a, b in zip(first - start, last - start, strict=True))
    return own.values[here], there
