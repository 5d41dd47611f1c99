"""The one writer of CSV tables."""

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path

from ostiform.atomic import atomically


def write_table(path: Path, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write a table: six significant digits of what is not whole, None and NaN left empty.

    Raises
    ------
    ArtifactError
        If the file cannot be written.
    """
    with atomically(path) as partial, partial.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(header)
        writer.writerows([_cell(value) for value in row] for row in rows)


def _cell(value: object) -> str:
    if value is None or value != value:
        return ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)
