"""Reading label maps: NIfTI, NRRD and MetaImage, with their place in space.

Every map comes back with the affine from voxel indices to millimetres in LPS, whatever the
frame of its format (NIfTI: RAS; MetaImage: LPS; NRRD: as its header says).
"""

import gzip
import re
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import nibabel
import nrrd
import numpy as np
from nibabel.filebasedimages import ImageFileError
from nibabel.spatialimages import HeaderDataError

from ostiform.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    frozen_floats,
    frozen_ints,
    frozen_mapping,
)
from ostiform.errors import InputError

_LARGEST = 2_000_000_000
"""Voxels: a map beyond 1,250 cubed is a damaged header."""

_LEAST_RIGHT_ANGLE = 1e-3
"""Cosine between axes that still count as at right angles; scanners store four digits."""

_UNITS = {"mm": 1.0, "micron": 0.001, "meter": 1000.0, "unknown": 1.0}
_NRRD_TO_LPS = {
    "left-posterior-superior": (1.0, 1.0, 1.0),
    "lps": (1.0, 1.0, 1.0),
    "right-anterior-superior": (-1.0, -1.0, 1.0),
    "ras": (-1.0, -1.0, 1.0),
    "left-anterior-superior": (1.0, -1.0, 1.0),
    "las": (1.0, -1.0, 1.0),
}
_META_TYPES = {
    "MET_CHAR": "i1", "MET_UCHAR": "u1", "MET_SHORT": "i2", "MET_USHORT": "u2",
    "MET_INT": "i4", "MET_UINT": "u4", "MET_LONG": "i4", "MET_ULONG": "u4",
    "MET_LONG_LONG": "i8", "MET_ULONG_LONG": "u8", "MET_FLOAT": "f4", "MET_DOUBLE": "f8",
}  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class LabelMap:
    """Labels on a grid.

    Attributes
    ----------
    labels : (I, J, K) int64
    affine : (4, 4) float64
        From voxel indices (of centres) to mm in LPS (column vectors).
    further : tuple of (I, J, K) int64
        Further layers of a 3D Slicer segmentation whose segments overlap.
    segments : mapping of str to tuple of int
        Layer (0 for `labels`) and value of every segment by its name, where the file names them.
    """

    labels: IntArray
    affine: FloatArray
    further: tuple[IntArray, ...] = ()
    segments: Mapping[str, tuple[int, int]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the arrays and make them read-only."""
        object.__setattr__(self, "labels", frozen_ints(self.labels, (None, None, None), "labels"))
        further = tuple(frozen_ints(item, self.labels.shape, "labels") for item in self.further)
        object.__setattr__(self, "further", further)
        object.__setattr__(self, "segments", frozen_mapping(self.segments))
        object.__setattr__(self, "affine", frozen_floats(self.affine, (4, 4), "affine"))
        axes = self.affine[:3, :3]
        lengths = np.linalg.norm(axes, axis=0)
        if not (lengths > 0.0).all():
            raise InputError(
                f"expected positive voxel sizes, found {', '.join(f'{x:g}' for x in lengths)} mm"
            )
        cosines = np.abs((axes / lengths).T @ (axes / lengths) - np.eye(3)).max()
        if cosines > _LEAST_RIGHT_ANGLE:
            raise InputError(
                f"expected voxel axes at right angles, found a cosine of {cosines:.3g} between "
                "two: resample the map without shear"
            )


def label_mask(label_map: LabelMap, wanted: Sequence[int | str]) -> BoolArray:
    """Return the voxels (I, J, K) that have one of some labels, given by value or segment name.

    Raises
    ------
    InputError
        If there is no segment of a name, or a value stands for different segments of two layers.
    """
    layers = (label_map.labels, *label_map.further)
    mask = np.zeros(label_map.labels.shape, dtype=np.bool_)
    for item in wanted:
        if isinstance(item, str):
            if item not in label_map.segments:
                found = ", ".join(label_map.segments) or "none"
                raise InputError(f'expected a segment named "{item}", found {found}')
            layer, value = label_map.segments[item]
            mask |= layers[layer] == value
            continue
        holding = [layer == item for layer in layers]
        holding = [own for own in holding if own.any()]
        if len(holding) > 1:
            names = [name for name, (_, value) in label_map.segments.items() if value == item]
            raise InputError(
                f"expected the label {item} in one layer, found it in {len(holding)} "
                f'({", ".join(names)}): name the segment in labels.values, as LV = "LV"'
            )
        for own in holding:
            mask |= own
    return mask


def is_label_map(path: Path) -> bool:
    """Return whether a file is a label map by its ending."""
    return path.name.lower().endswith(LABEL_MAP_ENDINGS)


def read_label_map(path: Path) -> LabelMap:
    """Read a label map.

    Raises
    ------
    InputError
        If the file is missing, damaged, not three-dimensional, sheared, or holds values that
        are not whole numbers.
    """
    ending = next((e for e in LABEL_MAP_ENDINGS if path.name.lower().endswith(e)), None)
    if ending is None:
        raise InputError(
            f"{path}: expected a label map ending in {', '.join(LABEL_MAP_ENDINGS)}, found another"
        )
    if not path.is_file():
        raise InputError(f"{path}: expected a label map, found no file: check the path")
    if path.stat().st_size == 0:
        raise InputError(f"{path}: expected a label map, found an empty file")
    try:
        with np.errstate(all="ignore"):
            found = _READERS[ending](path)
            layers = [_whole_numbers(_three_axes(values)) for values in found.layers]
            return LabelMap(layers[0], found.affine, tuple(layers[1:]), found.segments)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except (
        ImageFileError, HeaderDataError, nrrd.NRRDError, OSError, EOFError, ValueError, KeyError,
        IndexError, TypeError, OverflowError, MemoryError, zlib.error, gzip.BadGzipFile,
    ) as error:  # fmt: skip
        raise InputError(
            f"{path}: expected a label map, found a damaged file ({error}): export it again"
        ) from None


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """What a file holds: layers of voxels, the affine to LPS, and named segments."""

    layers: Sequence[Any]
    affine: FloatArray
    segments: Mapping[str, tuple[int, int]] = field(default_factory=dict)


def _read_nifti(path: Path) -> _Found:
    image: Any = nibabel.load(path)
    header: Any = image.header
    if np.prod(np.array(image.shape, dtype=np.float64)) > _LARGEST:
        raise InputError(f"expected at most {_LARGEST} voxels, found {image.shape}")
    spatial = header.get_xyzt_units()[0]
    affine = np.array(image.affine, dtype=np.float64)
    affine[:3] *= _UNITS.get(spatial, 1.0)
    return _Found([np.asanyarray(image.dataobj)], np.diag([-1.0, -1.0, 1.0, 1.0]) @ affine)


def _read_nrrd(path: Path) -> _Found:
    header = nrrd.read_header(str(path))
    sizes = np.array(header.get("sizes", [0]), dtype=np.float64)
    if sizes.prod() > _LARGEST:
        raise InputError(f"expected at most {_LARGEST} voxels, found sizes {sizes.tolist()}")
    data_file = header.get("data file", header.get("datafile"))
    if data_file is not None and Path(str(data_file)).name != str(data_file):
        raise InputError("expected the data in the file or beside it, found another folder")
    values, header = nrrd.read(str(path))
    space = str(header.get("space", "")).lower()
    if space not in _NRRD_TO_LPS:
        raise InputError(
            f'expected a space of NRRD such as left-posterior-superior, found "{space}"'
        )
    directions = np.array(
        [[np.nan] * 3 if row is None else row for row in header["space directions"]],
        dtype=np.float64,
    )
    has_layers = values.ndim == 4 and directions.shape == (4, 3) and np.isnan(directions[0]).all()
    directions = directions[1:] if has_layers else directions
    if directions.shape != (3, 3) or not np.isfinite(directions).all():
        raise InputError(
            "expected three space directions, found a file of other axes: save a label map or a "
            "segmentation"
        )
    affine = np.eye(4)
    affine[:3, :3] = directions.T
    affine[:3, 3] = np.array(header.get("space origin", np.zeros(3)), dtype=np.float64)
    layers = list(values) if has_layers else [values]
    segments = _segments(header)
    if any(not 0 <= layer < len(layers) for layer, _ in segments.values()):
        raise InputError(f"expected segments in {len(layers)} layers, found one in another layer")
    return _Found(layers, np.diag([*_NRRD_TO_LPS[space], 1.0]) @ affine, segments)


def _segments(header: Mapping[str, Any]) -> dict[str, tuple[int, int]]:
    """Return layer and value of the segments of a 3D Slicer segmentation, by name."""
    segments = {}
    for key, name in header.items():
        found = re.fullmatch(r"Segment(\d+)_Name", str(key))
        if found is None:
            continue
        layer = int(header.get(f"Segment{found[1]}_Layer", 0))
        value = int(header.get(f"Segment{found[1]}_LabelValue", 1))
        segments[str(name)] = (layer, value)
    return segments


def _read_metaimage(path: Path) -> _Found:
    content = path.read_bytes()
    fields, body = _meta_header(content)
    sizes = [int(word) for word in fields["DimSize"].split()]
    if len(sizes) != 3 or min(sizes) < 1 or np.prod(np.array(sizes, np.float64)) > _LARGEST:
        raise InputError(f"expected three sizes of a grid, found {fields['DimSize']}")
    if fields.get("ElementNumberOfChannels", "1") != "1":
        raise InputError("expected one value per voxel, found several channels")
    kind = fields["ElementType"]
    if kind not in _META_TYPES:
        raise InputError(f"expected an element type of MetaImage, found {kind}")
    if fields["ElementDataFile"] != "LOCAL":
        name = fields["ElementDataFile"]
        if Path(name).name != name or name in ("LIST", ""):
            raise InputError(f'expected the data in the file or beside it, found "{name}"')
        body = (path.parent / name).read_bytes()
    big = _is_true(fields.get("BinaryDataByteOrderMSB", fields.get("ElementByteOrderMSB", "")))
    dtype = np.dtype((">" if big else "<") + _META_TYPES[kind])
    wanted = int(np.prod(sizes)) * dtype.itemsize
    if _is_true(fields.get("CompressedData", "")):
        body = zlib.decompressobj().decompress(body, wanted)
    if len(body) < wanted:
        raise InputError(f"expected {wanted} bytes of voxels, found {len(body)}: export it again")
    values = np.frombuffer(body, dtype, int(np.prod(sizes))).reshape(sizes, order="F")
    spacing = _numbers(fields.get("ElementSpacing", fields.get("ElementSize", "1 1 1")), 3)
    matrix = fields.get("TransformMatrix", fields.get("Orientation", "1 0 0 0 1 0 0 0 1"))
    affine = np.eye(4)
    # Row i of the file's matrix is the direction of axis i.
    affine[:3, :3] = _numbers(matrix, 9).reshape(3, 3).T * spacing
    affine[:3, 3] = _numbers(fields.get("Offset", fields.get("Position", "0 0 0")), 3)
    return _Found([values], affine)


def _meta_header(content: bytes) -> tuple[dict[str, str], bytes]:
    fields: dict[str, str] = {}
    start = 0
    while True:
        end = content.find(b"\n", start)
        line = content[start : end if end >= 0 else len(content)].decode("latin-1").strip()
        found = re.fullmatch(r"(\w+)\s*=\s*(.*)", line)
        if found is None:
            raise InputError("expected the header of a MetaImage, found another one")
        fields[found[1]] = found[2]
        start = end + 1
        if found[1] == "ElementDataFile":
            break
        if end < 0 or len(fields) > 200:
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


def _is_true(text: str) -> bool:
    return text.strip().lower() in ("true", "1")


def _three_axes(values: Any) -> Any:
    while values.ndim > 3 and values.shape[-1] == 1:
        values = values[..., 0]
    if values.ndim != 3:
        raise InputError(f"expected three axes of voxels, found {values.ndim}")
    return values


def _whole_numbers(values: Any) -> IntArray:
    if values.dtype.kind in "iub":
        return np.asarray(values, dtype=np.int64)
    if values.dtype.kind != "f":
        raise InputError(f"expected numbers as labels, found values of type {values.dtype}")
    if not np.isfinite(values).all():
        raise InputError("expected whole numbers as labels, found values that are not finite")
    rounded = np.rint(values)
    if np.abs(values - rounded).max(initial=0.0) > 1e-3 or np.abs(rounded).max(initial=0.0) > 1e9:
        raise InputError(
            "expected whole numbers as labels, found fractions: this is an image, not a label map"
        )
    labels: IntArray = rounded.astype(np.int64)
    return labels


_READERS: Mapping[str, Callable[[Path], _Found]] = {
    ".nii": _read_nifti,
    ".nii.gz": _read_nifti,
    ".nrrd": _read_nrrd,
    ".nhdr": _read_nrrd,
    ".mha": _read_metaimage,
    ".mhd": _read_metaimage,
}

LABEL_MAP_ENDINGS = tuple(_READERS)
