"""Guide points: files of the public tools that fit biventricular models to cine examinations.

A text file separated by tabulators whose first line names the columns: ``x``, ``y``, ``z`` (mm,
LPS), ``contour type`` (``SAX_LV_ENDOCARDIAL``, ``MITRAL_VALVE``, ...), then the slice (``frameID``,
``sliceID`` or ``slice``), ``weight`` and ``time frame``. One file holds one phase or several. These
are the files of BiV-me (Mauger and others, EMBC 2018).
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.errors import InputError
from ostiform.fitting.sequence_types import SliceContours

CELL_MM = 2.0
"""Points of one contour within a cell of this size are one point, their mean."""

_TYPE = ("contour type", "contourtype", "contour_type", "type")
_SLICE = ("frameid", "sliceid", "slice", "slice id", "slice number")
_TIME = ("time frame", "timeframe", "time_frame", "phase")
_EITHER = "frame"

_CHAMBERS = (
    ("LV_ENDOCARDIAL", r"lv([ _-]?endo.*)?|.*left[ _-]?ventric.*|ventricle|.*lv.*endo.*"),
    ("LV_EPICARDIAL", r".*epi.*"),
    ("RV_ENDOCARDIAL", r"rv([ _-]?endo.*)?|.*right[ _-]?ventric.*|.*rv.*endo.*"),
    ("RV_FREEWALL", r"rv([ _-]?endo.*)?|.*right[ _-]?ventric.*|.*rv.*endo.*"),
    ("RV_SEPTUM", r"rv([ _-]?endo.*)?|.*right[ _-]?ventric.*|.*rv.*endo.*"),
    ("RV_EPICARDIAL", r".*rv.*epi.*"),
    ("LA", r"la|.*left[ _-]?atri.*|atrium"),
    ("RA", r"ra|.*right[ _-]?atri.*"),
)
_VALVES = {
    "MITRAL_VALVE": "mitral",
    "AORTA_VALVE": "aort",
    "TRICUSPID_VALVE": "tricuspid",
    "PULMONARY_VALVE": "pulmon",
}
_PLANE_MM = 0.5
"""Points of a slice lie within this of a plane."""


@dataclass(frozen=True, slots=True, eq=False)
class GuidePoints:
    """What a file of guide points holds; n points of weight above zero.

    Attributes
    ----------
    positions : (n, 3) float64, mm in LPS
    types : (n,) tuple of str
    slices : (n,) tuple of str
    frames : (n,) int64
        Time frames.
    """

    positions: FloatArray
    types: tuple[str, ...]
    slices: tuple[str, ...]
    frames: IntArray


def is_guide_point_file(path: Path) -> bool:
    """Return whether the first line of a text file names x, y, z and a contour type."""
    try:
        with path.open(encoding="utf-8-sig", errors="strict") as stream:
            names = _names(stream.readline(4096))
    except (OSError, UnicodeDecodeError):
        return False
    return {"x", "y", "z"} <= set(names) and any(name in _TYPE for name in names)


def read_guide_points(path: Path) -> GuidePoints:
    """Read a file of guide points.

    A column ``frame`` beside neither slice nor time is the slice where the points of each of its
    values lie in a plane (as the tools mean it), else the time.

    Raises
    ------
    InputError
        If a column is missing or a row is not what the first line says.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: expected guide points as text, found {error}") from None
    names = _names(lines[0]) if lines else []
    columns = {axis: names.index(axis) for axis in "xyz" if axis in names}
    kind = _column(names, _TYPE)
    if len(columns) < 3 or kind is None:
        raise InputError(
            f"{path}: expected a first line with the columns x, y, z and contour type, separated "
            f"by tabulators, found {', '.join(names) or 'nothing'}"
        )
    rows, types, cells = [], [], []
    for number, line in enumerate(lines[1:], start=2):
        if not line.strip():
            continue
        words = [word.strip() for word in line.split("\t")]
        if len(words) == len(names) + 1 and words[-1] == "":
            words.pop()  # some writers end every row with a tabulator
        if len(words) != len(names):
            raise InputError(
                f"{path}, line {number}: expected {len(names)} columns as in the first line, "
                f"found {len(words)}"
            )
        try:
            rows.append([float(words[columns[axis]]) for axis in "xyz"])
        except ValueError:
            raise InputError(
                f"{path}, line {number}: expected numbers for x, y and z, found {line[:60]!r}"
            ) from None
        types.append(words[kind])
        cells.append(words)
    if not rows:
        raise InputError(f"{path}: expected guide points, found none")
    positions = np.array(rows)
    if not np.isfinite(positions).all():
        raise InputError(f"{path}: expected finite positions, found others")
    slices, frames = _slices_and_frames(path, names, cells, positions)
    weight = _column(names, ("weight",))
    used = np.ones(len(rows), dtype=np.bool_)
    if weight is not None:
        used = np.array(
            [_number(path, k + 2, words[weight]) > 0.0 for k, words in enumerate(cells)]
        )
    kept = np.flatnonzero(used)
    return GuidePoints(
        positions[kept],
        tuple(types[k] for k in kept),
        tuple(slices[k] for k in kept),
        frames[kept],
    )


def guide_contours(
    found: GuidePoints, chosen: IntArray, parts: Sequence[str], openings: Sequence[str]
) -> tuple[tuple[SliceContours, ...], tuple[str, ...]]:
    """Return some guide points as contours of a model's parts, and the types that it has not.

    Parameters
    ----------
    found : GuidePoints
    chosen : (m,) int64
        Of one phase.
    parts, openings : sequence of str
        Of the model; openings by their full name.

    Returns
    -------
    contours : tuple of SliceContours
        Points of valves lie on the rim of their opening, of walls on their part.
    unknown : tuple of str
        Types that no part or opening of the model stands for.
    """
    groups: dict[tuple[str, str], list[int]] = {}
    for k in chosen:
        groups.setdefault((found.slices[k], found.types[k]), []).append(int(k))
    contours, unknown = [], []
    for (slice_name, kind), rows in groups.items():
        opening = _opening(kind, openings)
        part = None if opening else _part(kind, parts)
        if opening is None and part is None:
            unknown.append(kind)
            continue
        points = _thinned(found.positions[rows]) if opening is None else found.positions[rows]
        curves = tuple(point[None] for point in points)
        owner = opening.partition(".")[0] if opening else part
        contours.append(SliceContours(f"slice {slice_name}", curves, owner, opening))
    return tuple(contours), tuple(dict.fromkeys(unknown))


def _names(line: str) -> list[str]:
    return [name.strip().casefold() for name in line.rstrip("\r\n").split("\t")]


def _column(names: Sequence[str], known: Sequence[str]) -> int | None:
    return next((names.index(name) for name in known if name in names), None)


def _number(path: Path, number: int, word: str) -> float:
    try:
        return float(word)
    except ValueError:
        raise InputError(f"{path}, line {number}: expected a number, found {word!r}") from None


def _slices_and_frames(
    path: Path, names: Sequence[str], cells: Sequence[Sequence[str]], positions: FloatArray
) -> tuple[list[str], IntArray]:
    of_slice, of_time = _column(names, _SLICE), _column(names, _TIME)
    either = names.index(_EITHER) if _EITHER in names else None
    if either is not None and of_time is None and of_slice is not None:
        of_time = either
    elif either is not None and of_slice is None:
        values = np.array([words[either] for words in cells])
        if of_time is not None or _are_planes(values, positions):
            of_slice = either
        else:
            of_time = either
    slices = [words[of_slice] if of_slice is not None else "1" for words in cells]
    if of_time is None:
        return slices, np.zeros(len(cells), dtype=np.int64)
    numbers = [_number(path, k + 2, words[of_time]) for k, words in enumerate(cells)]
    return slices, np.rint(numbers).astype(np.int64)


def _are_planes(values: np.ndarray, positions: FloatArray) -> bool:
    for value in np.unique(values):
        own = positions[values == value]
        own = own - own.mean(axis=0)
        if len(own) > 3 and np.linalg.svd(own)[1][2] / np.sqrt(len(own)) > _PLANE_MM:
            return False
    return True


def _opening(kind: str, openings: Sequence[str]) -> str | None:
    """Return the opening that a type of points is the valve of; of a seam the first name."""
    word = _VALVES.get(kind.upper())
    if word is None:
        return None
    return next((name for name in openings if word in name.partition(".")[2].casefold()), None)


def _part(kind: str, parts: Sequence[str]) -> str | None:
    plain = kind.upper().removeprefix("SAX_").removeprefix("LAX_")
    if plain == "APEX_POINT":
        plain = "LV_ENDOCARDIAL"
    for name, pattern in _CHAMBERS:
        if plain == name:
            fitting = [part for part in parts if re.fullmatch(pattern, part, re.IGNORECASE)]
            if name == "LV_ENDOCARDIAL":
                fitting = [part for part in fitting if "epi" not in part.casefold()]
            return fitting[0] if fitting else None
    return None


def _thinned(points: FloatArray) -> FloatArray:
    """Return the means (m, 3) of points in cells; their order says nothing."""
    cells = np.floor(points / CELL_MM).astype(np.int64)
    _, index, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    means = np.zeros((len(count), 3))
    np.add.at(means, index.ravel(), points)
    return means / count[:, None]
