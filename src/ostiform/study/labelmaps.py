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
from typing import Annotated, Any

import nibabel
import nrrd
import numpy as np
from nibabel.filebasedimages import ImageFileError
from nibabel.spatialimages import HeaderDataError

from ostiform.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
)
from ostiform.errors import InputError
from ostiform.study.frames import Frames, nifti_frames, nrrd_frames
from ostiform.study.metaimage import read_metaimage, read_metaimage_frames
from ostiform.surface import MM_PER_UNIT
from ostiform.values import Axes, value

_LARGEST = 2_000_000_000
"""Voxels: a map beyond 1,250 cubed is a damaged header."""

_LEAST_RIGHT_ANGLE = 1e-3
"""Cosine between axes that still count as at right angles; scanners store four digits."""

_NIFTI_UNITS = {"mm": "mm", "micron": "um", "meter": "m", "unknown": "mm"}
_UNITS = {
    "millimeter": "mm",
    "millimetre": "mm",
    "\u00b5m": "um",
    "micron": "um",
    "micrometer": "um",
    "meter": "m",
    "metre": "m",
    "centimeter": "cm",
    "": "mm",
}
_ONE_PHASE_PER_FRAME = (
    "for one phase per frame leave {phase} out of the pattern (phase out of the sheet), or save "
    "each frame as a file of its own"
)
_NRRD_TO_LPS = {
    "left-posterior-superior": (1.0, 1.0, 1.0),
    "lps": (1.0, 1.0, 1.0),
    "right-anterior-superior": (-1.0, -1.0, 1.0),
    "ras": (-1.0, -1.0, 1.0),
    "left-anterior-superior": (1.0, -1.0, 1.0),
    "las": (1.0, -1.0, 1.0),
}


@value
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
    notes : tuple of str
        What the file leaves open about its place, one sentence each.
    """

    labels: Annotated[IntArray, Axes("I", "J", "K")]
    affine: Annotated[FloatArray, Axes(4, 4)]
    further: tuple[Annotated[IntArray, Axes("I", "J", "K")], ...] = ()
    segments: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check the axes of the voxels."""
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


def read_frames(path: Path) -> Frames | None:
    """Return when the frames of a label map are, from its header; None where it has one.

    A header that cannot be read has none: `read_label_map` says why.
    """
    reader = _FRAMES.get(_map_ending(path) or "")
    try:
        return None if reader is None else reader(path)
    except (InputError, *_DAMAGED):
        return None


def read_label_map(path: Path, frame: int | None = None) -> LabelMap:
    """Read a label map, or one frame of several.

    Parameters
    ----------
    path : Path
    frame : int, optional
        Along the file's axis of time, from 0; of a file that has one.

    Raises
    ------
    InputError
        If the file is missing, damaged, not three-dimensional (but for time), sheared, or holds
        values that are not whole numbers.
    """
    ending = _map_ending(path)
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
            layers = [
                _whole_numbers(_in_space(values, found.frames, frame)) for values in found.layers
            ]
            return LabelMap(layers[0], found.affine, tuple(layers[1:]), found.segments, found.notes)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except _DAMAGED as error:
        raise InputError(
            f"{path}: expected a label map, found a damaged file ({error}): export it again"
        ) from None


_DAMAGED = (
    ImageFileError, HeaderDataError, nrrd.NRRDError, OSError, EOFError, ValueError, KeyError,
    IndexError, TypeError, OverflowError, MemoryError, zlib.error, gzip.BadGzipFile,
)  # fmt: skip


def _map_ending(path: Path) -> str | None:
    return next((e for e in LABEL_MAP_ENDINGS if path.name.lower().endswith(e)), None)


def read_first_frame(path: Path) -> LabelMap:
    """Read a label map, or the first frame of several; errors are those of `read_label_map`."""
    return read_label_map(path, None if read_frames(path) is None else 0)


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """What a file holds: layers of voxels, the affine to LPS, and named segments.

    Layers of several frames have a fourth axis.
    """

    layers: Sequence[Any]
    affine: FloatArray
    segments: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    frames: Frames | None = None


def _read_nifti(path: Path) -> _Found:
    image: Any = nibabel.load(path)
    header: Any = image.header
    if np.prod(np.array(image.shape, dtype=np.float64)) > _LARGEST:
        raise InputError(f"expected at most {_LARGEST} voxels, found {image.shape}")
    spatial = header.get_xyzt_units()[0]
    affine = np.array(image.affine, dtype=np.float64)
    factor = MM_PER_UNIT[_NIFTI_UNITS[spatial]]
    affine[:3] *= factor
    notes = _doubt_of_place(header, affine, factor)
    frames = nifti_frames(header)
    sizes = image.shape[: 3 if frames is None else 4]
    values = image.dataobj.reshape(sizes)  # read where it is indexed
    return _Found([values], np.diag([-1.0, -1.0, 1.0, 1.0]) @ affine, notes=notes, frames=frames)


def _doubt_of_place(header: Any, taken: FloatArray, factor: float) -> tuple[str, ...]:
    """Return what a NIfTI header leaves open: two places, or none."""
    if not int(header["sform_code"]) and not int(header["qform_code"]):
        return (
            "the image states no place (sform and qform codes 0): took its middle as the origin",
        )
    if not int(header["sform_code"]) or not int(header["qform_code"]):
        return ()
    other = np.array(header.get_qform(), dtype=np.float64)
    other[:3] *= factor
    ends = np.array([[0, 0, 0, 1], [*(n - 1 for n in header.get_data_shape()[:3]), 1]]).T
    if np.abs((other - taken) @ ends).max() < 0.1 * np.linalg.norm(taken[:3, :3], axis=0).min():
        return ()
    origins = [", ".join(f"{x + 0.0:g}" for x in form[:3, 3].round(2)) for form in (taken, other)]
    return (
        f"the image states two places: took the sform (origin [{origins[0]}] mm in RAS), not the "
        f"qform (origin [{origins[1]}]) that ITK and 3D Slicer may take",
    )


def _read_nrrd(path: Path) -> _Found:
    header = nrrd.read_header(str(path))
    sizes = np.array(header.get("sizes", [0]), dtype=np.float64)
    if sizes.prod() > _LARGEST:
        raise InputError(f"expected at most {_LARGEST} voxels, found sizes {sizes.tolist()}")
    data_file = header.get("data file", header.get("datafile"))
    if data_file is not None and Path(str(data_file)).name != str(data_file):
        raise InputError("expected the data in the file or beside it, found another folder")
    for key in ("old min", "oldmin", "old max", "oldmax"):
        if key in header:
            raise InputError(f'expected voxels as they are, found "{key}" of scaled ones')
    values, header = nrrd.read(str(path))
    space, notes = str(header.get("space", "")).lower(), tuple[str, ...]()
    frames = _frames_of_nrrd(header)
    if not space and frames is not None and header.get("space dimension") == 4:
        space = "lps"
        notes = ("the image names no space: took left-posterior-superior as ITK does",)
    space = space.removesuffix("-time") if len(space) > 4 else space[:3]
    if space not in _NRRD_TO_LPS:
        raise InputError(
            f'expected a space of NRRD such as left-posterior-superior, found "{space}"'
        )
    directions = np.array(
        [[np.nan] * 3 if row is None else row[:3] for row in header["space directions"]],
        dtype=np.float64,
    )
    beside = np.flatnonzero(~np.isfinite(directions).all(axis=1) | ~directions.any(axis=1))
    has_layers = values.ndim == 4 and len(beside) == 1 and frames is None
    if len(directions) == 4 and len(beside) == 1:
        # Layers first, time last.
        values = np.moveaxis(values, beside[0], 0 if has_layers else 3)
        directions = np.delete(directions, beside, axis=0)
    if directions.shape != (3, 3) or not np.isfinite(directions).all():
        raise InputError(
            "expected three space directions, found a file of other axes: save a label map or a "
            "segmentation"
        )
    affine = np.eye(4)
    affine[:3, :3] = directions.T
    affine[:3, 3] = np.array(header.get("space origin", np.zeros(3)), dtype=np.float64)[:3]
    units = [str(unit).strip(' "').lower() for unit in header.get("space units", ["mm"])[:3]]
    factors = [MM_PER_UNIT.get(_UNITS.get(unit, unit)) for unit in units]
    if len(set(factors)) > 1 or factors[0] is None:
        raise InputError(f"expected space units of one length, found {', '.join(units)}")
    affine[:3] *= factors[0]
    layers = list(values) if has_layers else [values]
    segments = _segments(header, len(layers))
    if any(not 0 <= layer < len(layers) for layer, _ in segments.values()):
        raise InputError(f"expected segments in {len(layers)} layers, found one in another layer")
    to_lps = np.diag([*_NRRD_TO_LPS[space], 1.0])
    return _Found(layers, to_lps @ affine, segments, notes, frames)


def _segments(header: Mapping[str, Any], n_layers: int) -> dict[str, tuple[int, int]]:
    """Return layer and value of the segments of a 3D Slicer segmentation, by name.

    3D Slicer up to 4.10 wrote neither: the n-th segment has the n-th layer for itself.
    """
    segments: dict[str, tuple[int, int]] = {}
    for key, name in header.items():
        found = re.fullmatch(r"Segment(\d+)_Name", str(key))
        if found is None:
            continue
        own = int(found[1]) if n_layers > 1 else 0
        layer = int(header.get(f"Segment{found[1]}_Layer", own))
        value = header.get(f"Segment{found[1]}_LabelValue")
        if value is None and n_layers == 1 and segments:
            raise InputError("expected the label value of every segment, found none: save it anew")
        if str(name) in segments:
            raise InputError(f"expected every segment once, found two named {name}: rename one")
        segments[str(name)] = (layer, int(value or 1))
    return segments


def _in_space(values: Any, frames: Frames | None, frame: int | None) -> Any:
    """Return the voxels (I, J, K) of one frame."""
    if frames is None:
        if frame is not None:
            raise InputError(
                "expected frames as in the other files of the shape, found an image without time"
            )
        return np.asanyarray(values)
    if frame is None:
        raise InputError(
            f"expected one shape, found {len(frames.times)} frames: {_ONE_PHASE_PER_FRAME}"
        )
    if frame >= len(frames.times):
        raise InputError(f"expected a frame {frame}, found {len(frames.times)} frames from 0")
    return np.asanyarray(values[..., frame])


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


def _metaimage(path: Path) -> _Found:
    values, affine, frames = read_metaimage(path, _LARGEST)
    return _Found([values], affine, frames=frames)


_READERS: Mapping[str, Callable[[Path], _Found]] = {
    ".nii": _read_nifti,
    ".nii.gz": _read_nifti,
    ".nrrd": _read_nrrd,
    ".nhdr": _read_nrrd,
    ".mha": _metaimage,
    ".mhd": _metaimage,
}

LABEL_MAP_ENDINGS = tuple(_READERS)

_FRAMES: Mapping[str, Callable[[Path], Frames | None]] = {
    ".nii": lambda path: nifti_frames(nibabel.load(path).header),
    ".nii.gz": lambda path: nifti_frames(nibabel.load(path).header),
    ".nrrd": lambda path: _frames_of_nrrd(nrrd.read_header(str(path))),
    ".nhdr": lambda path: _frames_of_nrrd(nrrd.read_header(str(path))),
    ".mha": read_metaimage_frames,
    ".mhd": read_metaimage_frames,
}


def _frames_of_nrrd(header: Mapping[str, Any]) -> Frames | None:
    return None if _segments(header, 0) else nrrd_frames(header)
