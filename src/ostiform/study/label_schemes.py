"""Parts of label maps: by the names of segments, by known values, by what encloses what."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy import ndimage

from ostiform.arrays import BoolArray
from ostiform.errors import InputError
from ostiform.study.labelmaps import LabelMap, label_mask

Labels = int | str | tuple[int | str, ...]

_SCHEMES: Mapping[str, Mapping[int, str]] = {
    "MM-WHS": {
        500: "LV", 600: "RV", 420: "LA", 550: "RA", 205: "MYO", 820: "AO", 850: "PA",
    },
    "TotalSegmentator heartchambers_highres": {
        1: "MYO", 2: "LA", 3: "LV", 4: "RA", 5: "RV", 6: "AO", 7: "PA",
    },
}  # fmt: skip
_TOTAL = {51: "heart", 52: "AO", 53: "PV", 61: "LAA", 62: "SVC", 63: "IVC"}
"""Of TotalSegmentator's 117 structures."""
_SHORT_AXIS = re.compile(
    r"(?<![a-z])(sa|sax|cine|acdc|mnms?|cardiac|heart|gt|lv)(?![a-z])", re.IGNORECASE
)
_CHAMBERS = (
    ("LV", r"lv|.*(left.*ventric|ventric.*left).*"),
    ("RV", r"rv|.*(right.*ventric|ventric.*right).*"),
    ("LA", r"la|.*(left.*atri|atri.*left).*"),
    ("RA", r"ra|.*(right.*atri|atri.*right).*"),
    ("AO", r"ao|.*aort.*"),
    ("PA", r"pa|.*pulmonary.*artery.*"),
    ("MYO", r"myo|.*myocard.*"),
)
_VALVES = {
    frozenset(("LV", "LA")): "mitral",
    frozenset(("RV", "RA")): "tricuspid",
    frozenset(("LV", "AO")): "aortic",
    frozenset(("RV", "PA")): "pulmonary",
}
_MOST_LABELS = 40
_ENCLOSED = 0.6
"""Share of the border of a cavity that its wall covers."""
_FILLED = 0.05


@dataclass(frozen=True, slots=True)
class LabelParts:
    """Parts that a label map may be divided into.

    Attributes
    ----------
    values : mapping of str to labels
        By part; empty where the map has one label.
    notes : tuple of str
    """

    values: Mapping[str, Labels]
    notes: tuple[str, ...] = ()


def label_parts(label_map: LabelMap, name: str) -> LabelParts:
    """Return the parts of a label map.

    Parameters
    ----------
    label_map : LabelMap
    name : str
        Of its file, which may tell of a short-axis image of the heart.

    Raises
    ------
    InputError
        If it holds very many values of no known scheme.
    """
    if label_map.segments and len(label_map.segments) <= _MOST_LABELS:
        named: dict[str, Labels] = {
            re.sub(r"[./\\{}=+]", "_", segment).strip(): segment for segment in label_map.segments
        }
        return _with_wall(named, ())
    values = np.unique(label_map.labels)
    present = [v for v in values.tolist() if v]
    for scheme, names in _SCHEMES.items():
        if set(present) <= set(names) and (scheme == "MM-WHS" or len(present) >= 5):
            return _with_wall({names[v]: v for v in present}, (f"labels of {scheme}",))
    if len(present) > 1 and set(present) <= set(range(1, 118)) and {51, 52} <= set(present):
        found: dict[str, Labels] = {_TOTAL[v]: v for v in present if v in _TOTAL}
        return LabelParts(found, ("labels of TotalSegmentator total: those of the heart",))
    if len(present) > _MOST_LABELS:
        raise InputError(f"expected a label map of a few labels, found {len(values)} values")
    if len(present) < 2:
        return LabelParts({})
    short_axis = _short_axis(label_map, present) if _SHORT_AXIS.search(name) else None
    return short_axis or _unnamed(label_map, present)


def valve(one: str, two: str) -> str | None:
    """Return the name of the valve between two parts, by their names; None where there is none."""
    return _VALVES.get(frozenset((chamber(one), chamber(two))))


def chamber(part: str) -> str:
    """Return the usual short name of a part of the heart; any other name as it is."""
    for short, words in _CHAMBERS:
        if re.fullmatch(words, part, re.IGNORECASE):
            return short
    return part


def touching(label_map: LabelMap, parts: Mapping[str, Labels]) -> list[tuple[str, str, str]]:
    """Return pairs of parts that a valve may join and whose labels touch, with its name."""
    masks = {part: label_mask(label_map, np.atleast_1d(v).tolist()) for part, v in parts.items()}
    found = []
    for one, two in combinations(parts, 2):
        name = valve(one, two)
        if name and bool((ndimage.binary_dilation(masks[one]) & masks[two]).any()):
            found.append((one, two, name))
    return found


def _with_wall(named: Mapping[str, Labels], notes: Sequence[str]) -> LabelParts:
    """Return parts in which the myocardium is one with its cavity, as what EPI encloses."""
    by_chamber = {chamber(part): part for part in named}
    if not {"LV", "MYO"} <= set(by_chamber):
        return LabelParts(named, tuple(notes))
    wall, cavity = by_chamber["MYO"], by_chamber["LV"]
    parts = {part: value for part, value in named.items() if part != wall}
    both = (named[wall], named[cavity])
    parts["EPI"] = both  # type: ignore[assignment]
    said = "EPI is the myocardium with the cavity in it: a wall alone is no surface with openings"
    return LabelParts(parts, (*notes, said))


def _short_axis(label_map: LabelMap, present: Sequence[int]) -> LabelParts | None:
    """Return LV, EPI and RV of a short-axis image, whatever their numbers: the wall is 2."""
    if 2 not in present or len(present) > 3:
        return None
    wall = label_map.labels == 2
    shares = {v: _share_at(label_map.labels == v, wall) for v in present if v != 2}
    cavity = max(shares, key=lambda v: shares[v])
    if shares[cavity] < _ENCLOSED:
        return None
    parts: dict[str, Labels] = {"LV": cavity, "EPI": (2, cavity)}
    for beside in shares.keys() - {cavity}:
        parts["RV"] = beside
    return LabelParts(
        parts,
        (
            f"doubt: label {cavity} was taken for the left ventricle, since label 2 surrounds it; "
            "EPI is both: the wall alone is no surface with openings",
        ),
    )


def _share_at(mask: BoolArray, wall: BoolArray) -> float:
    """Return the share of a label's neighbouring voxels in its slices that are of the wall."""
    cross = ndimage.generate_binary_structure(3, 1)
    axis = int(np.argmin(mask.shape))
    cross[tuple(slice(0, 3, 2) if k == axis else slice(None) for k in range(3))] = False
    around = ndimage.binary_dilation(mask, cross) & ~mask
    return float((around & wall).sum() / max(around.sum(), 1))


def _unnamed(label_map: LabelMap, present: Sequence[int]) -> LabelParts:
    """Return a part for every label; one that encloses others is taken with them."""
    parts: dict[str, Labels] = {}
    notes = []
    for value in present:
        mask = label_map.labels == value
        inside = label_map.labels[ndimage.binary_fill_holes(mask) & ~mask]
        held = [v for v in np.unique(inside).tolist() if v]
        if held and len(inside) > _FILLED * mask.sum():
            parts[f"label{value}"] = (value, *held)
            notes.append(
                f"label {value} encloses {', '.join(map(str, held))}: taken with it, as its wall "
                "alone has two surfaces"
            )
        else:
            parts[f"label{value}"] = value
    return LabelParts(parts, tuple(notes))


def known_labels(
    label_map: LabelMap, name: str, parts: Sequence[str]
) -> dict[str, tuple[int | str, ...]]:
    """Return the labels of some parts in a label map, as far as names or values tell.

    Parameters
    ----------
    label_map : LabelMap
    name : str
        Of its file.
    parts : sequence of str
        A map of one label is the only part.
    """
    values = np.unique(label_map.labels)
    values = values[values != 0]
    if len(parts) == 1 and len(values) == 1 and not label_map.further:
        return {parts[0]: (int(values[0]),)}
    found = label_parts(label_map, name).values
    known: dict[str, tuple[int | str, ...]] = {}
    for part in parts:
        own = next((v for p, v in found.items() if p.casefold() == part.casefold()), None)
        if own is not None:
            known[part] = own if isinstance(own, tuple) else (own,)
    return known
