"""Outlines of a label in its slices: what a segmentation says of a wall, without stairs.

A slice says where the wall is in its plane, and nothing of what is between it and the next; there
the fitted model says it. So a label map is a target as curves in its slices: the outline at half
height of the label's smoothed mask. Where the image ends there is no wall, and beyond the first and
the last slice nothing is said at all.
"""

from collections.abc import Sequence

import contourpy
import numpy as np
from scipy import ndimage

from ostiform.arrays import BoolArray, FloatArray
from ostiform.fitting.sequence_types import SliceContours

THICK = 1.5
"""Slices this many times further apart than their pixels were taken one by one."""

STEP_MM = 3.0
"""Slices of an image of equal steps are looked at so far apart."""

SMOOTHED_PIXELS = 0.8
FEWEST_PIXELS = 4
"""Of a slice's label: smaller specks are no outline."""


def label_outlines(
    mask: BoolArray, affine: FloatArray, view: str, part: str | None
) -> tuple[SliceContours, ...]:
    """Return the outlines of a label in the slices of its image.

    Parameters
    ----------
    mask : (I, J, K) bool
    affine : (4, 4) float64
        From voxel indices (of centres) to mm.
    view : str
        The image's name. The slices of a stack are named after it and shift one by one; those of
        an image of equal steps are one body.
    part : str or None
        The part of the model that the label is.
    """
    spacing = np.linalg.norm(affine[:3, :3], axis=0)
    flat = [axis for axis, count in enumerate(mask.shape) if count == 1]
    through = flat[0] if flat else int(np.argmax(spacing))
    others = np.delete(spacing, through)
    is_stack = bool(flat) or float(spacing[through]) > THICK * float(others.max())
    stride = 1 if is_stack else max(int(round(STEP_MM / float(spacing[through]))), 1)
    found = []
    for index in range(0, mask.shape[through], stride):
        curves = [
            _placed(curve, through, index, affine)
            for curve in _outline(np.take(mask, index, axis=through))
        ]
        if curves:
            alone = bool(flat) or not is_stack
            name = view if alone else f"{view} {index + 1}"
            found.append(SliceContours(name, tuple(curves), part, is_outline=True))
    if is_stack or not found:
        return tuple(found)
    joined = tuple(curve for item in found for curve in item.curves)
    return (SliceContours(view, joined, part, is_outline=True),)


def _outline(label: BoolArray) -> Sequence[FloatArray]:
    """Return the outlines of a slice (I, J), in pixels, open where the image ends."""
    if int(label.sum()) < FEWEST_PIXELS:
        return ()
    padded = np.pad(label.astype(np.float64), 2, mode="edge")
    once = ndimage.gaussian_filter(padded, SMOOTHED_PIXELS, mode="nearest")
    smooth = 2.0 * once - ndimage.gaussian_filter(once, SMOOTHED_PIXELS, mode="nearest")
    inside = smooth[2:-2, 2:-2]
    curves = contourpy.contour_generator(z=inside).lines(0.5)
    # The generator gives columns first. Level curves end at the border of the image by themselves.
    return [np.asarray(curve)[:, ::-1] for curve in curves if len(curve) > 2]  # type: ignore[arg-type]


def _placed(curve: FloatArray, through: int, index: int, affine: FloatArray) -> FloatArray:
    indices = np.insert(curve, through, float(index), axis=1)
    placed: FloatArray = indices @ affine[:3, :3].T + affine[:3, 3]
    return placed
