"""Solids of voxels without handles: small ones are cut or filled, large ones are told.

A handle is cut by a sheet of voxels across it, or filled by one across its hole. The sheets are
what is left over when a ball grows inside the solid, or shrinks from outside onto it, by voxels
that change no topology (Bazin & Pham 2007 have the same growth). The sheet of fewest voxels
goes first.
"""

from typing import Annotated, Literal

import numpy as np
from scipy import ndimage

from ostiform.arrays import BoolArray, FloatArray, IntArray
from ostiform.surface.extraction import zero_set
from ostiform.surface.voxel_kernels import flipped_while_simple
from ostiform.values import Axes, value

_BY_FACES = ndimage.generate_binary_structure(3, 1)
_BY_EDGES = ndimage.generate_binary_structure(3, 2)
_RANKS_PER_STEP = 2.0
"""Voxels are taken in the order of their depth, in half steps."""


@value
class VoxelChange:
    """One place where a solid was changed, or would have to be.

    Attributes
    ----------
    kind : str
        ``"cut"`` a handle across, ``"filled"`` its hole, ``"hole"`` an enclosed hole filled.
    center : (3,) float64
        In indices.
    n_voxels : int
    loop_mm : float
        Length of the curve round the cut, or through the handle: of a disc of that area.
    """

    kind: Literal["cut", "filled", "hole"]
    center: Annotated[FloatArray, Axes(3)]
    n_voxels: int
    loop_mm: float


@value
class MendedSolid:
    """A solid with what was changed, and the handles that are left.

    Attributes
    ----------
    mask : (I, J, K) bool
    changes : tuple of VoxelChange
    handles : tuple of VoxelChange
        What would take away each handle that is larger.
    """

    mask: Annotated[BoolArray, Axes(None, None, None)]
    changes: tuple[VoxelChange, ...]
    handles: tuple[VoxelChange, ...]


def solid_genus(mask: BoolArray) -> int:
    """Return the number of handles less that of further pieces and holes of a solid's surface."""
    return 1 - _euler(mask) // 2


def without_handles(
    mask: BoolArray,
    depth: FloatArray,
    step: float,
    handles_mm: float,
    may_fill: BoolArray,
    may_cut: BoolArray,
) -> MendedSolid:
    """Return the largest piece of a solid without holes and without small handles.

    Parameters
    ----------
    mask : (I, J, K) bool
        False in its two outermost layers.
    depth : (I, J, K) float64
        Signed distance from the surface, positive inside, mm.
    step : float
        Size of the voxels, mm.
    handles_mm : float
        The longest loop round, or through, a handle that is mended.
    may_fill, may_cut : (I, J, K) bool
        Where voxels may be added and taken away.
    """
    mask, changes = _one_piece(mask, step)
    handles: list[VoxelChange] = []
    if solid_genus(mask) == 0:
        return MendedSolid(mask, tuple(changes), ())
    reach = max(handles_mm / np.pi, 2.0 * step)
    sheets = [
        *_sheets(mask, _grown_inside(mask, depth, step, reach), "cut", step),
        *_sheets(mask, _shrunk_onto(mask, depth, step, reach), "filled", step),
    ]
    for where, voxels, change in sorted(sheets, key=lambda sheet: sheet[2].n_voxels):
        box = tuple(slice(max(s.start - 2, 0), s.stop + 2) for s in where)
        before = mask[box]
        after = before.copy()
        inner = tuple(
            slice(s.start - b.start, s.stop - b.start) for s, b in zip(where, box, strict=True)
        )
        after[inner][voxels] = change.kind == "filled"
        if _euler(after) <= _euler(before):
            continue
        allowed = may_fill if change.kind == "filled" else may_cut
        if change.loop_mm > handles_mm or not allowed[where][voxels].all():
            handles.append(change)
        else:
            mask[box] = after
            changes.append(change)
        if solid_genus(mask) <= 0:
            handles = []
            break
    if handles:
        handles = handles[: solid_genus(mask)]
    mask, more = _one_piece(mask, step)
    return MendedSolid(mask, (*changes, *more), tuple(handles))


def _euler(mask: BoolArray) -> int:
    """Return the Euler characteristic of the surface, up to what its box cuts off."""
    vertices, faces = zero_set(np.where(mask, 1.0, -1.0))
    return round(len(vertices) - len(faces) / 2)


def _one_piece(mask: BoolArray, step: float) -> tuple[BoolArray, list[VoxelChange]]:
    """Return the largest piece of a solid, its enclosed holes filled."""
    label, count = ndimage.label(mask, _BY_FACES)
    if count > 1:
        mask = label == 1 + int(np.argmax(np.bincount(label.ravel())[1:]))
    else:
        mask = mask.copy()
    label, count = ndimage.label(~mask, _BY_EDGES)
    outside = label[0, 0, 0]
    changes = []
    for k, where in enumerate(ndimage.find_objects(label), start=1):
        if k == outside or where is None:
            continue
        hole = label[where] == k
        mask[where] |= hole
        changes.append(_change("hole", where, hole, step))
    return mask, changes


def _change(
    kind: Literal["cut", "filled", "hole"],
    where: tuple[slice, ...],
    voxels: BoolArray,
    step: float,
) -> VoxelChange:
    center = np.argwhere(voxels).mean(axis=0) + [s.start for s in where]
    n_voxels = int(voxels.sum())
    return VoxelChange(kind, center, n_voxels, float(2.0 * step * np.sqrt(np.pi * n_voxels)))


def _sheets(
    mask: BoolArray, ball: BoolArray, kind: Literal["cut", "filled"], step: float
) -> list[tuple[tuple[slice, ...], BoolArray, VoxelChange]]:
    """Return the pieces by which a solid and a ball differ: boxes, voxels in them, and facts."""
    label, _ = ndimage.label(mask != ball, np.ones((3, 3, 3)))
    found = []
    for k, where in enumerate(ndimage.find_objects(label), start=1):
        voxels = label[where] == k
        found.append((where, voxels, _change(kind, where, voxels, step)))
    return found


def _grown_inside(mask: BoolArray, depth: FloatArray, step: float, reach: float) -> BoolArray:
    """Return a ball grown inside a solid, deep voxels first."""
    inner = np.where(mask, depth, -np.inf)
    ball, _ = _one_piece(inner > reach, step)
    if not ball.any() or solid_genus(ball) != 0:
        ball = np.zeros(mask.shape, dtype=np.bool_)
        ball[np.unravel_index(int(inner.argmax()), mask.shape)] = True
    flipped_while_simple(ball, mask & ~ball, _ranks(-depth, step, mask))
    return ball


def _shrunk_onto(mask: BoolArray, depth: FloatArray, step: float, reach: float) -> BoolArray:
    """Return a ball shrunk onto a solid, voxels far outside first."""
    ball = mask | (depth > -reach)
    ball[[0, -1]] = ball[:, [0, -1]] = ball[:, :, [0, -1]] = False
    ball, _ = _one_piece(ball, step)
    if solid_genus(ball) != 0:
        ball = np.zeros(mask.shape, dtype=np.bool_)
        ball[1:-1, 1:-1, 1:-1] = True
    flipped_while_simple(ball, ball & ~mask, _ranks(depth, step, ~mask))
    return ball


def _ranks(height: FloatArray, step: float, used: BoolArray) -> IntArray:
    least = float(height[used].min())
    ranks = np.floor((height - least) * (_RANKS_PER_STEP / step))
    result: IntArray = np.where(used, ranks, 0.0).astype(np.int64)
    return result
