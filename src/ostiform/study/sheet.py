"""Tables of shapes: one row per shape, from a CSV or an XLSX file."""

import codecs
import csv
import datetime
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ostiform.errors import InputError
from ostiform.values import value

_MARKS = ("exclude", "excluded", "reflect")
_TRUE, _FALSE = ("yes", "true", "1", "x", "y"), ("", "no", "false", "0", "n")


@value(eq=True)
class SheetRow:
    """One shape of a sheet.

    Attributes
    ----------
    subject : str
    phase : str or None
    time : float or None
        Fraction of the cycle, where the sheet says so.
    cycle_s : float or None
        Length of the cycle, where the sheet says so.
    files : mapping of str to str
        File of each part, as written; a part whose cell is empty is left out.
    covariates : mapping of str to str
        The other columns.
    excluded, reflect : bool
        Whether the shape is left out, and whether it is mirrored on reading.
    """

    subject: str
    phase: str | None
    time: float | None
    cycle_s: float | None
    files: Mapping[str, str]
    covariates: Mapping[str, str]
    excluded: bool
    reflect: bool


def read_sheet(
    path: Path,
    parts: Sequence[str],
    shares_files: bool = False,
    cycle_length_s: float | None = None,
) -> tuple[SheetRow, ...]:
    """Read a sheet with the columns subject, phase, time and one per part.

    ``time`` is a fraction of the cycle; instead there may be ``time_s`` in seconds, with the length
    of the cycle in ``cycle_s``, in ``heart_rate_bpm``, or given for all rows (`cycle_length_s`).
    ``exclude`` and ``reflect`` are yes or no.
    ``phase`` and the times may be left out; a study of one part, or one whose files hold all parts
    (`shares_files`), may have one column ``file``.
    Empty rows are skipped; every other column is kept as a covariate. A CSV file may separate by
    comma, semicolon or tabulator. An XLSX file is read from its first sheet.

    Raises
    ------
    InputError
        If the file is missing or damaged, a column is missing or double, or a cell is wrong; the
        row is named as a spreadsheet counts it.
    """
    if not path.is_file():
        raise InputError(f"{path}: expected a sheet of shapes, found no file: check shapes.sheet")
    rows = _xlsx_rows(path) if path.suffix.lower() == ".xlsx" else _csv_rows(path)
    if not rows:
        raise InputError(f"{path}: expected a row of column names, found an empty sheet")
    header = [cell.strip() for cell in rows[0]]
    is_shared = (len(parts) == 1 or shares_files) and "file" in header
    _check_header(path, header, () if is_shared else parts)
    file_columns: dict[str, tuple[str, ...]] = {part: (part,) for part in parts}
    if is_shared and not any(part in header for part in parts):
        file_columns = {"file": tuple(parts)}
    return tuple(
        _row(path, number, dict(zip(header, cells, strict=False)), file_columns, cycle_length_s)
        for number, cells in enumerate(rows[1:], start=2)
        if any(cell.strip() for cell in cells)
    )


def _check_header(path: Path, header: Sequence[str], parts: Sequence[str]) -> None:
    named = [name for name in header if name]
    double = sorted({name for name in named if named.count(name) > 1})
    if double:
        raise InputError(
            f"{path}: expected different column names, found {', '.join(double)} twice"
        )
    missing = [name for name in ("subject", *parts) if name not in header]
    if missing:
        raise InputError(
            f"{path}: expected the columns {', '.join(missing)}, found {', '.join(named)}"
        )


def _row(
    path: Path,
    number: int,
    cells: Mapping[str, str],
    file_columns: Mapping[str, tuple[str, ...]],
    cycle_length_s: float | None,
) -> SheetRow:
    values = {name: cell.strip() for name, cell in cells.items() if name}
    subject = values.pop("subject", "")
    if not subject:
        raise InputError(f"{path}, row {number}: expected a subject, found an empty cell")
    phase = values.pop("phase", "") or None
    written, seconds = values.pop("time", ""), values.pop("time_s", "")
    if written and seconds:
        raise InputError(
            f"{path}, row {number}: expected a time or a time_s, found both: leave one empty"
        )
    time = _time(path, number, written) if written else None
    cycle_s = _cycle_length(path, number, values, cycle_length_s)
    if seconds:
        time = _time_of_seconds(path, number, seconds, cycle_s)
    files = {
        part: name
        for column, named in file_columns.items()
        if (name := values.pop(column, ""))
        for part in named
    }
    marks = {name: _mark(path, number, name, values.pop(name, "")) for name in _MARKS}
    return SheetRow(
        subject=subject,
        phase=phase,
        time=time,
        cycle_s=cycle_s,
        files=files,
        covariates=values,
        excluded=marks["exclude"] or marks["excluded"],
        reflect=marks["reflect"],
    )


def _mark(path: Path, number: int, name: str, written: str) -> bool:
    word = written.casefold()
    if word not in (*_TRUE, *_FALSE):
        raise InputError(f'{path}, row {number}: expected {name} yes or no, found "{written}"')
    return word in _TRUE


def _time(path: Path, number: int, written: str) -> float:
    try:
        time = float(written.replace(",", "."))
    except ValueError:
        time = -1.0
    if not 0.0 <= time < 1.0:
        raise InputError(
            f"{path}, row {number}: expected a time from 0 to below 1 (fraction of the cycle), "
            f'found "{written}"'
        )
    return time


def _cycle_length(
    path: Path, number: int, cells: Mapping[str, str], default: float | None
) -> float | None:
    """Return the length of the cycle in seconds, which the row may state."""
    for name in ("cycle_s", "heart_rate_bpm"):
        if stated := cells.get(name, ""):
            value = _number(stated)
            if value is None or value <= 0.0:
                raise InputError(
                    f'{path}, row {number}: expected a positive {name}, found "{stated}"'
                )
            return value if name == "cycle_s" else 60.0 / value
    return default


def _time_of_seconds(path: Path, number: int, written: str, length: float | None) -> float:
    """Return a time in seconds as a fraction of the cycle."""
    if length is None:
        raise InputError(
            f"{path}, row {number}: expected the length of the cycle for a time in seconds, found "
            "none: add a column cycle_s or heart_rate_bpm, or cycle.length_s to the study"
        )
    time = _number(written)
    if time is None or not 0.0 <= time < length:
        raise InputError(
            f"{path}, row {number}: expected a time_s from 0 to below the cycle's {length:g} s, "
            f'found "{written}"'
        )
    return time / length


def _number(written: str) -> float | None:
    try:
        return float(written.replace(",", "."))
    except ValueError:
        return None


def _csv_rows(path: Path) -> list[list[str]]:
    try:
        content = path.read_bytes()
        is_utf16 = content[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)  # "Unicode text"
        text = content.decode("utf-16" if is_utf16 else "utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(
            f"{path}: expected text in UTF-8, found other bytes: save the sheet as CSV UTF-8"
        ) from None
    header = text.partition("\n")[0]
    delimiter = max(",;\t", key=header.count)
    try:
        return list(csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True))
    except csv.Error as error:
        raise InputError(f"{path}: expected a CSV file, found a mistake: {error}") from None


def _xlsx_rows(path: Path) -> list[list[str]]:
    from openpyxl import load_workbook

    try:
        book = load_workbook(path, read_only=True, data_only=True)
        rows = [[_cell(value) for value in row] for row in book.worksheets[0].values]
        book.close()
    except Exception as error:
        # openpyxl lets whatever its zip and XML readers raise escape.
        raise InputError(
            f"{path}: expected an XLSX sheet, found a file that cannot be read "
            f"({type(error).__name__}): save it again"
        ) from None
    return rows


def _cell(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float) and value.is_integer():
        return str(int(value))
    if isinstance(value, datetime.datetime | datetime.date | datetime.time):
        return value.isoformat()
    return str(value)
