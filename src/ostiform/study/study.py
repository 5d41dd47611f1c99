"""A study: its settings and the files of its shapes, in order."""

import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from glob import escape
from pathlib import Path
from typing import Literal

from ostiform.errors import InputError
from ostiform.study.cycles import common_cycles, missing_phases, natural_key
from ostiform.study.frames import Frames, places_in_cycle
from ostiform.study.labelmaps import is_label_map, read_frames
from ostiform.study.name_fields import files_as_deep, filled_name, name_expression
from ostiform.study.settings import StudySettings
from ostiform.study.settings_file import read_settings
from ostiform.study.shape import NO_PHASE, ShapeId
from ostiform.study.sheet import read_sheet
from ostiform.values import value

_FIELDS = ("subject", "phase", "part")
_ONLY_SUBJECT = "1"


@value(eq=True)
class ShapeEntry:
    """Where one shape comes from.

    Attributes
    ----------
    id : ShapeId
    files : mapping of str to Path
        The file of each part; a part whose file is missing is left out (the shape then fails
        when it is read).
    covariates : mapping of str to str
        Further columns of the sheet.
    notes : tuple of str
        What was concluded about it, one sentence each.
    cuts : tuple of Path
        Its 3D Slicer Markups files.
    frame : int or None
        Which frame of its files it is, where these hold several.
    reflect : bool
        Whether it is mirrored on reading.
    """

    id: ShapeId
    files: Mapping[str, Path]
    covariates: Mapping[str, str]
    notes: tuple[str, ...] = ()
    cuts: tuple[Path, ...] = ()
    frame: int | None = None
    reflect: bool = False


@dataclass(frozen=True, slots=True)
class Study:
    """A population of shapes as its study file describes it.

    Attributes
    ----------
    path : Path
        The study file.
    folder : Path
        Where the files of the shapes are.
    settings : StudySettings
    entries : tuple of ShapeEntry
        Subjects in natural order, and the phases of each in natural order.
    excluded : tuple of ShapeId
        Shapes that the sheet leaves out.
    """

    path: Path
    folder: Path
    settings: StudySettings
    entries: tuple[ShapeEntry, ...]
    excluded: tuple[ShapeId, ...] = ()

    @property
    def alignment_per(self) -> Literal["subject", "shape"]:
        """What one alignment transform belongs to: as set, or by the number of phases."""
        if self.settings.alignment.per is not None:
            return self.settings.alignment.per
        phases = Counter(entry.id.subject for entry in self.entries)
        return "subject" if max(phases.values(), default=1) > 1 else "shape"


@dataclass(frozen=True, slots=True)
class _Found:
    """A shape as the pattern or the sheet has it; of frames, with their own time."""

    subject: str
    phase: str | None
    time: float | None
    files: Mapping[str, Path]
    covariates: Mapping[str, str]
    cycle_s: float | None
    excluded: bool = False
    reflect: bool = False
    frame: int | None = None
    frame_time: float | None = None

    @property
    def names(self) -> tuple[str, str]:
        return self.subject, self.phase or NO_PHASE

    @property
    def label(self) -> str:
        return str(ShapeId(*self.names, 0.0))


def read_study(path: Path) -> Study:
    """Read a study file and find the files of its shapes; no surface is read.

    Raises
    ------
    InputError
        If the study file is wrong (see `read_settings`), no file matches, or a shape is given
        twice.
    """
    return study_of(path, read_settings(path))


def study_of(path: Path, settings: StudySettings) -> Study:
    """Find the files of the shapes of a study whose file would be at a path.

    Raises
    ------
    InputError
        As `read_study`.
    """
    folder = path.parent / settings.shapes.folder
    if not folder.is_dir():
        raise InputError(f"{path.name}: shapes.folder: expected a folder, found none at {folder}")
    if settings.shapes.sheet is not None:
        sheet = path.parent / settings.shapes.sheet
        found = [
            _Found(
                row.subject,
                row.phase,
                row.time,
                {part: folder / name for part, name in row.files.items()},
                row.covariates,
                row.cycle_s,
                row.excluded,
                row.reflect,
            )
            for row in read_sheet(
                sheet, settings.part_names, settings.shares_files, settings.cycle.length_s
            )
        ]
        if not found:
            raise InputError(f"{sheet}: expected one row per shape, found none")
        _refuse_double(path, ((row.label, "row") for row in found))
    else:
        found = _matched(path, folder, settings)
    found = _with_frames(_with_reflected(path, settings, found))
    _check_shape_keys(path, settings, found)
    entries = _ordered(path, folder, settings, found)
    out = {item.names for item in found if item.excluded}
    kept = tuple(e for e in entries if (e.id.subject, e.id.phase) not in out)
    if not kept:
        raise InputError(f"{path.name}: expected shapes, found all {len(entries)} excluded")
    excluded = tuple(e.id for e in entries if (e.id.subject, e.id.phase) in out)
    return Study(path, folder, settings, kept, excluded)


def _with_reflected(
    path: Path, settings: StudySettings, found: Sequence[_Found]
) -> Sequence[_Found]:
    """Return the shapes with those marked whose subjects the study reflects."""
    stated = settings.shapes.reflect
    for pattern in (stated,) if isinstance(stated, str) else stated:
        named = [fnmatchcase(item.subject, pattern) for item in found]
        if not any(named):
            raise InputError(
                f'{path.name}: shapes.reflect: expected subjects, found none named "{pattern}"'
            )
        found = [
            replace(item, reflect=own or item.reflect)
            for item, own in zip(found, named, strict=True)
        ]
    return found


def _with_frames(found: Sequence[_Found]) -> list[_Found]:
    """Return the shapes with those whose files hold several frames divided, a phase for each."""
    divided: list[_Found] = []
    for item in found:
        frames = None if item.phase else _common_frames(item)
        if frames is None:
            divided.append(item)
            continue
        if item.time is not None:
            raise InputError(
                f"{item.label}: expected no time for a file of {len(frames.times)} frames, which "
                f"has its own, found {item.time:g}: leave it empty"
            )
        try:
            numbers, times = places_in_cycle(frames, item.cycle_s)
        except InputError as error:
            raise InputError(f"{item.label}: {error}") from None
        divided += [
            replace(item, phase=str(number), frame=k, frame_time=float(time))
            for k, (number, time) in enumerate(zip(numbers.tolist(), times, strict=True))
        ]
    framed = [len(item.phase or "") for item in divided if item.frame is not None]
    digits = max(2, *framed) if framed else 0
    return [
        item if item.frame is None else replace(item, phase=(item.phase or "").zfill(digits))
        for item in divided
    ]


def _common_frames(item: _Found) -> Frames | None:
    paths = dict.fromkeys(path for path in item.files.values() if is_label_map(path))
    seen = {path: read_frames(path) for path in paths}
    counts = {path: 1 if own is None else len(own.times) for path, own in seen.items()}
    if len(set(counts.values())) > 1:
        listed = ", ".join(f"{count} in {path.name}" for path, count in counts.items())
        raise InputError(
            f"{item.label}: expected as many frames in every file, found {listed}: save the frames "
            "that belong together"
        )
    return next(iter(seen.values()), None)


def _matched(path: Path, folder: Path, settings: StudySettings) -> list[_Found]:
    pattern, parts = settings.shapes.pattern or "", settings.part_names
    expression = _expression(path, pattern, parts, settings.shares_files)
    files = files_as_deep(folder, pattern)
    shapes: dict[tuple[str, str | None], dict[str, list[Path]]] = defaultdict(
        lambda: defaultdict(list)
    )
    for file in files:
        match = expression.fullmatch(file.relative_to(folder).as_posix())
        if match is None:
            continue
        fields = match.groupdict()
        phase = fields.get("phase")
        named = (fields["part"],) if "part" in fields else parts
        for part in named:
            shapes[fields.get("subject", _ONLY_SUBJECT), phase][part].append(file)
    if not shapes:
        examples = ", ".join(file.relative_to(folder).as_posix() for file in files[:3])
        raise InputError(
            f'{path.name}: shapes.pattern: expected files matching "{pattern}" in {folder}, found '
            f"none among {len(files)} files{f' such as {examples}' if examples else ''}"
        )
    _refuse_double(
        path,
        (
            (str(ShapeId(subject, phase or NO_PHASE, 0.0)), f"file for {part}")
            for (subject, phase), by_part in shapes.items()
            for part, candidates in by_part.items()
            for _ in candidates
        ),
    )
    length = settings.cycle.length_s
    return [
        _Found(
            subject,
            phase,
            None,
            {part: c[0] for part, c in by_part.items()},
            {},
            length,
        )
        for (subject, phase), by_part in shapes.items()
    ]


def _expression(
    path: Path, pattern: str, parts: Sequence[str], shares_files: bool
) -> re.Pattern[str]:
    seen: set[str] = set()

    def of_field(name: str) -> str:
        if name not in _FIELDS:
            raise InputError(
                f"{path.name}: shapes.pattern: expected the fields {{subject}}, {{phase}} and "
                f"{{part}} ({{{{ for a brace), found {{{name}}}"
            )
        if name in seen:
            return f"(?P={name})"
        seen.add(name)
        one_of = "|".join(re.escape(part) for part in sorted(parts, key=len, reverse=True))
        return f"(?P<{name}>{one_of})" if name == "part" else f"(?P<{name}>[^/]+)"

    expression = name_expression(pattern, of_field)
    if "part" not in seen and len(parts) > 1 and not shares_files:
        raise InputError(
            f'{path.name}: shapes.pattern: expected the field {{part}}, found "{pattern}"'
        )
    return expression


def _refuse_double(path: Path, items: Iterable[tuple[str, str]]) -> None:
    for (shape, what), count in Counter(items).items():
        if count > 1:
            raise InputError(
                f"{path.name}: shape {shape}: expected one {what}, found {count}: remove or rename "
                "the others"
            )


def _check_shape_keys(path: Path, settings: StudySettings, found: Sequence[_Found]) -> None:
    known = {item.label for item in found} | {item.subject for item in found}
    keys = [("ostia", key) for key in settings.ostia.shapes]
    keys += [("cuts", key) for key in settings.cuts.shapes]
    for table, key in keys:
        if key not in known:
            raise InputError(
                f'{path.name}: {table}.shapes."{key}": expected a shape "SUBJECT/PHASE" or a '
                "subject of the study, found another name"
            )
    subjects, stated = {item.subject for item in found}, settings.cycle.landmarks
    if stated and (odd := sorted(subjects.symmetric_difference(stated))):
        raise InputError(
            f"{path.name}: cycle.landmarks: expected events for every subject of the study and for "
            f"no other, found it otherwise for {', '.join(odd)}"
        )
    phases = {item.names[1] for item in found}
    if settings.shapes.times and (missing := sorted(phases - set(settings.shapes.times))):
        raise InputError(
            f"{path.name}: shapes.times: expected a time for every phase, found none for "
            f"{', '.join(phase or 'shapes without a phase' for phase in missing)}"
        )


def _ordered(
    path: Path, folder: Path, settings: StudySettings, found: Sequence[_Found]
) -> tuple[ShapeEntry, ...]:
    stated = [item for item in found if item.time is not None]
    if stated and len(stated) < len(found):
        absent = next(item for item in found if item.time is None)
        raise InputError(
            f"{path.name}: shape {absent.label}: expected a time in the sheet for every shape or "
            "for none, found none for this one"
        )
    times = settings.shapes.times
    cycles = common_cycles(item.names for item in found)
    by_subject: dict[str, list[_Found]] = defaultdict(list)
    for item in found:
        by_subject[item.subject].append(item)
    entries = []
    for subject in sorted(by_subject, key=natural_key):
        if len({item.names[1] == NO_PHASE for item in by_subject[subject]}) > 1:
            raise InputError(
                f"{path.name}: subject {subject}: expected a phase for all of its shapes or for "
                "none, found both"
            )
        own = sorted(by_subject[subject], key=lambda item: natural_key(item.names[1]))
        phases = {item.names[1] for item in own}
        missing = missing_phases(cycles, subject, phases, own[0].frame is not None)
        notes = (missing,) if missing and not stated and not times else ()
        for item in own:
            phase, cycle = item.names[1], cycles[subject]
            told = (item.time, times.get(phase), item.frame_time, cycle.index(phase) / len(cycle))
            entries.append(
                ShapeEntry(
                    ShapeId(subject, phase, next(time for time in told if time is not None)),
                    {part: item.files[part] for part in settings.parts if part in item.files},
                    item.covariates,
                    notes,
                    _cuts_files(path, folder, settings, item),
                    item.frame,
                    item.reflect,
                )
            )
    return tuple(entries)


def _cuts_files(
    path: Path, folder: Path, settings: StudySettings, item: _Found
) -> tuple[Path, ...]:
    if settings.cuts.markups is None:
        return ()
    subject, phase = item.names
    values = {"subject": subject, "phase": phase}
    if "{ostium}" in settings.cuts.markups:
        values = {key: escape(value) for key, value in values.items()} | {"ostium": "*"}
    name = filled_name(settings.cuts.markups, values)
    if name is None:
        raise InputError(
            f"{path.name}: cuts.markups: expected the fields {{subject}}, {{phase}} and "
            f'{{ostium}}, found "{settings.cuts.markups}"'
        )
    if "*" not in settings.cuts.markups and "ostium" not in values:
        return (folder / name,)
    found = tuple(sorted(folder.glob(name)))
    if not found:
        raise InputError(
            f'{path.name}: cuts.markups: expected files "{name}" of {item.subject} in {folder}, '
            "found none"
        )
    return found
