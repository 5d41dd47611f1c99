"""From file names to a pattern with the fields of a study."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ostiform.study.looks import FileLook
from ostiform.study.name_factors import NameFactors, name_factors
from ostiform.study.name_fields import with_braces, without_braces
from ostiform.study.name_roles import (
    CHAMBER,
    LABELS,
    PART_WORDS,
    PIECES,
    SUBJECT,
    Look,
    NameRoles,
    common_pieces,
    differing,
    is_part,
    name_roles,
    shown_frame,
    words_are_subjects,
)

_IMAGE = re.compile(r"(ct|mr|mri|img|image|images|4d|t1w|t2w|bssfp|orig|raw|para)", re.IGNORECASE)
_NAME = re.compile(r"[^\s./\\{}=+*\ue000\ue001][^./\\{}=+*\ue000\ue001]*")
_MOST_NAMES = 2000


@dataclass(frozen=True, slots=True)
class NamePattern:
    """A pattern of file names with the fields {subject}, {phase} and {part}.

    Attributes
    ----------
    pattern : str
    parts : tuple of str
        The values of {part}; where the pattern has none, the one part that the names tell of.
    first : mapping of str to str
        A file of each part, all of one shape; by ``""`` where the names tell of no part.
    notes : tuple of str
        How the names were read, and what is in doubt.
    """

    pattern: str
    parts: tuple[str, ...]
    first: Mapping[str, str]
    notes: tuple[str, ...]


def guessed_pattern(names: Sequence[str], look: Look = lambda name: None) -> NamePattern:
    """Return the likely pattern of file names that share an ending.

    Parameters
    ----------
    names : sequence of str
        Relative to the folder of the shapes, with ``/``; all equally deep.
    look : callable
        How a file looks; asked for a few files only, where the words of the names do not tell.
    """
    ending = name_ending(names[0])
    stems = [without_braces(name.removesuffix(ending)) for name in names]
    chosen, notes = _shapes_only(stems)
    kept = chosen[:_MOST_NAMES]
    if len(kept) < len(chosen):
        notes.append(f"the names of the first {len(kept)} of {len(chosen)} files were compared")

    def look_at(stem: str) -> FileLook | None:
        return look(with_braces(stem, doubled=False) + ending)

    factors = name_factors(kept, words=True)
    if len(factors.fields) == 2 and not words_are_subjects(factors):
        factors = name_factors(kept, words=False)
    if len(factors.fields) == 1 and all(map(is_part, factors.fields[0])):
        factors = NameFactors(tuple(kept), (), ())  # the parts of one subject
    return _pattern(factors, name_roles(factors, kept, look_at), kept, ending, notes)


def name_ending(name: str) -> str:
    """Return the ending of a file's name, of two pieces where the format's is."""
    for double in (".nii.gz", ".seg.nrrd", ".seq.nrrd"):
        if name.lower().endswith(double):
            return name[-len(double) :]
    return name[name.rfind(".") :]


def _shapes_only(stems: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the names without those that are called images where others are not."""
    last = [re.split(r"[_\-\s.]+", stem.rpartition("/")[2]) for stem in stems]
    is_labels = [any(LABELS.fullmatch(piece) for piece in own) for own in last]
    is_image = [
        not labels and any(_IMAGE.fullmatch(piece) for piece in own)
        for own, labels in zip(last, is_labels, strict=True)
    ]
    if all(is_image) or not any(is_image):
        return list(stems), []
    images = [stem for stem, image in zip(stems, is_image, strict=True) if image]
    return (
        [stem for stem, image in zip(stems, is_image, strict=True) if not image],
        [f"{len(images)} files called as images or spheres are left out, such as {images[0]}"],
    )


def _pattern(
    factors: NameFactors,
    roles: NameRoles,
    stems: Sequence[str],
    ending: str,
    notes: Sequence[str],
) -> NamePattern:
    frames, of_frames, said = roles.frames, roles.of_frames, [*notes, *roles.notes]
    merged = _merged(frames, of_frames)
    if merged is None:
        size = Counter(frame for frame in factors.frames if frame in frames)
        folders = Counter(frame.rpartition("/")[0] for frame in size.elements())
        largest = folders.most_common(1)[0][0]
        frames = tuple(frame for frame in frames if frame.rpartition("/")[0] == largest)
        merged = _merged(frames, of_frames)
    if merged is None:
        merged = max(frames, key=lambda frame: size[frame])
        frames = (merged,)
    of_frames = of_frames if len(frames) > 1 else ""
    if frames != roles.frames:
        shown = ", ".join(shown_frame(frame) for frame in frames)
        said.append(
            f"doubt: {shown} of one folder alone, one pattern does not fit the other names: rename "
            "the files or write a sheet"
        )
    for k, role in enumerate(roles.fields):
        merged = merged.replace(f"{{{k}}}", f"{{{role}}}")
    merged = merged if "{subject}" in merged else _with_subject(merged)
    used = [k for k, frame in enumerate(factors.frames) if frame in frames]
    first = {next((p for p in PIECES.split(merged) if CHAMBER.fullmatch(p)), ""): used[0]}
    if of_frames == "part":
        part_of = dict(zip(frames, (w.partition("/")[0] for w in differing(frames)), strict=True))
        # A file of the first shape, else any.
        start = used[0]
        used.sort(key=lambda k: sum(field[k] != field[start] for field in factors.fields))
        first = {
            part: next(k for k in used if factors.frames[k] == frame)
            for frame, part in part_of.items()
        }
    said.insert(0, _summary(factors, roles, len(frames), of_frames, len(used), len(stems)))
    if twins := _twins(factors):
        said.append(f"doubt: {twins} differ in case only: rename the files if they are one")
    parts = tuple(part for part in first if part)
    files = {part: with_braces(stems[k], doubled=False) + ending for part, k in first.items()}
    said = [with_braces(note, doubled=False) for note in said]
    return NamePattern(with_braces(merged, doubled=True) + ending, parts, files, tuple(said))


def _merged(frames: Sequence[str], role: str) -> str | None:
    """Return one frame for all, a field in place of what differs; None where there is none."""
    if len(frames) == 1:
        return frames[0]
    rows = [PIECES.split(frame) for frame in frames]
    head, tail = common_pieces(rows)
    before, after = "".join(rows[0][:head]), "".join(rows[0][len(rows[0]) - tail :])
    steps = [middle.split("/") for middle in differing(frames)]
    if len({len(step) for step in steps}) > 1:
        return None
    columns = list(zip(*steps, strict=True))
    if role == "group":
        # The differing words and the number beside them, in one name, are the subject.
        text = f"{before}{'*/' * (len(columns) - 1)}<>{after}"
        if all("{0}" in value for value in columns[-1]):
            return text.replace("<>", "{0}")
        found = re.search(r"<>[^/{}]*\{0\}|\{0\}[^/{}]*<>", text)
        return text.replace(found[0], "{0}") if found else None
    if not all(_NAME.fullmatch(value) for value in columns[0]):
        return None
    if any("{" in value for column in columns for value in column):
        return None
    marks = [f"{{{role}}}" if column == columns[0] else "*" for column in columns]
    return before + "/".join(marks) + after


def _with_subject(frame: str) -> str:
    """Return a frame in which a piece of all names is the subject, where one can be."""
    pieces = PIECES.split(frame)
    words = [k for k in range(0, len(pieces), 2) if re.fullmatch(r"[^{}*]+", pieces[k])]
    free = [k for k in words if not PART_WORDS.fullmatch(pieces[k])]
    known = [k for k in free if SUBJECT.fullmatch(pieces[k])]
    for k in (known or free or ([] if "{" in frame else words))[:1]:
        pieces[k] = "{subject}"
    return "".join(pieces)


def _summary(
    factors: NameFactors, roles: NameRoles, n_frames: int, of_frames: str, n_used: int, n_all: int
) -> str:
    counts = {r: len(set(field)) for r, field in zip(roles.fields, factors.fields, strict=True)}
    if of_frames:
        counts["subject" if of_frames == "group" else of_frames] = n_frames
    words = " x ".join(
        f"{counts[role]} {role}{'s' * (counts[role] != 1)}"
        for role in ("subject", "phase", "part")
        if role in counts
    )
    return f"read from the names: {words or '1 shape'}, {n_used} of {n_all} files"


def _twins(factors: NameFactors) -> str:
    for field in factors.fields:
        seen: dict[str, str] = {}
        for value in field:
            known = seen.setdefault(value.casefold(), value)
            if known != value:
                return f"{known} and {value}"
    return ""
