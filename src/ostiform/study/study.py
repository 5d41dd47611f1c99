"""A study: its settings and the files of its shapes, in order."""

import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from ostiform.errors import InputError
from ostiform.study.settings import StudySettings
from ostiform.study.settings_file import read_settings
from ostiform.study.shape import ShapeId
from ostiform.study.sheet import read_sheet
from ostiform.values import value

_FIELDS = ("subject", "phase", "part")
_DEFAULT_PHASE = "0"
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
    """

    id: ShapeId
    files: Mapping[str, Path]
    covariates: Mapping[str, str]
    notes: tuple[str, ...] = ()
    cuts: tuple[Path, ...] = ()


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
    """

    path: Path
    folder: Path
    settings: StudySettings
    entries: tuple[ShapeEntry, ...]

    @property
    def alignment_per(self) -> Literal["subject", "shape"]:
        """What one alignment transform belongs to: as set, or by the number of phases."""
        if self.settings.alignment.per is not None:
            return self.settings.alignment.per
        phases = Counter(entry.id.subject for entry in self.entries)
        return "subject" if max(phases.values(), default=1) > 1 else "shape"


@dataclass(frozen=True, slots=True)
class _Found:
    subject: str
    phase: str
    time: float | None
    files: Mapping[str, Path]
    covariates: Mapping[str, str]


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
            )
            for row in read_sheet(
                sheet, settings.part_names, settings.shares_files, settings.cycle.length_s
            )
        ]
        if not found:
            raise InputError(f"{sheet}: expected one row per shape, found none")
        _refuse_double(path, ((f"{row.subject}/{row.phase}", "row") for row in found))
    else:
        found = _matched(path, folder, settings)
    _check_shape_keys(path, settings, found)
    return Study(path, folder, settings, _ordered(path, folder, settings, found))


def natural_key(name: str) -> tuple[tuple[tuple[int, int, str], ...], str]:
    """Return the key that sorts names as people do: ``s2`` before ``s10``."""
    steps = tuple(
        (0, int(step), "") if step.isdecimal() else (1, 0, step.casefold())
        for step in re.findall(r"\d+|\D+", name)
    )
    return steps, name


def _matched(path: Path, folder: Path, settings: StudySettings) -> list[_Found]:
    pattern, parts = settings.shapes.pattern or "", settings.part_names
    expression = _expression(path, pattern, parts, settings.shares_files)
    depth = pattern.count("/")
    files = sorted(file for file in folder.glob("*/" * depth + "*") if file.is_file())
    shapes: dict[tuple[str, str], dict[str, list[Path]]] = defaultdict(lambda: defaultdict(list))
    for file in files:
        match = expression.fullmatch(file.relative_to(folder).as_posix())
        if match is None:
            continue
        fields = match.groupdict()
        phase = fields.get("phase", _DEFAULT_PHASE)
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
            (f"{subject}/{phase}", f"file for {part}")
            for (subject, phase), by_part in shapes.items()
            for part, candidates in by_part.items()
            for _ in candidates
        ),
    )
    return [
        _Found(subject, phase, None, {part: c[0] for part, c in by_part.items()}, {})
        for (subject, phase), by_part in shapes.items()
    ]


def _expression(
    path: Path, pattern: str, parts: Sequence[str], shares_files: bool
) -> re.Pattern[str]:
    expression, seen = "", set()
    for piece in re.split(r"(\{[^{}]*\}|\*)", pattern):
        name = piece[1:-1] if piece.startswith("{") else None
        if piece == "*":
            expression += "[^/]*"
        elif name is None:
            expression += re.escape(piece)
        elif name not in _FIELDS:
            raise InputError(
                f"{path.name}: shapes.pattern: expected the fields {{subject}}, {{phase}} and "
                f"{{part}}, found {piece}"
            )
        elif name in seen:
            expression += f"(?P={name})"
        else:
            one_of = "|".join(re.escape(part) for part in sorted(parts, key=len, reverse=True))
            expression += f"(?P<{name}>{one_of})" if name == "part" else f"(?P<{name}>[^/]+)"
            seen.add(name)
    if "part" not in seen and len(parts) > 1 and not shares_files:
        raise InputError(
            f'{path.name}: shapes.pattern: expected the field {{part}}, found "{pattern}"'
        )
    return re.compile(expression)


def _refuse_double(path: Path, items: Iterable[tuple[str, str]]) -> None:
    for (shape, what), count in Counter(items).items():
        if count > 1:
            raise InputError(
                f"{path.name}: shape {shape}: expected one {what}, found {count}: remove or rename "
                "the others"
            )


def _check_shape_keys(path: Path, settings: StudySettings, found: Sequence[_Found]) -> None:
    known = {f"{item.subject}/{item.phase}" for item in found} | {item.subject for item in found}
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
    phases = {item.phase for item in found}
    if settings.shapes.times and (missing := sorted(phases - set(settings.shapes.times))):
        raise InputError(
            f"{path.name}: shapes.times: expected a time for every phase, found none for "
            f"{', '.join(missing)}"
        )


def _ordered(
    path: Path, folder: Path, settings: StudySettings, found: Sequence[_Found]
) -> tuple[ShapeEntry, ...]:
    stated = [item for item in found if item.time is not None]
    if stated and len(stated) < len(found):
        absent = next(item for item in found if item.time is None)
        raise InputError(
            f"{path.name}: shape {absent.subject}/{absent.phase}: expected a time in the sheet for "
            "every shape or for none, found none for this one"
        )
    by_subject: dict[str, list[_Found]] = defaultdict(list)
    for item in found:
        by_subject[item.subject].append(item)
    entries = []
    for subject in sorted(by_subject, key=natural_key):
        cycle = sorted(by_subject[subject], key=lambda item: natural_key(item.phase))
        missing = _missing_phases(by_subject, subject)
        order = sorted([*(item.phase for item in cycle), *missing], key=natural_key)
        notes: tuple[str, ...] = ()
        if missing and not stated and not settings.shapes.times:
            notes = (
                f"subject {subject} lacks the phase{'s' * (len(missing) > 1)} "
                f"{', '.join(missing)} that others have: its times leave room for "
                f"{'them' if len(missing) > 1 else 'it'}",
            )
        for item in cycle:
            time = item.time
            if time is None:
                rank = order.index(item.phase)
                time = settings.shapes.times.get(item.phase, rank / len(order))
            files = {part: item.files[part] for part in settings.parts if part in item.files}
            shape = ShapeId(subject, item.phase, time)
            cuts = _cuts_files(path, folder, settings, item)
            entries.append(ShapeEntry(shape, files, item.covariates, notes, cuts))
    return tuple(entries)


def _cuts_files(
    path: Path, folder: Path, settings: StudySettings, item: _Found
) -> tuple[Path, ...]:
    if settings.cuts.markups is None:
        return ()
    name = settings.cuts.markups.replace("{subject}", item.subject).replace("{phase}", item.phase)
    name = name.replace("{ostium}", "*")
    if "{" in name:
        raise InputError(
            f"{path.name}: cuts.markups: expected the fields {{subject}}, {{phase}} and "
            f'{{ostium}}, found "{settings.cuts.markups}"'
        )
    if "*" not in name:
        return (folder / name,)
    found = tuple(sorted(folder.glob(name)))
    if not found:
        raise InputError(
            f'{path.name}: cuts.markups: expected files "{name}" of {item.subject} in {folder}, '
            "found none"
        )
    return found


def _missing_phases(by_subject: Mapping[str, Sequence[_Found]], subject: str) -> list[str]:
    """Return the phases between a subject's own first and last that another subject has.

    Only where that subject has all of this one's: cycles of another number of phases have their
    own names.
    """
    own = {item.phase for item in by_subject[subject]}
    first, last = min(own, key=natural_key), max(own, key=natural_key)
    missing: set[str] = set()
    for other, items in by_subject.items():
        theirs = {item.phase for item in items}
        if other != subject and own < theirs:
            missing |= {
                phase
                for phase in theirs - own
                if natural_key(first) < natural_key(phase) < natural_key(last)
            }
    return sorted(missing, key=natural_key)
