"""The phases of a sequence from files: a sheet, guide points, images with an axis of time."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ostiform.errors import InputError
from ostiform.fitting.files import FileRules, read_targets
from ostiform.fitting.guide_points import (
    guide_contours,
    is_guide_point_file,
    read_guide_points,
)
from ostiform.fitting.label_contours import label_outlines
from ostiform.fitting.sequence_planes import sliced, with_slices_named
from ostiform.fitting.sequence_types import PhaseItem, PhaseTarget
from ostiform.model import ModelMesh
from ostiform.study import (
    is_label_map,
    known_labels,
    label_mask,
    natural_key,
    places_in_cycle,
    read_frames,
    read_label_map,
    read_sheet,
)

SHEETS = (".csv", ".xlsx")
_SHEET_COLUMNS = ("part", "slice", "labels")
_TRAILING = re.compile(r"(\d+)(?!.*\d)")
FEWEST_SHARE = 0.6
"""Frames of which fewer than this share is there do not tell how many a cycle has."""


@dataclass(frozen=True, slots=True)
class SequenceRules:
    """How to read the files of a sequence.

    Attributes
    ----------
    files : FileRules
    labels : mapping of str to tuple of int or str
        Values or segment names of the model's parts in label maps; default by known names and
        values.
    frames_per_cycle : int or None
        How many frames a whole cycle has, where files number them; default the highest plus one.
    """

    files: FileRules = FileRules()
    labels: Mapping[str, tuple[int | str, ...]] = field(default_factory=dict)
    frames_per_cycle: int | None = None


@dataclass(frozen=True, slots=True)
class SequenceFiles:
    """Phases that were read, and what there is to say about the files."""

    phases: tuple[PhaseTarget, ...]
    notes: tuple[str, ...]


@dataclass(slots=True)
class _Reading:
    """What has been read so far: items by phase, where phases are numbered or timed."""

    items: dict[str, list[PhaseItem]] = field(default_factory=dict)
    times: dict[str, float] = field(default_factory=dict)
    numbers: dict[str, int] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def add(self, name: str, items: Sequence[PhaseItem]) -> None:
        self.items.setdefault(name, []).extend(items)


def read_sequence(
    sources: Sequence[Path], mesh: ModelMesh, rules: SequenceRules | None = None
) -> SequenceFiles:
    """Read the phases of one shape.

    Parameters
    ----------
    sources : sequence of Path
        A sheet (CSV or XLSX: ``subject``, ``time`` or ``time_s``, ``phase``, optionally ``part``,
        ``slice`` and ``labels``; every other column names a view and holds its file), files of
        guide points, label maps of four axes; several of the latter two are views of one shape.
    mesh : ModelMesh
        Of the model: parts and openings.
    rules : SequenceRules, optional

    Raises
    ------
    InputError
        If a file is missing, damaged or of another kind, phases have no times, or there are several
        subjects.
    """
    chosen = SequenceRules() if rules is None else rules
    reading = _Reading()
    guides = []
    for path in sources:
        if not path.is_file():
            raise InputError(f"{path}: expected a file of a sequence, found none: check the path")
        if is_guide_point_file(path):
            guides.append(path)
        elif path.suffix.lower() in SHEETS:
            _add_sheet(reading, path, mesh, chosen)
        elif is_label_map(path):
            _add_images(reading, path, mesh, chosen)
        else:
            raise InputError(
                f"{path}: expected a sheet ({', '.join(SHEETS)}), guide points (text with the "
                "columns x, y, z and contour type) or a label map with frames, found another file"
            )
    _add_guides(reading, guides, mesh, chosen)
    return SequenceFiles(with_slices_named(_phases(reading, chosen)), tuple(reading.notes))


def _phases(reading: _Reading, rules: SequenceRules) -> list[PhaseTarget]:
    if not reading.items:
        raise InputError("a sequence: expected data of at least one phase, found none")
    names = sorted(reading.items, key=natural_key)
    times = dict(reading.times)
    if reading.numbers:
        total = _frames_per_cycle(list(reading.numbers.values()), rules)
        times.update({name: number / total for name, number in reading.numbers.items()})
    unknown = [name for name in names if name not in times]
    if unknown and times:
        raise InputError(
            f"phase {unknown[0]}: expected a time as the other phases have, found none"
        )
    if unknown:
        times = {name: k / len(names) for k, name in enumerate(names)}
        reading.notes.append(
            f"no times are given: the {len(names)} phases are taken as evenly spread over a cycle"
        )
    return [PhaseTarget(times[name], tuple(reading.items[name]), name) for name in names]


def _frames_per_cycle(numbers: Sequence[int], rules: SequenceRules) -> int:
    last = max(numbers)
    if rules.frames_per_cycle is not None:
        if last >= rules.frames_per_cycle:
            raise InputError(
                f"frames of a cycle: expected numbers below the stated {rules.frames_per_cycle}, "
                f"found {last}"
            )
        return rules.frames_per_cycle
    if len(set(numbers)) < FEWEST_SHARE * (last + 1):
        raise InputError(
            f"frames of a cycle: expected most of the frames 0 to {last}, found "
            f"{len(set(numbers))}: say how many a whole cycle has (--frames-per-cycle)"
        )
    return last + 1


def _add_sheet(reading: _Reading, path: Path, mesh: ModelMesh, rules: SequenceRules) -> None:
    rows = [row for row in read_sheet(path, ()) if not row.excluded]
    subjects = list(dict.fromkeys(row.subject for row in rows))
    if len(subjects) > 1:
        raise InputError(
            f"{path}: expected the phases of one subject, found {len(subjects)} "
            f"({', '.join(subjects[:5])}): fit each by itself"
        )
    for number, row in enumerate(rows, start=1):
        stated = {key: row.covariates.get(key) or None for key in _SHEET_COLUMNS}
        views = {
            view: cell
            for view, cell in row.covariates.items()
            if view not in (*_SHEET_COLUMNS, "cycle_s", "heart_rate_bpm") and cell
        }
        if not views:
            continue
        if row.phase is not None:
            name = row.phase
        else:
            name = f"{row.time:.4f}" if row.time is not None else f"{number:03d}"
        if row.time is not None:
            earlier = reading.times.setdefault(name, row.time)
            if earlier != row.time:
                raise InputError(
                    f"{path}: expected one time for phase {name}, found {earlier:g} and "
                    f"{row.time:g}"
                )
        for view, cell in views.items():
            file = (path.parent / cell).resolve()
            part = stated["part"]
            if is_label_map(file):
                own = replace(rules, labels=_labels(stated["labels"], part) or rules.labels)
                if read_frames(file) is not None and row.time is None and row.phase is None:
                    _add_images(reading, file, mesh, own, view)
                else:
                    reading.add(name, _outlines(file, None, mesh, own, stated["slice"] or view))
                continue
            target = f"{part}={file}" if part else str(file)
            found = read_targets([target], mesh.parts, rules.files)
            for item in found:
                reading.add(name, sliced(item, view, stated["slice"]))


def _labels(cell: str | None, part: str | None) -> dict[str, tuple[int | str, ...]]:
    """Return ``LV=3 LA=2`` or, of a stated part, ``3`` or ``1+2``, as labels by part."""
    if not cell:
        return {}
    found: dict[str, tuple[int | str, ...]] = {}
    for word in re.split(r"[\s;,]+", cell.strip()):
        name, equals, values = word.partition("=")
        if not equals and part is None:
            raise InputError(
                f'labels: expected PART=VALUE or a part in the column part, found "{word}"'
            )
        own = values if equals else name
        key = name if equals else str(part)
        found[key] = tuple(int(v) if v.lstrip("-").isdigit() else v for v in own.split("+"))
    return found


def parsed_labels(words: Sequence[str]) -> dict[str, tuple[int | str, ...]]:
    """Return labels by part from ``PART=VALUE[+VALUE]``, values or names of segments.

    Raises
    ------
    InputError
        If a word is not of that form.
    """
    return _labels(" ".join(words), None)


def _add_images(
    reading: _Reading, path: Path, mesh: ModelMesh, rules: SequenceRules, view: str | None = None
) -> None:
    frames = read_frames(path)
    if frames is None:
        raise InputError(
            f"{path}: expected a label map with an axis of time, found one phase: list it in a "
            "sheet with its time"
        )
    numbers, places = places_in_cycle(frames, None)
    for index, (number, place) in enumerate(zip(numbers, places, strict=True)):
        name = f"{int(number):03d}"
        earlier = reading.times.setdefault(name, float(place))
        if abs(earlier - float(place)) > 1e-6:
            raise InputError(
                f"{path}: expected the times of the other images, found {float(place):.4f} for "
                f"frame {name} instead of {earlier:.4f}: give times in a sheet"
            )
        found = _outlines(path, index, mesh, rules, view or _stem(path))
        if found:
            reading.add(name, found)
    for name in [name for name in reading.times if name not in reading.items]:
        del reading.times[name]


def _outlines(
    path: Path, frame: int | None, mesh: ModelMesh, rules: SequenceRules, view: str
) -> list[PhaseItem]:
    """Return the outlines of the model's parts in a label map."""
    label_map = read_label_map(path, frame)
    values = {part: own for part, own in rules.labels.items()}
    if not values:
        values = known_labels(label_map, path.name, mesh.parts)
    unknown = [part for part in values if part not in mesh.parts]
    if unknown:
        raise InputError(
            f"{path}: expected labels for parts among {', '.join(mesh.parts)}, found one for "
            f"{unknown[0]}"
        )
    if not values:
        raise InputError(
            f"{path}: expected labels of {', '.join(mesh.parts)}, found none of a known name or "
            "value: say which they are (--labels PART=VALUE)"
        )
    found: list[PhaseItem] = []
    for part, own in values.items():
        try:
            mask = label_mask(label_map, own)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
        found += label_outlines(mask, label_map.affine, view, part)
    return found


def _add_guides(
    reading: _Reading, paths: Sequence[Path], mesh: ModelMesh, rules: SequenceRules
) -> None:
    if not paths:
        return
    files = {path: read_guide_points(path) for path in paths}
    own = [set(found.frames.tolist()) for found in files.values()]
    by_name = len(paths) > 1 and len(set.union(*own)) < sum(map(len, own))
    unknown: dict[str, None] = {}
    for path, found in files.items():
        numbered = _TRAILING.search(path.stem)
        if by_name and (numbered is None or len(set(found.frames.tolist())) > 1):
            raise InputError(
                f"{path}: expected a time frame of its own, or a number at the end of its name, "
                "found neither: number the files of a sequence"
            )
        for frame in np.unique(found.frames):
            number = int(numbered[1]) if by_name and numbered else int(frame)
            chosen = np.flatnonzero(found.frames == frame)
            contours, unlike = guide_contours(found, chosen, mesh.parts, tuple(mesh.loops))
            unknown.update(dict.fromkeys(unlike))
            if contours:
                name = f"{number:03d}"
                reading.numbers[name] = number
                reading.add(name, contours)
    if unknown:
        reading.notes.append(
            f"the model ({', '.join(mesh.parts)}) has nothing for the guide points of type "
            f"{', '.join(sorted(unknown))}: they are left out"
        )
    if not reading.items:
        raise InputError(
            f"{paths[0]}: expected guide points of {', '.join(mesh.parts)}, found only types of "
            f"other structures ({', '.join(sorted(unknown))})"
        )


def _stem(path: Path) -> str:
    return path.name.partition(".")[0]
