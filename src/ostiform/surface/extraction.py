"""Surfaces of label maps: from voxels to a smooth, closed triangulation.

Shape-based interpolation: in every slice the signed distance d to the label's outline; with r the
largest distance in the slice, ``f = d (2 r - d)`` has the same zero set and is, for round
sections, a polynomial of degree two in space (``r^2 - x^2 - y^2`` for a disc). So f is
interpolated between slices by cubic convolution, which reproduces such polynomials, and
extrapolated by one slice where the label ends. Voxel steps within slices are smoothed by
``2 G - G G`` (G a Gaussian of one voxel), which keeps polynomials of degree three: nothing shrinks.
"""

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
    if not is_coarse(spacing):
        return LevelField(_unshrunk(signed_distance(padded, spacing), np.ones(3)), moved)
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


def is_coarse(steps: FloatArray) -> bool:
    """Return whether slices lie so far apart, by voxel sizes (3,), that they are interpolated."""
    through = int(np.argmax(steps))
    return bool(steps[through] > _COARSE * np.delete(steps, through).max())


def solid_field(distance: FloatArray) -> FloatArray:
    """Return a signed distance from voxels (I, J, K) without their steps."""
    return _unshrunk(distance, np.ones(3))


def _box(mask: BoolArray) -> tuple[IntArray, IntArray]:
    first, last = np.zeros(3, dtype=np.int64), np.zeros(3, dtype=np.int64)
    for axis in range(3):
        filled = np.flatnonzero(mask.any(axis=tuple(a for a in range(3) if a != axis)))
        first[axis], last[axis] = filled[0], filled[-1] + 1
    return first, last


def signed_distance(mask: BoolArray, spacing: FloatArray) -> FloatArray:
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
        distance = _unshrunk(signed_distance(stack[k], spacing), np.ones(2))
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
