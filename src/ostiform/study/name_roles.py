"""What the pieces of names stand for: told by words, else by how the surfaces look."""

import re
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from ostiform.study.cycles import natural_key
from ostiform.study.looks import FileLook, Relation, is_series, relation
from ostiform.study.name_factors import PHASE_WORDS, NameFactors

Look = Callable[[str], FileLook | None]
"""How a file looks; None where that cannot be said."""

PART_WORDS = re.compile(
    r"(lv|la|rv|ra|ao|aorta|lvot|rvot|pa|laa|pv|ivc|svc|heart|left|right|endo\w*|epi\w*|atri\w+|"
    r"ventric\w+|myo\w*|septum|femur|tibia|fibula|patella|pelvis|sacrum|hip|scapula|humerus|radius|"
    r"ulna|talus|calcaneus|vertebra\w*|rib|liver|spleen|kidney|lung|hippo\w*|amygdala|thalamus|"
    r"caudate|putamen|pallidum|cartilage|meniscus)",
    re.IGNORECASE,
)
CHAMBER = re.compile(r"lv|la|rv|ra|ao|aorta|lvot|pa|laa", re.IGNORECASE)
_HEART = re.compile(
    r"(?<![a-z])(lv|la|rv|ra|laa|atri\w+|ventric\w+|myo\w*|endo\w*|epi\w*|heart|aorta|"
    r"pulmonary)(?![a-z])",
    re.IGNORECASE,
)
SUBJECT = re.compile(
    r"(p|pat|patient|s|sub|subj|subject|case|id|vol|volunteer|heart|specimen|donor)-?\d+",
    re.IGNORECASE,
)
LABELS = re.compile(
    r"(gt|label\w*|seg|segmentations?|mask|masks|lbl|roi|heartchambers\w*|total)", re.IGNORECASE
)
_GROUP = re.compile(
    r"controls?|healthy|normals?|ill|sick|patients?|diseased?|cases?|train(ing)?|test(ing)?|val\w*|"
    r"hcm|dcm|minf|af|sr|men|women|male|female",
    re.IGNORECASE,
)
_SIDE = re.compile(r"left|right|l|r", re.IGNORECASE)
_MOST_PARTS = 8
PIECES = re.compile(r"([_\-\s./]+|(?=\{)|(?<=\}))")
_TRIED = 3
_LONGEST_SERIES = 12


@dataclass(frozen=True, slots=True)
class NameRoles:
    """What fields and frames stand for."""

    frames: tuple[str, ...]
    """Those that are used."""
    fields: tuple[str, ...]
    of_frames: str
    notes: tuple[str, ...]


def is_part(value: str) -> bool:
    """Return whether a piece of a name is the usual word for a part of the body."""
    return any(PART_WORDS.fullmatch(piece) for piece in PIECES.split(value))


def words_are_subjects(factors: NameFactors) -> bool:
    """Return whether no field is of words that stand for parts or groups."""
    return not any(
        all(is_part(value) or _GROUP.fullmatch(value) for value in field)
        for field in factors.fields
    )


def name_roles(factors: NameFactors, stems: Sequence[str], look: Look) -> NameRoles:
    """Return what fields and frames stand for."""
    frames = tuple(dict.fromkeys(factors.frames))
    if not factors.fields:
        parts = len(frames) > 1 and all(map(is_part, differing(frames)))
        return NameRoles(frames, (), "part" if parts else "subject" if len(frames) > 1 else "", ())
    if len(factors.fields) == 2:
        fields, notes = _roles_of_two(factors)
    else:
        fields, notes = _role_of_one(factors, stems, look)
    if len(frames) == 1:
        return NameRoles(frames, fields, "", notes)
    return _roles_of_frames(factors, stems, look, fields, notes)


def _roles_of_two(factors: NameFactors) -> tuple[tuple[str, ...], tuple[str, ...]]:
    phases = [_is_phase(factors, k) for k in (0, 1)]
    if phases[0] and not phases[1]:
        return ("phase", "subject"), ()
    if not phases[1] and any(SUBJECT.fullmatch(v) for v in factors.fields[1]):
        return ("phase", "subject"), ()
    sure = phases[1] or all(SUBJECT.fullmatch(v) for v in factors.fields[0])
    subjects = ", ".join(dict.fromkeys(factors.fields[0][:_TRIED]))
    phases_of = ", ".join(dict.fromkeys(factors.fields[1][:_TRIED]))
    doubt = f"doubt: {subjects} ... were taken for subjects, {phases_of} ... for phases"
    return ("subject", "phase"), () if sure else (doubt,)


def _is_phase(factors: NameFactors, k: int) -> bool:
    before = factors.before[k]
    return all(
        PHASE_WORDS.fullmatch(value) or PHASE_WORDS.fullmatch(f"{before}{value}")
        for value in factors.fields[k]
    )


def _role_of_one(
    factors: NameFactors, stems: Sequence[str], look: Look
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    values = factors.fields[0]
    if _is_phase(factors, 0):
        return ("phase",), ()
    if all(SUBJECT.fullmatch(v) for v in values) or SUBJECT.fullmatch(f"{factors.before[0]}1"):
        return ("subject",), ()
    if any(SUBJECT.fullmatch(piece) for piece in PIECES.split(factors.frames[0])):
        return ("phase",), ()
    first = [
        s for s, frame in zip(stems, factors.frames, strict=True) if frame == factors.frames[0]
    ]
    ordered = sorted(first, key=natural_key)[:_LONGEST_SERIES]
    looks = [found for name in ordered if (found := look(name)) is not None]
    if len(looks) == len(ordered) and is_series(looks):
        return ("phase",), (
            "the numbers were taken for the phases of one subject, since every shape is nearest to "
            "the next; if they are subjects, write {subject} in place of {phase}",
        )
    return ("subject",), ()


def _roles_of_frames(
    factors: NameFactors,
    stems: Sequence[str],
    look: Look,
    fields: tuple[str, ...],
    notes: tuple[str, ...],
) -> NameRoles:
    frames = tuple(dict.fromkeys(factors.frames))
    varying = differing(frames)
    words = {frame: varying[k] for k, frame in enumerate(frames)}
    labels = [f for f in frames if any(LABELS.fullmatch(p) for p in PIECES.split(words[f]))]
    if len(labels) == 1 or (labels and len(labels) < len(frames) and "" in words.values()):
        return NameRoles(tuple(labels[:1]), fields, "", (*notes, _left_out(frames, labels[0])))
    if "phase" not in fields and all(PHASE_WORDS.fullmatch(w) for w in words.values()):
        return NameRoles(frames, fields, "phase", notes)
    of_heart = sum(_of_heart(word) for word in words.values())
    if "subject" in fields and (of_heart > 1 or sum(map(is_part, words.values())) > len(words) / 2):
        return _parts_of(frames, fields, words, notes)
    kinds = _relations(factors, stems, look)
    spheres = {frame for frame, kind in kinds.items() if kind == "sphere"}
    frames = tuple(frame for frame in frames if frame not in spheres)
    if spheres:
        notes = (*notes, f"{len(spheres)} kinds of files are spheres, not shapes, and left out")
    if len(frames) == 1:
        return NameRoles(frames, fields, "", notes)
    found = {kinds.get(frame) for frame in frames[1:]}
    if "other" in found or (None in found and "subject" in fields and len(frames) <= _MOST_PARTS):
        said = "they differ in openings, size or place" if "other" in found else "nothing tells"
        doubt = f"the words {_listed(words, frames)} were taken for parts of one shape: {said}"
        if "subject" in fields:
            return _parts_of(frames, fields, words, (*notes, f"doubt: {doubt}"))
    if fields == ("phase",):
        return NameRoles(frames, fields, "subject", notes)
    if found == {"same"}:
        return NameRoles(frames[:1], fields, "", (*notes, _left_out(frames, frames[0])))
    if found <= {"paired", "same"} and "phase" not in fields:
        doubt = f"the words {_listed(words, frames)} were taken for phases of one subject"
        return NameRoles(frames, fields, "phase", (*notes, f"doubt: {doubt}"))
    doubt = f"the words {_listed(words, frames)} were taken for groups of other subjects"
    return NameRoles(frames, fields, "group", (*notes, f"doubt: {doubt}"))


def _left_out(frames: Sequence[str], used: str) -> str:
    others = ", ".join(shown_frame(frame) for frame in frames if frame != used)
    return f"of every shape {shown_frame(used)} is used, not {others}"


def shown_frame(frame: str) -> str:
    """Return the file's name of a frame with ``*`` for its fields."""
    return frame.replace("{0}", "*").replace("{1}", "*").rpartition("/")[2]


def _listed(words: Mapping[str, str], frames: Sequence[str]) -> str:
    return ", ".join(words[frame] for frame in frames[:_MOST_PARTS])


def _of_heart(words: str) -> bool:
    return _HEART.search(words.replace("_", " ")) is not None


def _parts_of(
    frames: tuple[str, ...],
    fields: tuple[str, ...],
    words: Mapping[str, str],
    notes: tuple[str, ...],
) -> NameRoles:
    """Return the parts: of the heart where there are others beside it, and not too many."""
    heart = tuple(frame for frame in frames if _of_heart(words[frame]))
    if 0 < len(heart) < len(frames):
        others = [words[frame] for frame in frames if frame not in heart]
        notes = (
            *notes,
            f"not used: {', '.join(others[:_MOST_PARTS])}{', ...' * (len(others) > 8)}",
        )
        frames = heart
    if len(frames) > _MOST_PARTS:
        notes = (
            *notes,
            f"doubt: the first of {len(frames)} structures is used; for others, change [parts]: "
            f"{_listed(words, frames)}, ...",
        )
        frames = frames[:1]
    return NameRoles(frames, fields, "part" if len(frames) > 1 else "", notes)


def _relations(
    factors: NameFactors, stems: Sequence[str], look: Look
) -> dict[str, Relation | str | None]:
    """Return how the files of every frame are related to those of the first that is no sphere."""
    by_frame: dict[str, dict[tuple[str, ...], str]] = defaultdict(dict)
    for k, (stem, frame) in enumerate(zip(stems, factors.frames, strict=True)):
        by_frame[frame][tuple(field[k] for field in factors.fields)] = stem
    found: dict[str, Relation | str | None] = {}
    first: str | None = None
    for frame in list(by_frame)[: _MOST_PARTS + 1]:
        own = look(next(iter(by_frame[frame].values())))
        if own is not None and own.is_sphere and len(by_frame) > 1:
            found[frame] = "sphere"
        elif first is None:
            first = frame
        else:
            shared = [key for key in by_frame[first] if key in by_frame[frame]][:_TRIED]
            pairs = [(look(by_frame[first][key]), look(by_frame[frame][key])) for key in shared]
            seen = [(a, b) for a, b in pairs if a is not None and b is not None]
            found[frame] = relation(seen) if seen else None
    return found


def differing(frames: Sequence[str]) -> list[str]:
    """Return the pieces of frames that differ, each from its first to its last such piece.

    A side beside them is taken with them: ``left_atrium``, not ``atrium``.
    """
    rows = [PIECES.split(frame) for frame in frames]
    head, tail = common_pieces(rows)
    return ["".join(row[head : len(row) - tail]) for row in rows]


def common_pieces(rows: Sequence[Sequence[str]]) -> tuple[int, int]:
    """Return how many pieces all rows begin with, and how many they end with."""
    least = min(map(len, rows))
    head = next((k for k in range(least) if len({row[k] for row in rows}) > 1), least)
    head -= head % 2
    tail = next((k for k in range(least - head) if len({row[-1 - k] for row in rows}) > 1), 0)
    tail -= tail % 2
    if head > 1 and _SIDE.fullmatch(rows[0][head - 2]):
        head -= 2
    if tail > 1 and _SIDE.fullmatch(rows[0][len(rows[0]) - tail + 1]):
        tail -= 2
    return head, tail
