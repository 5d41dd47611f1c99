"""A triangle mesh as its file holds it, before anything is known about its openings."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ostiform.arrays import FloatArray, IntArray, frozen_floats, frozen_ints, frozen_mapping
from ostiform.errors import InputError

Array = NDArray[Any]

MM_PER_UNIT: Mapping[str, float] = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "um": 0.001}
_TO_LPS = {"LPS": (1.0, 1.0, 1.0), "RAS": (-1.0, -1.0, 1.0)}
_NO_NUMBER = re.compile(rb"([-+]?)(?:1\.#)?(nan|q?s?nan|ind|inf)(?:\w|\(.*\))*", re.IGNORECASE)
"""Not a number and infinity as Windows programs print them: ``-nan(ind)``, ``1.#QNAN``."""


@dataclass(frozen=True, slots=True, eq=False)
class RawMesh:
    """A triangle mesh as its file holds it, nothing repaired; without triangles it is a cloud.

    Attributes
    ----------
    vertices : (V, 3) float64
        In the file's own units and frame.
    faces : (F, 3) int64
    point_data, cell_data : mapping of str to (V, ...) and (F, ...) arrays
    space : str or None
        ``"LPS"`` or ``"RAS"`` where the file states its frame (3D Slicer's ``SPACE=``).
    notes : tuple of str
        What was changed to have triangles, one sentence each.
    units : str or None
        Where the format fixes them, as openCARP's ``um``.
    """

    vertices: FloatArray
    faces: IntArray
    point_data: Mapping[str, Array] = field(default_factory=dict)
    cell_data: Mapping[str, Array] = field(default_factory=dict)
    space: str | None = None
    notes: tuple[str, ...] = ()
    units: str | None = None

    def __post_init__(self) -> None:
        """Check the arrays and make them read-only."""
        object.__setattr__(self, "vertices", frozen_floats(self.vertices, (None, 3), "vertices"))
        object.__setattr__(self, "faces", frozen_ints(self.faces, (None, 3), "faces"))
        for name, count in (("point_data", len(self.vertices)), ("cell_data", len(self.faces))):
            object.__setattr__(self, name, _frozen_data(getattr(self, name), count))
        if len(self.vertices) == 0:
            raise InputError("expected a surface of triangles, found no points")
        if len(self.faces) and not 0 <= self.faces.min() <= self.faces.max() < len(self.vertices):
            raise InputError(
                f"expected vertex indices from 0 to {len(self.vertices) - 1} in the triangles, "
                f"found {int(self.faces.min())} to {int(self.faces.max())}"
            )


def lps_factors(units: str, frame: str) -> FloatArray:
    """Return the factors (3,) from units and frame (``"LPS"``, ``"RAS"``) to mm in LPS.

    RAS to LPS turns by 180 degrees about the third axis, so orientation is kept.
    """
    return MM_PER_UNIT[units] * np.array(_TO_LPS[frame])


def placed_vertices(mesh: RawMesh, units: str, frame: str) -> FloatArray:
    """Return the vertices (V, 3) in mm and LPS; what the file states itself goes first.

    Raises
    ------
    InputError
        If the units are others than those of all files of the format, and not the default.
    """
    if mesh.units is not None and units not in ("mm", mesh.units):
        raise InputError(
            f"expected coordinates in {mesh.units}, as files of this format always are, found "
            f"{units} stated as units: convert the file, or leave the units out"
        )
    placed: FloatArray = mesh.vertices * lps_factors(mesh.units or units, mesh.space or frame)
    return placed


def stated_space(text: str) -> str | None:
    """Return the frame that a header or comment states as 3D Slicer does, or None.

    Raises
    ------
    InputError
        If it states another than LPS and RAS, or both.
    """
    found = sorted(set(re.findall(r"SPACE=(\w+)", text)))
    if len(found) > 1 or not set(found) <= set(_TO_LPS):
        raise InputError(
            "expected SPACE=LPS or SPACE=RAS in the file, found "
            f"{' and '.join(f'SPACE={word}' for word in found)}"
        )
    return found[0] if found else None


def numbers_of_words(words: Sequence[bytes], kind: str) -> Array:
    """Return words (n,) as numbers of a type, every digit used; NaN in any program's spelling.

    Raises
    ------
    InputError
        If a number does not fit a type of whole numbers.
    ValueError
        If a word is no number.
    """
    try:
        values = np.fromiter(map(float, words), np.float64, len(words))
    except ValueError:
        plain = (_NO_NUMBER.sub(_plain_word, word) for word in words)
        values = np.fromiter(map(float, plain), np.float64, len(words))
    dtype = np.dtype(kind)
    if dtype.kind in "iu":
        reach = np.iinfo(dtype)
        wrong = ~((values == np.rint(values)) & (values >= reach.min) & (values <= reach.max))
        if wrong.any():
            word = words[int(wrong.argmax())].decode("latin-1")
            raise InputError(f'expected whole numbers of type {dtype.name}, found "{word[:40]}"')
    return values.astype(dtype)


def _plain_word(found: re.Match[bytes]) -> bytes:
    return found[1] + (b"inf" if found[2].lower() == b"inf" else b"nan")


def joined_meshes(meshes: Sequence[RawMesh]) -> RawMesh:
    """Return one mesh that holds several; arrays that not all of them have are left out."""
    if len(meshes) == 1:
        return meshes[0]
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return RawMesh(
        vertices=np.concatenate([mesh.vertices for mesh in meshes]),
        faces=np.concatenate([s + m.faces for s, m in zip(starts, meshes, strict=False)]),
        point_data=_joined_data([mesh.point_data for mesh in meshes]),
        cell_data=_joined_data([mesh.cell_data for mesh in meshes]),
        space=meshes[0].space,
        notes=tuple(note for mesh in meshes for note in mesh.notes),
    )


def triangles_of_polygons(offsets: IntArray, connectivity: IntArray) -> tuple[IntArray, IntArray]:
    """Return polygons given by offsets (n + 1,) into a list of corners as triangles.

    A polygon of more than three corners becomes a fan about its first corner.

    Returns
    -------
    triangles : (F, 3) int64
    owner : (F,) int64
        The polygon that each comes from.

    Raises
    ------
    InputError
        If a polygon has fewer than three corners, or the offsets do not fit the list.
    """
    sizes = np.diff(offsets)
    if len(offsets) and (offsets[0] != 0 or offsets[-1] != len(connectivity)):
        raise InputError("expected a complete list of polygons, found a damaged one")
    wrong = np.flatnonzero(sizes < 3)
    if len(wrong):
        raise InputError(
            f"expected polygons of three or more corners, found {len(wrong)} with fewer, the first "
            f"with {int(sizes[wrong[0]])}: export the surface again"
        )
    owner = np.repeat(np.arange(len(sizes)), sizes - 2)
    rank = np.arange(len(owner)) - np.repeat(np.cumsum(sizes - 2) - (sizes - 2), sizes - 2)
    start = offsets[:-1][owner]
    corners = np.stack([start, start + rank + 1, start + rank + 2], axis=1)  # (F, 3)
    return connectivity[corners], owner


def polygon_notes(owner: IntArray) -> tuple[str, ...]:
    """Return what `triangles_of_polygons` did, from the polygon (F,) of each triangle."""
    _, count = np.unique(owner, return_counts=True)
    n_split = int((count > 1).sum())
    return (f"split {_counted(n_split, 'polygon')} into triangles",) if n_split else ()


def triangles_of_strips(offsets: IntArray, connectivity: IntArray) -> tuple[IntArray, IntArray]:
    """Return triangle strips as triangles (n, 3), and the strip each comes from (n,)."""
    if len(offsets) and (
        (np.diff(offsets) < 0).any() or offsets[0] != 0 or offsets[-1] != len(connectivity)
    ):
        raise InputError("expected a complete list of triangle strips, found a damaged one")
    count = np.maximum(np.diff(offsets) - 2, 0)
    owner = np.repeat(np.arange(len(count)), count)
    rank = np.arange(int(count.sum())) - np.repeat(np.cumsum(count) - count, count)
    first = offsets[:-1][owner] + rank
    triangles = connectivity[first[:, None] + np.arange(3)]  # (n, 3)
    odd = rank % 2 == 1
    triangles[odd] = triangles[odd][:, [1, 0, 2]]
    return triangles, owner


def _frozen_data(arrays: Mapping[str, Array], count: int) -> Mapping[str, Array]:
    frozen = {}
    for name, values in arrays.items():
        if len(values) != count:
            raise InputError(f"expected {count} values in the array {name}, found {len(values)}")
        copy = np.array(values)
        copy.flags.writeable = False
        frozen[name] = copy
    return frozen_mapping(frozen)


def _joined_data(arrays: Sequence[Mapping[str, Array]]) -> dict[str, Array]:
    common = [
        name
        for name in arrays[0]
        if all(
            name in other and other[name].shape[1:] == arrays[0][name].shape[1:] for other in arrays
        )
    ]
    return {name: np.concatenate([other[name] for other in arrays]) for name in common}


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"
