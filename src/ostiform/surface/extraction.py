"""Surfaces of label maps: from voxels to a smooth, closed triangulation.

Shape-based interpolation: in every slice the signed distance d to the label's outline; with r the
largest distance in the slice, ``f = d (2 r - d)`` has the same zero set and is, for round
sections, a polynomial of degree two in space (``r^2 - x^2 - y^2`` for a disc). So f is
interpolated between slices by cubic convolution, which reproduces such polynomials, and
extrapolated by one slice where the label ends. Voxel steps within slices are smoothed by
``2 G - G G`` (G a Gaussian of one voxel), which keeps polynomials of degree three: nothing shrinks.
"""

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from scipy import ndimage
from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
from vtkmodules.vtkCommonDataModel import vtkImageData
from vtkmodules.vtkFiltersCore import vtkFlyingEdges3D

from ostiform.arrays import BoolArray, FloatArray, IntArray
from ostiform.errors import InputError
from ostiform.values import Axes, value

_COARSE = 1.5
"""Slices further apart than this many voxels are interpolated one by one."""

_FAR_IN_STEPS = 3.0
"""Distances are cut off outside beyond this many slice (or voxel) steps: what is far from the
label has no say in its outline."""

_LEAST_BEYOND = 0.05
"""In the first slice without the label f is at most this share of its largest value below zero."""

_NEAR_IN_WIDTHS = 2.0
"""Labels are parted only within this many widths of the gap of both."""

_MARGIN = 3
"""Empty voxels added on every side."""


@value
class LevelField:
    """A field that is positive inside a label, on a grid of nearly equal steps.

    Attributes
    ----------
    values : (I, J, K) float64
    affine : (4, 4) float64
        From grid indices to mm (column vectors).
    """

    values: Annotated[FloatArray, Axes(None, None, None)]
    affine: Annotated[FloatArray, Axes(4, 4)]


def level_field(mask: BoolArray, affine: FloatArray) -> LevelField:
    """Return the smooth field whose zero set is the outline of a label.

    Parameters
    ----------
    mask : (I, J, K) bool
        The label's voxels.
    affine : (4, 4) float64
        From voxel indices (of centres) to mm. Axes at right angles.

    Raises
    ------
    InputError
        If the label is empty or fills fewer than two voxels along an axis.
    """
    if not mask.any():
        raise InputError("expected voxels of the label, found none")
    spacing = np.linalg.norm(affine[:3, :3], axis=0)  # (3,)
    first, last = _box(mask)
    if (last - first < 2).any():
        thin = int(np.argmin(last - first))
        raise InputError(
            f"expected a label of two or more voxels along every axis, found "
            f"{last[thin] - first[thin]} along axis {thin}"
        )
    inner = mask[tuple(slice(a, b) for a, b in zip(first, last, strict=True))]
    padded = np.pad(inner, _MARGIN)
    moved = affine.copy()
    moved[:3, 3] += affine[:3, :3] @ (first - _MARGIN)
    through = int(np.argmax(spacing))
    others = np.delete(spacing, through)
    if spacing[through] <= _COARSE * others.max():
        return LevelField(_unshrunk(_signed_distance(padded, spacing), np.ones(3)), moved)
    values = np.moveaxis(padded, through, 0)
    stack = _slice_fields(values, others, spacing[through])
    steps = int(np.ceil(spacing[through] / others.mean()))
    fine = _interpolated(stack, steps)
    moved[:3, through] /= steps
    return LevelField(np.moveaxis(fine, 0, through), moved)


def level_surface(field: LevelField) -> tuple[FloatArray, IntArray]:
    """Return the zero set of a field as a closed surface, faces counter-clockwise from outside.

    Returns
    -------
    vertices : (V, 3) float64, mm
    faces : (F, 3) int64
    """
    index, faces = zero_set(field.values)
    if len(faces) == 0:
        raise InputError("expected an outline of the label, found none")
    vertices = index @ field.affine[:3, :3].T + field.affine[:3, 3]
    corners = vertices[faces] - vertices.mean(axis=0)
    if np.linalg.det(corners).sum() < 0.0:
        faces = faces[:, [0, 2, 1]]
    return vertices, faces


def zero_set(values: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return where the field (I, J, K) on a grid is zero, by flying edges.

    Returns
    -------
    vertices : (V, 3) float64
        In indices of the grid.
    faces : (F, 3) int64
    """
    image = vtkImageData()
    image.SetDimensions(*values.shape)
    scalars = np.ascontiguousarray(values.transpose(2, 1, 0)).reshape(-1)
    image.GetPointData().SetScalars(numpy_to_vtk(scalars, deep=True))  # type: ignore[no-untyped-call]
    edges = vtkFlyingEdges3D()
    edges.SetInputData(image)
    edges.SetValue(0, 0.0)
    edges.ComputeNormalsOff()
    edges.ComputeGradientsOff()
    edges.ComputeScalarsOff()
    edges.Update()
    found = edges.GetOutput()
    if found.GetNumberOfCells() == 0:
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)
    vertices = vtk_to_numpy(  # type: ignore[no-untyped-call]
        found.GetPoints().GetData()
    ).astype(np.float64)
    connectivity = vtk_to_numpy(  # type: ignore[no-untyped-call]
        found.GetPolys().GetConnectivityArray()
    )
    return vertices, connectivity.astype(np.int64).reshape(-1, 3)


def level_values(field: LevelField, points: FloatArray) -> FloatArray:
    """Return the field at points (n, 3) in mm, by linear interpolation."""
    index = np.linalg.solve(field.affine[:3, :3], (points - field.affine[:3, 3]).T)  # (3, n)
    values: FloatArray = ndimage.map_coordinates(field.values, index, order=1, mode="nearest")
    return values


def kept_apart(
    field: LevelField,
    one: LevelField,
    two: LevelField,
    others: Sequence[LevelField],
    width: float,
) -> LevelField:
    """Return a field of several labels with a gap where two of them meet.

    The gap is ``{|h| < width |grad h| / 2}``, h the difference of the fields of the two, where
    both are near and without the other labels.

    Parameters
    ----------
    field : LevelField
        Of all labels together.
    one, two : LevelField
        Of the labels to be parted, on the same voxels.
    others : sequence of LevelField
        Of the other labels.
    width : float
        Of the gap, mm.
    """
    starts = [_start(item, field) for item in (one, two)]
    ends = [s + item.values.shape for s, item in zip(starts, (one, two), strict=True)]
    low = np.maximum(np.maximum(*starts), 0)
    high = np.minimum(np.minimum(*ends), field.values.shape)
    if (high - low < 2).any():
        return field
    box = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
    steps = np.linalg.norm(field.affine[:3, :3], axis=0)
    here, there = (_inside_box(item, field, low, high) for item in (one, two))
    height = here - there
    slope = np.sqrt(sum(g**2 for g in np.gradient(height, *steps)))
    sheet = np.abs(height) / np.maximum(slope, np.finfo(np.float64).tiny) - 0.5 * width
    sheet = np.maximum(sheet, -_NEAR_IN_WIDTHS * width - np.minimum(here, there))
    for other in others:
        sheet = np.maximum(sheet, _inside_box(other, field, low, high))
    values = field.values / _scale(field)
    values[box] = np.minimum(values[box], sheet)
    return LevelField(values, field.affine)


def _scale(field: LevelField) -> float:
    """Return about the slope of a field at its zero set: fields over it are distances."""
    steps = np.linalg.norm(field.affine[:3, :3], axis=0)
    slope = np.sqrt(sum(g**2 for g in np.gradient(field.values, *steps)))
    near = np.abs(field.values) < slope * steps.max()
    return float(np.median(slope[near])) if near.any() else 1.0


def _start(item: LevelField, field: LevelField) -> IntArray:
    """Return the place of the first node of a field on the grid of another."""
    offset = np.linalg.solve(field.affine[:3, :3], item.affine[:3, 3] - field.affine[:3, 3])
    start: IntArray = np.rint(offset).astype(np.int64)
    return start


def _inside_box(item: LevelField, field: LevelField, low: IntArray, high: IntArray) -> FloatArray:
    """Return the distance inside a field's zero set, mm, in a box of another's grid."""
    start = _start(item, field)
    inside = np.zeros(tuple((high - low).tolist()), dtype=np.bool_)
    first = np.maximum(start, low)
    last = np.minimum(start + item.values.shape, high)
    if (last > first).all():
        there = tuple(slice(a, b) for a, b in zip(first - low, last - low, strict=True))
        here = tuple(slice(a, b) for a, b in zip(first - start, last - start, strict=True))
        inside[there] = item.values[here] > 0.0
    if not inside.any():
        return np.full(inside.shape, -np.inf)
    steps = np.linalg.norm(field.affine[:3, :3], axis=0)
    return _unshrunk(_signed_distance(inside, steps), np.ones(3))


def _box(mask: BoolArray) -> tuple[IntArray, IntArray]:
    first, last = np.zeros(3, dtype=np.int64), np.zeros(3, dtype=np.int64)
    for axis in range(3):
        filled = np.flatnonzero(mask.any(axis=tuple(a for a in range(3) if a != axis)))
        first[axis], last[axis] = filled[0], filled[-1] + 1
    return first, last


def _signed_distance(mask: BoolArray, spacing: FloatArray) -> FloatArray:
    """Return the distance to the outline, positive inside; half a voxel from centres at it."""
    half = 0.5 * float(spacing.min())
    inside = ndimage.distance_transform_edt(mask, sampling=spacing)
    outside = ndimage.distance_transform_edt(~mask, sampling=spacing)
    distance: FloatArray = np.where(mask, inside - half, half - outside)
    return distance


def _unshrunk(values: FloatArray, sigma: FloatArray) -> FloatArray:
    once = ndimage.gaussian_filter(values, sigma, mode="nearest")
    smooth: FloatArray = 2.0 * once - ndimage.gaussian_filter(once, sigma, mode="nearest")
    return smooth


def _slice_fields(stack: BoolArray, spacing: FloatArray, step: float) -> FloatArray:
    """Return f of every slice (n, I, J); slices beyond the label's ends are extrapolated."""
    filled = np.flatnonzero(stack.any(axis=(1, 2)))
    fields = np.zeros(stack.shape)
    for k in filled.tolist():
        distance = _unshrunk(_signed_distance(stack[k], spacing), np.ones(2))
        distance = np.maximum(distance, -_FAR_IN_STEPS * step)
        fields[k] = distance * (2.0 * max(float(distance.max()), 0.0) - distance)
    first, last = int(filled[0]), int(filled[-1])
    for k in range(first, last):  # a gap inside the label
        if k not in filled:
            fields[k] = np.minimum(fields[k - 1], 0.0) - step**2
    for end, inward in ((first, 1), (last, -1)):
        fields[end - inward] = _beyond(fields, end, inward, last - first)
        for k in range(2, _MARGIN + 1):
            place = end - k * inward
            fields[place] = fields[place + inward] - step**2
    return fields


def _beyond(fields: FloatArray, end: int, inward: int, extent: int) -> FloatArray:
    """Return f in the empty slice after the last filled one: extrapolated, but outside."""
    here, one = fields[end], fields[end + inward]
    guess = 2.0 * here - one
    if extent >= 2:
        guess = 3.0 * here - 3.0 * one + fields[end + 2 * inward]
    # The label is not there, and does not widen towards its end.
    nowhere = -_LEAST_BEYOND * float(here.max())
    beyond: FloatArray = np.minimum(np.minimum(guess, here), nowhere)
    return beyond


def _interpolated(stack: FloatArray, steps: int) -> FloatArray:
    """Return slices (steps (n - 1) + 1, I, J) by cubic convolution (Keys 1981)."""
    n = len(stack)
    place = np.arange(steps * (n - 1) + 1) / steps
    base = np.minimum(place.astype(np.int64), n - 2)
    t = place - base
    weights = np.stack(
        [
            -0.5 * t + t**2 - 0.5 * t**3,
            1.0 - 2.5 * t**2 + 1.5 * t**3,
            0.5 * t + 2.0 * t**2 - 1.5 * t**3,
            -0.5 * t**2 + 0.5 * t**3,
        ]
    )  # (4, m)
    fine = np.zeros((len(place), *stack.shape[1:]))
    for shift in range(4):
        source = np.clip(base + shift - 1, 0, n - 1)
        fine += weights[shift][:, None, None] * stack[source]
    return fine
