"""Where regions of a label map touch: patches with their area and place."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated

import numpy as np
from scipy import ndimage

from ostiform.arrays import BoolArray, FloatArray, IntArray
from ostiform.study.label_grid import BY_CORNERS, BY_FACES, LabelGrid
from ostiform.values import Axes, value

_MOST_APART = 2
"""Voxels between pieces of one patch: networks leave such slits."""
_NECK = 3.0
"""Voxels: patches that are joined by a narrower neck are parted there."""


@value
class Patch:
    """A connected contact of two regions.

    Attributes
    ----------
    voxels : (n, 3) int64
        Those of the second region that touch the first.
    area_mm2 : float
        Of its projection along its mean normal.
    center : (3,) float64, mm
    """

    voxels: Annotated[IntArray, Axes("n", 3)]
    area_mm2: float
    center: Annotated[FloatArray, Axes(3)]

    def __str__(self) -> str:
        """Return area and place in words."""
        return f"{self.area_mm2:.0f} mm2 at [{place_words(self.center)}]"


def place_words(point: FloatArray) -> str:
    """Return a place in mm in words, to a tenth."""
    return ", ".join(f"{x + 0.0:.1f}" for x in point.round(1))


def contact_patches(
    grid: LabelGrid, one: int, two: int, n_wanted: int, least_mm2: float
) -> list[Patch]:
    """Return the contacts of two regions, the largest first.

    Pieces that lie within a few voxels of each other are one, as long as enough patches are left;
    where too few are there, those with a narrow neck are parted at it.

    Parameters
    ----------
    grid : LabelGrid
    one, two : int
        As in `LabelGrid.owner`.
    n_wanted : int
    least_mm2 : float
        Patches that are smaller do not count as wanted ones.
    """
    found = touching_box(grid.owner, one, two)
    if found is None:
        return []
    box, first, second = found
    contact = second & ndimage.binary_dilation(first, BY_FACES)
    if not contact.any():
        return []
    patches: list[Patch] = []
    for apart in reversed(range(_MOST_APART + 1)):
        near = contact
        if apart:
            near = ndimage.binary_dilation(contact, BY_CORNERS, iterations=apart)
        label, _ = ndimage.label(near, BY_CORNERS)
        patches = _patches(grid, np.where(contact, label, 0), first, box)
        if _n_large(patches, least_mm2) >= n_wanted:
            return patches
    label, _ = ndimage.label(contact, BY_CORNERS)
    parted = _parted_at_necks(label.astype(np.int64), contact, first | second)
    at_necks = _patches(grid, parted, first, box)
    return at_necks if _n_large(at_necks, least_mm2) == n_wanted else patches


def touching_box(
    owner: IntArray, one: int, two: int, reach: int = 2
) -> tuple[tuple[slice, ...], BoolArray, BoolArray] | None:
    """Return where two regions may touch, and their voxels there; None where they cannot."""
    boxes = ndimage.find_objects(owner, max(one, two))
    here, there = boxes[one - 1], boxes[two - 1]
    if here is None or there is None:
        return None
    box = tuple(
        slice(max(a.start, b.start) - reach, min(a.stop, b.stop) + reach)
        for a, b in zip(here, there, strict=True)
    )
    box = tuple(slice(max(s.start, 0), s.stop) for s in box)
    if any(s.stop <= s.start for s in box):
        return None
    return box, owner[box] == one, owner[box] == two


def _n_large(patches: Sequence[Patch], least_mm2: float) -> int:
    return sum(patch.area_mm2 >= least_mm2 for patch in patches)


def _patches(
    grid: LabelGrid, label: IntArray, first: BoolArray, box: tuple[slice, ...]
) -> list[Patch]:
    """Return the labelled patches (voxels of the second region), largest first."""
    count = int(label.max())
    normals = np.zeros((count + 1, 3))
    steps = grid.steps
    for axis in range(3):
        area = float(np.delete(steps, axis).prod())
        low = tuple(slice(None, -1) if k == axis else slice(None) for k in range(3))
        high = tuple(slice(1, None) if k == axis else slice(None) for k in range(3))
        for own, other, sign in ((low, high, 1.0), (high, low, -1.0)):
            faces = label[own][(label[own] > 0) & first[other]]
            normals[:, axis] += sign * area * np.bincount(faces, minlength=count + 1)
    start = np.array([s.start for s in box])
    order = np.argwhere(label > 0)
    owners = label[label > 0]
    patches = []
    for k in np.unique(owners).tolist():
        voxels = order[owners == k] + start
        patches.append(
            Patch(voxels, float(np.linalg.norm(normals[k])), grid.place(voxels.mean(axis=0)))
        )
    return sorted(patches, key=lambda patch: (-patch.area_mm2, *patch.center.tolist()))


def _parted_at_necks(label: IntArray, contact: BoolArray, both: BoolArray) -> IntArray:
    """Return the patches parted where they are narrow: what is left of them grows again."""
    width = ndimage.distance_transform_edt(both | ~ndimage.binary_dilation(both, BY_CORNERS))
    core = contact & (width > 0.5 * _NECK)
    seeds, count = ndimage.label(core, BY_CORNERS)
    if count <= int(label.max()):
        return label
    parted = seeds.astype(np.int64)
    while (left := contact & (parted == 0)).any():
        beside = ndimage.grey_dilation(parted, footprint=BY_CORNERS)
        reached = left & (beside > 0)
        if not reached.any():
            break
        parted[reached] = beside[reached]
    return parted


def bridged(grid: LabelGrid, one: int, two: int, gap_mm: float) -> tuple[LabelGrid, float]:
    """Return the regions grown into the gap between two of them, and how wide it was, mm.

    Where they touch, only slits of one voxel beside the contact are filled.
    """
    owner = grid.owner
    widest = int(gap_mm / grid.step + 1e-9)
    found = touching_box(owner, one, two, reach=widest + 3)
    if found is None:
        return grid, 0.0
    box, first, second = found
    free = owner[box] == 0
    if not (first.any() and second.any()):
        return grid, 0.0
    for width in range(widest + 1):
        reached = first | (_reach(first, free, width) <= width)
        if (ndimage.binary_dilation(reached, BY_FACES) & second).any():
            break
    else:
        return grid, 0.0
    found_mm = width * grid.step
    # A gap is seldom of one width: all of it is filled as far as it may be.
    width = widest if width else 1
    here, there = _reach(first, free, width), _reach(second, free, width)
    between = free & (here + there <= width + 1)
    owner = owner.copy()
    owner[box] = np.where(between, np.where(here <= there, one, two), owner[box])
    return replace(grid, owner=owner), found_mm


def _reach(mask: BoolArray, free: BoolArray, most: int) -> IntArray:
    """Return in how many steps a mask reaches free voxels; more than any sum where it does not."""
    steps = np.full(mask.shape, 3 * most + 3, dtype=np.int64)
    grown = mask
    for k in range(1, most + 1):
        grown = ndimage.binary_dilation(grown, BY_FACES)
        steps[grown & free & (steps > most)] = k
    return steps
