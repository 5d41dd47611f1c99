"""Where openings are cut: planes and closed curves, from the study file or 3D Slicer Markups."""

import csv
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from ostiform.arrays import FloatArray, frozen_floats
from ostiform.errors import InputError
from ostiform.surface import MM_PER_UNIT
from ostiform.values import Axes, value

DEFAULT_REACH_MM = 20.0
"""The curve that a plane cuts must have its centre this near to the plane's own."""

MARKUPS_ENDINGS = (".mrk.json", ".json", ".fcsv")
_LPS_FROM = {"LPS": (1.0, 1.0, 1.0), "RAS": (-1.0, -1.0, 1.0), "1": (1.0, 1.0, 1.0),
             "0": (-1.0, -1.0, 1.0)}  # fmt: skip


@value
class Cut:
    """A plane or a closed curve that opens one tube, mm in LPS.

    Attributes
    ----------
    center : (3,) float64
    normal : (3,) float64
        Of length one; either way round.
    reach : float
        How far from `center` the centre of the curve on the surface may be.
    curve : (n, 3) float64 or None
        The closed curve to cut along, seen along the normal starlike about `center`.
    """

    center: Annotated[FloatArray, Axes(3)]
    normal: Annotated[FloatArray, Axes(3)]
    reach: float
    curve: Annotated[FloatArray, Axes("n", 3)] | None = None

    def __post_init__(self) -> None:
        """Normalise the direction."""
        length = float(np.linalg.norm(self.normal))
        if not length > 0.0:
            raise InputError("expected a normal of a cut, found a vector of length 0")
        object.__setattr__(self, "normal", frozen_floats(self.normal / length, (3,), "normal"))


@dataclass(frozen=True, slots=True, eq=False)
class Markups:
    """What a Markups file holds, by name.

    Attributes
    ----------
    cuts : mapping of str to Cut
    points : mapping of str to (3,) float64, mm in LPS
    """

    cuts: Mapping[str, Cut]
    points: Mapping[str, FloatArray]


def plane_cut(center: FloatArray, normal: FloatArray, reach: float = DEFAULT_REACH_MM) -> Cut:
    """Return the cut along a plane."""
    return Cut(center, normal, reach)


def curve_cut(curve: FloatArray) -> Cut:
    """Return the cut along a closed curve (n, 3); it need not be planar."""
    if len(curve) < 3:
        raise InputError(f"expected a closed curve of three or more points, found {len(curve)}")
    center = curve.mean(axis=0)
    _, _, axes = np.linalg.svd(curve - center)
    radius = float(np.linalg.norm(curve - center, axis=1).max())
    return Cut(center, axes[2], max(radius, 1e-9), curve)


def cut_heights(cut: Cut, points: FloatArray) -> FloatArray:
    """Return the height (n,) of points over a cut; zero where it cuts.

    Over a curve, the height over the curve's point in the same direction about the normal.
    """
    offset = points - cut.center
    height: FloatArray = offset @ cut.normal
    if cut.curve is None:
        return height
    helper = np.eye(3)[int(np.argmin(np.abs(cut.normal)))]
    first = np.cross(cut.normal, helper)
    first /= np.linalg.norm(first)
    second = np.cross(cut.normal, first)
    along = _densely(cut.curve) - cut.center
    angle = np.arctan2(along @ second, along @ first)
    order = np.argsort(angle, kind="stable")
    own = np.arctan2(offset @ second, offset @ first)
    level: FloatArray = np.interp(
        own, angle[order], (along @ cut.normal)[order], period=2.0 * np.pi
    )
    return height - level


def read_markups(path: Path, ostia: Sequence[str] = ()) -> Markups:
    """Read planes, closed curves and points from a 3D Slicer Markups file (JSON or ``.fcsv``).

    A point is named by its label. A plane or curve is named by its markup; 3D Slicer 5 writes no
    name, then that of the file (``p0_right.mrk.json``, by one of `ostia`) tells it, else the labels
    of the control points (``right-1``). Points that were skipped ("undefined") are left out with
    their labels.

    Raises
    ------
    InputError
        If the file is missing, not of that format, states no coordinate system, or holds other
        kinds of markups.
    """
    try:
        text = path.read_bytes().decode("utf-8-sig")
        listed = (
            _fcsv(path, text) if path.suffix.lower() == ".fcsv" else json.loads(text)["markups"]
        )
    except FileNotFoundError:
        raise InputError(f"{path}: expected a Markups file, found none: check cuts") from None
    except (OSError, ValueError, RecursionError, KeyError, TypeError) as error:
        raise InputError(f"{path}: expected 3D Slicer Markups (JSON), found {error}") from None
    cuts: dict[str, Cut] = {}
    points: dict[str, FloatArray] = {}
    if not isinstance(listed, list):
        raise InputError(f"{path}: expected a list of markups, found another value")
    for number, item in enumerate(listed, start=1):
        try:
            alone = named_after(path.name, ostia) if len(listed) == 1 else None
            _read_markup(item, alone, f"markup {number}", cuts, points)
        except InputError as error:
            raise InputError(f"{path}: markup {number}: {error}") from None
        except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
            raise InputError(
                f"{path}: markup {number}: expected 3D Slicer's Markups schema, found {error!r}"
            ) from None
    return Markups(cuts, points)


def named_after(file_name: str, names: Sequence[str]) -> str | None:
    """Return the one of some names with which a file's name ends, as in ``p0_right.mrk.json``."""
    stem = file_name.removesuffix(_ending(Path(file_name))).casefold()
    fitting = [
        name for name in names if re.search(rf"(^|[_.\-\s]){re.escape(name.casefold())}$", stem)
    ]
    return max(fitting, key=len, default=None)


def _ending(path: Path) -> str:
    return next((end for end in MARKUPS_ENDINGS if path.name.lower().endswith(end)), path.suffix)


def _fcsv(path: Path, text: str) -> list[Mapping[str, Any]]:
    """Return the points of 3D Slicer's former format as a markup of its present one."""
    heads = [line for line in text.splitlines() if line.startswith("#")]
    system = re.search(r"CoordinateSystem\s*=\s*(\w+)", "\n".join(heads))
    columns = re.search(r"columns\s*=\s*(.*)", "\n".join(heads))
    names = (columns[1] if columns else "id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label").split(",")
    body = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    rows = [dict(zip(names, row, strict=False)) for row in csv.reader(body)]
    controls = [
        {"label": row["label"], "position": [float(row[axis]) for axis in "xyz"]} for row in rows
    ]
    return [
        {
            "type": "Fiducial",
            "coordinateSystem": system[1] if system else "",
            "controlPoints": controls,
        }
    ]


def _read_markup(
    item: Mapping[str, Any],
    alone: str | None,
    default: str,
    cuts: dict[str, Cut],
    points: dict[str, FloatArray],
) -> None:
    system = str(item.get("coordinateSystem", "")).upper()
    if system not in _LPS_FROM:
        raise InputError(
            f'expected coordinateSystem "LPS" or "RAS", found "{system}": save it with one'
        )
    units = item.get("coordinateUnits", "mm")
    unit = units[0] if isinstance(units, list) else units
    if unit not in MM_PER_UNIT:
        raise InputError(f"expected coordinateUnits {', '.join(MM_PER_UNIT)}, found {units}")
    factors = MM_PER_UNIT[unit] * np.array(_LPS_FROM[system])
    controls = [
        (str(point.get("label", "")), _point(point["position"]))
        for point in item.get("controlPoints", [])
        if point.get("positionStatus", "defined") == "defined"
    ]
    positions = [position for _, position in controls]
    kind, name = item["type"], str(item.get("name") or alone or _common_label(controls) or default)
    if kind == "Fiducial":
        for label, position in controls:
            if label in points:
                raise InputError(f'expected every label once, found "{label}" twice')
            points[label] = factors * position
        return
    if kind not in ("Plane", "ClosedCurve"):
        raise InputError(f"expected a Plane, ClosedCurve or Fiducial, found {kind}")
    if name in cuts:
        raise InputError(f'expected every plane and curve once, found "{name}" twice')
    if kind == "Plane":
        center, normal = _plane(item, positions)
        reach = MM_PER_UNIT[unit] * _reach(item) if "size" in item else _reach(item)
        cuts[name] = plane_cut(factors * center, factors * normal, reach)
    else:
        cuts[name] = curve_cut(factors * np.array(positions).reshape(-1, 3))


def _common_label(controls: Sequence[tuple[str, FloatArray]]) -> str | None:
    """Return the name that 3D Slicer numbers the control points by: ``right-1``, ``right-2``."""
    found = {re.sub(r"-\d+$", "", label) for label, _ in controls if re.search(r".-\d+$", label)}
    return found.pop() if len(found) == 1 else None


def _plane(item: Mapping[str, Any], controls: list[FloatArray]) -> tuple[FloatArray, FloatArray]:
    if "center" in item and "normal" in item:
        return _point(item["center"]), _point(item["normal"])
    if not controls:
        raise InputError("expected a control point or centre and normal of the plane, found none")
    if len(controls) >= 3:
        one, two, three = controls[:3]
        return np.mean(controls[:3], axis=0), np.cross(two - one, three - one)
    base = np.array(item.get("baseToNode", np.eye(4)), dtype=np.float64).reshape(4, 4)
    inner = np.array(item.get("objectToBase", np.eye(4)), dtype=np.float64).reshape(4, 4)
    return controls[0], (base @ inner)[:3, 2]


def _reach(item: Mapping[str, Any]) -> float:
    bounds = item.get("planeBounds")
    size = item.get("size")
    if isinstance(size, list) and len(size) >= 2:
        half = 0.5 * max(float(size[0]), float(size[1]))
    elif isinstance(bounds, list) and len(bounds) == 4:
        half = 0.5 * max(float(bounds[1]) - float(bounds[0]), float(bounds[3]) - float(bounds[2]))
    else:
        return DEFAULT_REACH_MM
    return half if np.isfinite(half) and half > 0.0 else DEFAULT_REACH_MM


def _point(values: Any) -> FloatArray:
    point = np.array(values, dtype=np.float64)
    if point.shape != (3,) or not np.isfinite(point).all():
        raise InputError(f"expected three finite numbers, found {values}")
    return point


def _densely(curve: FloatArray) -> FloatArray:
    """Return points along the straight pieces of a closed curve."""
    share = np.linspace(0.0, 1.0, 16, endpoint=False)[:, None]
    following = np.roll(curve, -1, axis=0)
    pieces = curve[:, None] + share[None] * (following - curve)[:, None]
    return pieces.reshape(-1, 3)
