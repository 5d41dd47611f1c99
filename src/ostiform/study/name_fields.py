"""Names with fields: ``{subject}``, ``{phase}``, ..., ``*``, and ``{{`` for a brace itself."""

import re
from collections.abc import Callable, Mapping
from pathlib import Path

_PIECES = re.compile(r"(\{\{|\}\}|\{[^{}]*\}|\*)")
_BRACES = {"{{": "{", "}}": "}"}
_STAND_INS = str.maketrans("{}", "\ue000\ue001")


def name_expression(pattern: str, of_field: Callable[[str], str]) -> re.Pattern[str]:
    """Return the regular expression of a pattern, ``*`` within one step of a path.

    Parameters
    ----------
    pattern : str
    of_field : callable
        Gives the expression of a field by its name, or raises `InputError`.
    """
    text = ""
    for piece in _PIECES.split(pattern):
        if piece == "*":
            text += "[^/]*"
        elif len(piece) > 1 and piece not in _BRACES and _PIECES.fullmatch(piece):
            text += of_field(piece[1:-1])
        else:
            text += re.escape(_BRACES.get(piece, piece))
    return re.compile(text)


def filled_name(pattern: str, values: Mapping[str, str]) -> str | None:
    """Return a pattern with values in place of its fields; None where it has other fields."""
    pieces = _PIECES.split(pattern)
    fields = [p[1:-1] for p in pieces if p.startswith("{") and len(p) > 1 and p not in _BRACES]
    if not set(fields) <= set(values):
        return None
    return "".join(
        values[p[1:-1]] if p.startswith("{") and p[1:-1] in values else _BRACES.get(p, p)
        for p in pieces
    )


def files_as_deep(folder: Path, pattern: str) -> list[Path]:
    """Return the files of a folder as many steps down as a pattern, sorted.

    Hidden ones are left out unless the pattern asks for them; a link that leads nowhere is there,
    so that whoever reads it says so.
    """
    wants_hidden = pattern.rpartition("/")[2].startswith(".")
    return sorted(
        file
        for file in folder.glob("*/" * pattern.count("/") + "*")
        if (wants_hidden or not file.name.startswith(".")) and (file.is_file() or file.is_symlink())
    )


def without_braces(name: str) -> str:
    """Return a name with letters that no name has in place of its braces."""
    return name.translate(_STAND_INS)


def with_braces(text: str, doubled: bool) -> str:
    """Return a text of `without_braces` with its braces, for a pattern doubled."""
    one = 2 if doubled else 1
    return text.replace("\ue000", "{" * one).replace("\ue001", "}" * one)
