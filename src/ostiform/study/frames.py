"""Time as an axis of images: the frames of one file, and when in the cycle they are."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.errors import InputError
from ostiform.values import Axes, value

_SECONDS = {
    **dict.fromkeys(("s", "sec", "second", "seconds"), 1.0),
    **dict.fromkeys(("ms", "msec", "millisecond", "milliseconds"), 1e-3),
    **dict.fromkeys(("us", "usec", "microsecond", "microseconds", "\u00b5s"), 1e-6),
}
TIME_KINDS = ("list", "time")
_WHOLE = 1e-3
"""Times within this share of a step are taken to be whole steps."""


@value
class Frames:
    """The frames of an image of four axes.

    Attributes
    ----------
    axis : int
        The file's axis of time.
    times : (n,) float64
        Increasing; 0, 1, ... where the file states none.
    unit_s : float or None
        Seconds that the times count in, where the file says so.
    """

    axis: int
    times: Annotated[FloatArray, Axes("n")]
    unit_s: float | None

    def __post_init__(self) -> None:
        """Refuse an axis of time without frames."""
        if len(self.times) < 2:
            raise InputError(f"expected two or more frames along time, found {len(self.times)}")


def places_in_cycle(frames: Frames, length_s: float | None) -> tuple[IntArray, FloatArray]:
    """Return number (n,) and time (n,), as a fraction of the cycle, of every frame.

    A cycle starts at time 0 and, where its length is not known, ends one step after the last frame.
    Frames that fall on whole steps are numbered by them, so that one that comes after missing ones
    has the number that it has in whole cycles. Times that start a cycle late or more count from
    their first.

    Raises
    ------
    InputError
        If frames lie beyond the stated length of the cycle.
    """
    times, n = frames.times, len(frames.times)
    step = float(times[-1] - times[0]) / (n - 1)
    rank = times / step
    if not 0.0 <= rank[0] < n:
        rank = rank - rank[0]
    if np.abs(rank - np.rint(rank)).max() < _WHOLE:
        rank = np.rint(rank)
        numbers = rank.astype(np.int64)
    else:
        numbers = np.arange(n)
    total = float(rank[-1]) + 1.0
    if length_s is not None and frames.unit_s is not None:
        total = length_s / (frames.unit_s * step)
        total = round(total) if abs(total - round(total)) < _WHOLE else total
        if rank[-1] >= total:
            raise InputError(
                f"expected frames within the cycle of {length_s:g} s, found the last at "
                f"{rank[-1] * step * frames.unit_s:g} s: check the length of the cycle"
            )
    return numbers, rank / total


def nifti_frames(header: Any) -> Frames | None:
    """Return the frames of a NIfTI header; None where it has one.

    Raises
    ------
    InputError
        If it has another fourth axis than time.
    """
    sizes = header.get_data_shape()
    longer = [axis for axis in range(3, len(sizes)) if sizes[axis] > 1]
    if not longer:
        return None
    unit = header.get_xyzt_units()[1]
    if longer != [3] or unit in ("hz", "ppm", "rads"):
        raise InputError(
            f"expected time as the fourth of four axes, found sizes {'x'.join(map(str, sizes))}"
            + (f" in {unit}" if longer == [3] else "")
        )
    start, step = float(header["toffset"]), float(header["pixdim"][4])
    return even_frames(3, sizes[3], start, step, _SECONDS.get(unit))


def nrrd_frames(header: Mapping[str, Any]) -> Frames | None:
    """Return the frames of an NRRD header; None where it has one.

    Raises
    ------
    InputError
        If it has more axes, or its times do not fit.
    """
    sizes = [int(size) for size in header.get("sizes", ())]
    if len(sizes) <= 3:
        return None
    rows = [
        np.full(3, np.nan) if row is None else np.array(row, dtype=np.float64)
        for row in header.get("space directions", [None] * len(sizes))
    ]
    kinds = list(header.get("kinds", [""] * len(sizes)))
    beside = [
        k
        for k, row in enumerate(rows)
        if kinds[k] in TIME_KINDS or not np.isfinite(row).all() or not row[:3].any()
    ]
    time = (*TIME_KINDS, "", "???", *(("domain",) if len(rows[0]) == 4 else ()))
    if len(sizes) > 4 or len(beside) != 1 or kinds[beside[0]] not in time:
        raise InputError(
            f"expected three axes of space and one of time, found {len(sizes)} axes"
            + (f" of kinds {', '.join(kinds)}" if any(kinds) else "")
        )
    axis = beside[0]
    if sizes[axis] == 1:
        return None
    stated = header.get(f"axis {axis} index values")
    if stated is not None and header.get(f"axis {axis} index type", "numeric") == "numeric":
        unit = str(header.get(f"axis {axis} index unit", ""))
        return _listed(axis, sizes[axis], [float(t) for t in str(stated).split()], unit)
    if len(rows[axis]) == 4:
        start = float(np.array(header.get("space origin", np.zeros(4)), dtype=np.float64)[3])
        units = header.get("space units", [""] * 4)
        step, unit = float(rows[axis][3]), units[3]
    else:
        start = float(header.get("axis mins", [0.0] * 4)[axis])
        step = float(header.get("spacings", [np.nan] * 4)[axis])
        unit = header.get("units", [""] * 4)[axis]
    return even_frames(axis, sizes[axis], start, step, _SECONDS.get(str(unit).strip(' "').lower()))


def even_frames(axis: int, count: int, start: float, step: float, unit_s: float | None) -> Frames:
    """Return frames at even times; numbered alone where the step is none."""
    if not (np.isfinite(step) and step > 0.0):
        return Frames(axis, np.arange(count, dtype=np.float64), None)
    start = start if np.isfinite(start) else 0.0
    return Frames(axis, start + step * np.arange(count, dtype=np.float64), unit_s)


def _listed(axis: int, count: int, times: Sequence[float], unit: str) -> Frames:
    listed = np.array(times)
    if len(listed) != count or not np.isfinite(listed).all() or (np.diff(listed) <= 0.0).any():
        raise InputError(
            f"expected {count} increasing times of the frames, found {len(listed)}: "
            f"{' '.join(f'{t:g}' for t in times[:12])}"
        )
    return Frames(axis, listed, _SECONDS.get(unit.strip(' "').lower()))
