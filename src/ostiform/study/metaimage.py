"""Reader of MetaImage (MHA, MHD): every field that moves, selects, scales or types voxels.

A field is honoured, or the file is refused by the field's name; others are descriptions.
"""

import re
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.errors import InputError
from ostiform.study.frames import TIME_KINDS, Frames, even_frames
from ostiform.surface import MM_PER_UNIT

_TYPES = {
    "MET_CHAR": "i1", "MET_UCHAR": "u1", "MET_SHORT": "i2", "MET_USHORT": "u2",
    "MET_INT": "i4", "MET_UINT": "u4", "MET_LONG": "i4", "MET_ULONG": "u4",
    "MET_LONG_LONG": "i8", "MET_ULONG_LONG": "u8", "MET_FLOAT": "f4", "MET_DOUBLE": "f8",
}  # fmt: skip
_ONLY = {
    "ObjectType": "Image", "ElementNumberOfChannels": "1",
    "ElementToIntensityFunctionSlope": "1", "ElementToIntensityFunctionOffset": "0",
}  # fmt: skip
"""Fields of which one value can be read."""


_MOST_HEADER = 1 << 20
"""Bytes in which a header ends."""


def read_metaimage_frames(path: Path) -> Frames | None:
    """Return when the frames of a MetaImage are, from its header; None where it has one.

    Raises
    ------
    InputError
        If there is no header, or it has other axes.
    """
    with path.open("rb") as stream:
        return _frames(_header(stream.read(_MOST_HEADER))[0])


def read_metaimage(path: Path, largest: int) -> tuple[Any, FloatArray, Frames | None]:
    """Return voxels (I, J, K), affine (4, 4) to mm in LPS, and frames of a MetaImage.

    Voxels of several frames have a fourth axis.

    Parameters
    ----------
    path : Path
    largest : int
        Number of voxels beyond which a header is taken to be damaged.

    Raises
    ------
    InputError
        If a field has a value that cannot be honoured, or voxels are missing.
    """
    fields, body = _header(path.read_bytes())
    for name, value in _ONLY.items():
        if name in fields and _plain(fields[name]) != _plain(value):
            raise InputError(f"expected {name} = {value}, found {fields[name]}")
    sizes = _sizes(fields)
    if min(sizes) < 1 or np.prod(np.array(sizes, np.float64)) > largest:
        raise InputError(f"expected sizes of a grid, found {fields['DimSize']}")
    frames = _frames(fields)
    if fields["ElementType"] not in _TYPES:
        raise InputError(f"expected an element type of MetaImage, found {fields['ElementType']}")
    values = _voxels(path, fields, body, int(np.prod(sizes)))
    values = values.reshape(sizes, order="F")
    if len(sizes) == 3:
        return values, _affine(fields, [0, 1, 2]), None
    time = _time_axis(fields)
    values = values.squeeze(time) if frames is None else np.moveaxis(values, time, 3)
    return values, _affine(fields, [k for k in range(4) if k != time]), frames


def _sizes(fields: Mapping[str, str]) -> list[int]:
    sizes = [int(word) for word in fields["DimSize"].split()]
    stated = fields.get("NDims", str(len(sizes)))
    if len(sizes) not in (3, 4) or int(stated) != len(sizes):
        raise InputError(
            f"expected the sizes of three axes, or of four with time, found NDims = {stated}, "
            f"DimSize = {fields['DimSize']}"
        )
    return sizes


def _time_axis(fields: Mapping[str, str]) -> int:
    """Return the axis of time of four: the one whose kind says so, else the last."""
    kinds = fields.get("Kinds", "").split()
    return next((k for k, kind in enumerate(kinds) if kind in TIME_KINDS), 3)


def _frames(fields: Mapping[str, str]) -> Frames | None:
    sizes, time = _sizes(fields), _time_axis(fields)
    n = len(sizes)
    if n == 3 and time < 3:
        raise InputError(
            f"expected three axes of space, found Kinds = {fields['Kinds']}: images of two axes "
            "over time are no shapes"
        )
    if n == 3 or sizes[time] == 1:
        return None
    offset = _numbers(_first(fields, *_OFFSET, default=" ".join("0" * n)), n)
    spacing = _numbers(_first(fields, *_SPACING, default=" ".join("1" * n)), n)
    return even_frames(time, sizes[time], offset[time], spacing[time], None)


def _voxels(path: Path, fields: Mapping[str, str], body: bytes, count: int) -> Any:
    name = fields["ElementDataFile"]
    if name.upper() != "LOCAL":
        if Path(name).name != name or name.split()[0].upper() == "LIST" or "%" in name:
            raise InputError(f'expected the data in the file or beside it, found "{name}"')
        body = (path.parent / name).read_bytes()
    kind = _TYPES[fields["ElementType"]]
    big = _is_true(fields.get("BinaryDataByteOrderMSB", fields.get("ElementByteOrderMSB", "")))
    dtype = np.dtype((">" if big else "<") + kind)
    if not _is_true(fields.get("BinaryData", "True")):
        words = body.split()
        if len(words) < count:
            raise InputError(f"expected {count} voxels as text, found {len(words)}")
        whole = [int(w) if kind[0] != "f" else float(w) for w in words[:count]]
        return np.array(whole, dtype=kind)  # refuses what does not fit the type
    wanted = count * dtype.itemsize
    skipped = int(fields.get("HeaderSize", "0"))
    packed = _is_true(fields.get("CompressedData", ""))
    if skipped < -1 or (skipped == -1 and packed):
        raise InputError(f"expected HeaderSize from 0 on, or -1 of raw voxels, found {skipped}")
    body = body[max(len(body) - wanted, 0) :] if skipped == -1 else body[skipped:]
    if packed:
        body = zlib.decompressobj().decompress(body, wanted)
    if len(body) < wanted:
        raise InputError(f"expected {wanted} bytes of voxels, found {len(body)}: export it again")
    return np.frombuffer(body, dtype, count)


_SPACING = ("ElementSpacing", "ElementSize")
_OFFSET = ("Offset", "Position", "Origin")
_MATRIX = ("TransformMatrix", "Rotation", "Orientation")


def _first(fields: Mapping[str, str], *names: str, default: str) -> str:
    return next((fields[name] for name in names if name in fields), default)


def _affine(fields: Mapping[str, str], axes: Sequence[int]) -> FloatArray:
    """Return the affine of the three axes of space."""
    n = len(_sizes(fields))
    identity = " ".join(f"{x:g}" for x in np.eye(n).ravel())
    matrix = _numbers(_first(fields, *_MATRIX, default=identity), n * n).reshape(n, n)
    for time in set(range(n)) - set(axes):
        if np.abs(np.delete(matrix[time], time)).any() or np.delete(matrix[:, time], time).any():
            raise InputError("expected time at right angles to space, found a TransformMatrix else")
    spacing = _numbers(_first(fields, *_SPACING, default=" ".join("1" * n)), n)
    offset = _numbers(_first(fields, *_OFFSET, default=" ".join("0" * n)), n)
    if _numbers(fields.get("CenterOfRotation", " ".join("0" * n)), n).any():
        raise InputError(
            f"expected a CenterOfRotation of zeros, found {fields['CenterOfRotation']}: resample it"
        )
    affine = np.eye(4)
    # Row i of the file's matrix is the direction of axis i.
    affine[:3, :3] = matrix[np.ix_(axes, axes)].T * spacing[axes]
    affine[:3, 3] = offset[axes]
    unit = fields.get("DistanceUnits", "mm").strip('" ')
    if unit not in ("?", "UNITS_UNKNOWN", *MM_PER_UNIT):
        raise InputError(f"expected DistanceUnits mm, cm, m or um, found {unit}")
    affine[:3] *= MM_PER_UNIT.get(unit, 1.0)
    return affine


def _header(content: bytes) -> tuple[dict[str, str], bytes]:
    fields: dict[str, str] = {}
    start = 0
    while True:
        end = content.find(b"\n", start)
        line = content[start : end if end >= 0 else len(content)].decode("latin-1").strip()
        found = re.fullmatch(r"(\w+)\s*[=:]\s*(.*)", line)
        if found is None:
            raise InputError("expected the header of a MetaImage, found another one")
        fields[found[1]] = found[2]
        start = end + 1
        if found[1] == "ElementDataFile":
            break
        if end < 0 or len(fields) > 100_000:
            raise InputError("expected ElementDataFile in the header, found none")
    for needed in ("DimSize", "ElementType"):
        if needed not in fields:
            raise InputError(f"expected {needed} in the header, found none")
    return fields, content[start:] if end >= 0 else b""


def _numbers(text: str, count: int) -> FloatArray:
    values = np.array([float(word) for word in text.split()])
    if values.shape != (count,):
        raise InputError(f'expected {count} numbers in the header, found "{text[:60]}"')
    return values


def _plain(value: str) -> str | float:
    try:
        return float(value)
    except ValueError:
        return value.strip()


def _is_true(text: str) -> bool:
    return text.strip().lower()[:1] in ("t", "1")
