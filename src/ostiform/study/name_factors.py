"""Taking file names apart: which of their pieces vary, and with what.

Names are cut at ``_``, ``-``, blanks, dots and ``/``. At most two runs of pieces are *fields*; what
is left of a name is its *frame*. A set of names is described best by the fields and frames whose
numbers of values have the least sum, missing combinations counting half: 3 subjects x 4 phases x
2 parts take 9 values, the same 24 files as subjects take 24.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

Span = tuple[int, int, int]
"""Component of the path, first piece and end of a run of pieces."""

_Row = list[list[str]]
_Run = tuple[tuple[Span, ...], tuple[str, ...]]

_SEPARATORS = re.compile(r"([_\-\s.]+)")
_SEPARATORS_AND_DIGITS = re.compile(r"([_\-\s.]+|(?<=[A-Za-z])(?=\d)|(?<=\d)(?=[A-Za-z]))")
_NUMBERED = re.compile(r"\W*[^\W\d_]*\d+[^\W\d_]?\W*|[A-KM-QS-Za-km-qs-z]")
PHASE_WORDS = re.compile(
    r"(ph|phase|t|tp|time|timepoint|frame|fr|step|ses|session|visit)-?\d+%?|\d+%|e[ds]|"
    r"end(dia|sys)\w*|sys\w*|dia\w*|rest|stress|insp\w*|exp(iration)?",
    re.IGNORECASE,
)
_MOST_PIECES = 8
_LONGEST_RUN = 3
_HOLE = 0.5
"""What a missing combination costs, in values."""
_SECOND = 1.5
_SECOND_WITH_WORDS = 0.5
"""What a second field saves, in values, as phases are looked for: beside numbers, beside words."""
_MOST_OWN_PHASES = 3
"""Phases with names of their own in every subject are recognised up to so many."""


@dataclass(frozen=True, slots=True)
class NameFactors:
    """Names as fields and frames.

    Attributes
    ----------
    frames : tuple of str
        Of every name: what is left of it, ``{0}`` and ``{1}`` in place of the fields, ``*`` in
        place of what a field says already.
    fields : tuple of tuple of str
        Values of each field, of every name; in the order in which they stand in the names.
    before : tuple of str
        The piece before each field, where it is the same in all names; else empty.
    """

    frames: tuple[str, ...]
    fields: tuple[tuple[str, ...], ...]
    before: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Slot:
    """A run of pieces that all names have."""

    spans: tuple[Span, ...]
    values: tuple[str, ...]
    codes: tuple[int, ...]

    @property
    def is_single(self) -> bool:
        return all(end - start == 1 for _, start, end in self.spans)


@dataclass(frozen=True, slots=True)
class _Found:
    cost: float
    factors: NameFactors


def name_factors(stems: Sequence[str], words: bool) -> NameFactors:
    """Take names apart into fields and frames.

    Parameters
    ----------
    stems : sequence of str
        Without their ending, with ``/`` between folders; all equally deep.
    words : bool
        Whether words without numbers may be a field beside numbers.
    """
    plain = _best(stems, _SEPARATORS, words)
    fine = _best(stems, _SEPARATORS_AND_DIGITS, words)
    return (fine if fine.cost < plain.cost else plain).factors


def _best(stems: Sequence[str], separators: re.Pattern[str], words: bool) -> _Found:
    rows = [[separators.split(component) for component in stem.split("/")] for stem in stems]
    runs = _runs(rows)
    slots = _slots(rows, runs)
    numbered = [slot for slot in slots if _is_numbered(slot)]
    seconds = [
        slot
        for slot in slots
        if slot.is_single
        and all(_NUMBERED.fullmatch(v) or PHASE_WORDS.fullmatch(v) for v in slot.values)
    ]
    best = _Found(len(stems) + 2.0, NameFactors(tuple(stems), (), ()))
    for one, two in product(slots, [None, *seconds]):
        if one not in numbered and numbered and (two is None or not words):
            continue
        if two is not None and (one.codes == two.codes or _overlap(one, two)):
            continue
        saved = 0.0 if two is None else _SECOND if one in numbered else _SECOND_WITH_WORDS
        found = _found(rows, runs, slots, one, two, saved)
        if found.cost < best.cost:
            best = found
    return best


def _slots(rows: Sequence[_Row], runs: Sequence[_Run]) -> list[_Slot]:
    """Return the runs of pieces that vary, one for every way to divide the names."""
    chosen: dict[tuple[int, ...], _Slot] = {}
    for spans, values in runs:
        firsts = {row[c][2 * a] for row, (c, a, _) in zip(rows, spans, strict=True)}
        lasts = {row[c][2 * b - 2] for row, (c, _, b) in zip(rows, spans, strict=True)}
        if len(firsts) == 1 or len(lasts) == 1:
            continue
        order: dict[str, int] = {}
        codes = tuple(order.setdefault(value.casefold(), len(order)) for value in values)
        known = chosen.get(codes)
        longer = known is not None and sum(map(len, values)) > sum(map(len, known.values))
        if known is None or (longer and spans[0][0] == known.spans[0][0]):
            chosen[codes] = _Slot(spans, values, codes)
    return list(chosen.values())


def _runs(rows: Sequence[_Row]) -> list[_Run]:
    """Return the runs of pieces that all names have, from the left, the right or between."""
    found = []
    for c in range(len(rows[0])):
        lengths = [(len(row[c]) + 1) // 2 for row in rows]
        least = min(lengths)
        for a in range(min(least, _MOST_PIECES)):
            for b in range(a + 1, min(least, a + _LONGEST_RUN, _MOST_PIECES) + 1):
                found.append(tuple((c, a, b) for _ in rows))
                if max(lengths) > least:
                    found.append(tuple((c, n - b, n - a) for n in lengths))
            found += [tuple((c, a, n - left) for n in lengths) for left in range(least - a)]
    return [
        (spans, tuple(_text(row, span) for row, span in zip(rows, spans, strict=True)))
        for spans in dict.fromkeys(found)
    ]


def _text(row: _Row, span: Span) -> str:
    c, a, b = span
    return "".join(row[c][2 * a : 2 * b - 1])


def _is_numbered(slot: _Slot) -> bool:
    """Return whether every value has a number; a short run without one among them does not."""
    return all(re.search(r"\d", value) for value in slot.values) and any(
        _NUMBERED.fullmatch(piece) for piece in re.split(r"[_\-\s.]+", slot.values[0])
    )


def _overlap(one: _Slot, two: _Slot) -> bool:
    return any(
        s[0] == t[0] and s[1] < t[2] and t[1] < s[2]
        for s, t in zip(one.spans, two.spans, strict=True)
    )


def _found(
    rows: Sequence[_Row],
    runs: Sequence[_Run],
    slots: Sequence[_Slot],
    one: _Slot,
    two: _Slot | None,
    saved: float,
) -> _Found:
    fields = [one] if two is None else sorted((one, two), key=lambda slot: slot.spans[0])
    frames = _frames(rows, runs, slots, fields)
    n_frames, counts = len(set(frames)), [max(slot.codes) + 1 for slot in fields]
    cells = n_frames
    if two is not None:
        counts[fields.index(two)] = _n_phases(one, two, frames)
    for count in counts:
        cells *= count
    cost = n_frames + sum(counts) + _HOLE * max(cells - len(frames), 0) - saved
    before = tuple(_before(rows, slot) for slot in fields)
    return _Found(cost, NameFactors(frames, tuple(slot.values for slot in fields), before))


def _n_phases(one: _Slot, two: _Slot, frames: Sequence[str]) -> int:
    """Return the number of values of the second field.

    Of phases that every subject names for itself it is the most that one has.
    """
    n = max(two.codes) + 1
    own: dict[tuple[int, str], int] = {}
    for key in zip(one.codes, frames, strict=True):
        own[key] = own.get(key, 0) + 1
    most = max(own.values())
    named = all(PHASE_WORDS.fullmatch(value) for value in two.values)
    few = set(own.values()) == {most} and most <= _MOST_OWN_PHASES and max(one.codes) >= most
    return most if 1 < most and (named or few) else n


def _frames(
    rows: Sequence[_Row], runs: Sequence[_Run], slots: Sequence[_Slot], fields: Sequence[_Slot]
) -> tuple[str, ...]:
    """Return what the fields leave of the names."""
    marked: list[tuple[_Slot, str]] = [(slot, f"{{{k}}}") for k, slot in enumerate(fields)]
    marked += [
        (_Slot(spans, values, field.codes), f"{{{k}}}")
        for spans, values in runs
        for k, field in enumerate(fields)
        if values == field.values
    ]
    for slot in slots:
        if slot.is_single and any(_follows(slot, field) for field in fields):
            marked.append((slot, "*"))
    taken: list[tuple[_Slot, str]] = []
    for slot, mark in marked:
        if not any(_overlap(slot, other) for other, _ in taken):
            taken.append((slot, mark))
    frames = []
    for n, row in enumerate(rows):
        pieces = [list(component) for component in row]
        for slot, mark in taken:
            c, a, b = slot.spans[n]
            pieces[c][2 * a : 2 * b - 1] = [mark, *[""] * (2 * (b - a) - 2)]
        frames.append("/".join("".join(component) for component in pieces))
    return tuple(frames)


def _follows(slot: _Slot, field: _Slot) -> bool:
    """Return whether a field says what a run of pieces is."""
    return len(set(zip(slot.codes, field.codes, strict=True))) == max(field.codes) + 1


def _before(rows: Sequence[_Row], slot: _Slot) -> str:
    found = {
        row[c][2 * a - 2] if a else "" for row, (c, a, _) in zip(rows, slot.spans, strict=True)
    }
    return found.pop() if len(found) == 1 else ""
