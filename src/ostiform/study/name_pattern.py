"""Guessing from file names which of their pieces are subject, phase and part."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

_PARTS = re.compile(
    r"(lv|la|rv|ra|ao|aorta|lvot|pa|laa|left|right|endo\w*|epi\w*|atri\w+|ventric\w+|myo\w*)",
    re.IGNORECASE,
)
_CHAMBER = re.compile(r"lv|la|rv|ra|ao|aorta|lvot|pa|laa", re.IGNORECASE)
_PHASE = re.compile(r"(ph|phase|t|time|frame|f|es|ed|sys\w*|dia\w*)?[-]?\d*%?", re.IGNORECASE)
_SUBJECT = re.compile(
    r"(p|pat|patient|s|sub|subj|subject|case|id|vol|volunteer|heart)[-]?\d+", re.IGNORECASE
)
_MOST_PARTS = 8


@dataclass(frozen=True, slots=True)
class NamePattern:
    """A pattern of file names with the fields {subject}, {phase} and {part}.

    Attributes
    ----------
    pattern : str
    parts : tuple of str
        The values of {part}; where the pattern has none, the one part that the names tell of.
    """

    pattern: str
    parts: tuple[str, ...]


def guessed_pattern(names: Sequence[str]) -> NamePattern:
    """Return the likely pattern of file names that share an ending.

    Names are taken apart at ``_``, ``-``, blanks, dots and ``/``. A piece of few values, known as
    names of parts and each used equally often, is the part; a numbered piece that comes back with
    every subject is the phase; what else differs is the subject.

    Parameters
    ----------
    names : sequence of str
        Relative to the folder of the shapes, with ``/``.
    """
    ending = _ending(names[0])
    rows = [re.split(r"([_\-\s./])", name.removesuffix(ending)) for name in names]
    if len({len(row) for row in rows}) != 1 or len({tuple(row[1::2]) for row in rows}) != 1:
        depth = names[0].count("/")
        return NamePattern("*/" * depth + "{subject}" + ending, ())
    columns = list(zip(*rows, strict=True))
    varying = [k for k in range(0, len(columns), 2) if len(set(columns[k])) > 1]
    part = _part_column(columns, varying)
    left = [k for k in varying if k != part]
    phase = _phase_column(columns, left)
    subjects = [k for k in left if k != phase]
    if not subjects:
        known = [k for k in range(0, len(columns), 2) if _SUBJECT.fullmatch(columns[k][0])]
        subjects = known[:1]
        if not subjects and phase is not None:
            subjects, phase = [phase], None
        if not subjects and part is None:
            return NamePattern("*/" * names[0].count("/") + "{subject}" + ending, _only(columns))
    roles: dict[int, str] = {}
    if part is not None:
        roles[part] = "{part}"
    if phase is not None:
        roles[phase] = "{phase}"
    if subjects:
        # Pieces from the first to the last that differ are one name.
        roles.update(dict.fromkeys(range(subjects[0], subjects[-1] + 1), ""))
        inside = [k for k in (part, phase) if k is not None and subjects[0] < k < subjects[-1]]
        if inside:
            roles.update(dict.fromkeys(range(subjects[0] + 1, subjects[-1] + 1), "*"))
            roles.update({k: "{part}" if k == part else "{phase}" for k in inside})
            roles.update({k: columns[k][0] for k in range(subjects[0] + 1, subjects[-1], 2)})
        roles[subjects[0]] = "{subject}"
    pieces = [roles.get(k, column[0]) for k, column in enumerate(columns)]
    values = tuple(dict.fromkeys(columns[part])) if part is not None else _only(columns)
    return NamePattern("".join(pieces) + ending, values)


def _only(columns: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """Return the part that all names tell of, if there is one."""
    pieces = [column[0] for column in columns if len(set(column)) == 1]
    return tuple(piece for piece in pieces if _CHAMBER.fullmatch(piece))[:1]


def _ending(name: str) -> str:
    for double in (".nii.gz", ".seg.nrrd"):
        if name.lower().endswith(double):
            return name[-len(double) :]
    return name[name.rfind(".") :]


def _part_column(columns: Sequence[Sequence[str]], varying: Sequence[int]) -> int | None:
    for k in varying:
        counts = Counter(columns[k])
        if len(counts) > _MOST_PARTS or len(set(counts.values())) > 1:
            continue
        if all(_PARTS.fullmatch(value) for value in counts):
            return k
    return None


def _phase_column(columns: Sequence[Sequence[str]], varying: Sequence[int]) -> int | None:
    """Return the last numbered column whose values come back with other names, if any."""
    for k in reversed(varying):
        if not all(_PHASE.fullmatch(value) for value in columns[k]):
            continue
        others = [j for j in varying if j != k]
        if not others:
            return k
        names = set(zip(*(columns[j] for j in others), strict=True))
        if len(names) < len(columns[k]):
            return k
    return None
