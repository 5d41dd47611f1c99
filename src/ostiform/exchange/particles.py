"""Correspondence points as ShapeWorks keeps them: ``.particles`` files and projects.

A ``.particles`` file holds one point ``x y z`` per line, in the order of the correspondence.
``NAME_local.particles`` is in the shape's own frame, ``NAME_world.particles`` after alignment.
A project lists the subjects with their files: ``.swproj`` (JSON, every leaf a string, ShapeWorks
6.4 and newer) or ``.xlsx`` (before), paths relative to the project.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.atomic import atomically
from ostiform.errors import InputError
from ostiform.values import value

PARTICLE_SUFFIXES = (".particles", ".lpts", ".wpts", ".pts")
PROJECT_VERSION = "2"


@value(eq=True)
class ProjectRow:
    """One subject of a project: its columns as written.

    Attributes
    ----------
    columns : mapping of str to str
        For example ``name``, ``shape_1``, ``local_particles_1``, ``world_particles_1``,
        ``procrustes_1``, ``group_sex``.
    """

    columns: Mapping[str, str]

    def domains(self) -> tuple[str, ...]:
        """Return the names of the domains that have particles."""
        starts = ("local_particles_", "world_particles_")
        found = (
            name.removeprefix(start)
            for name in self.columns
            for start in starts
            if name.startswith(start)
        )
        return tuple(dict.fromkeys(found))

    @property
    def is_excluded(self) -> bool:
        """Whether ShapeWorks leaves the subject out."""
        return self.columns.get("excluded", "").strip().lower() in ("true", "1", "yes")

    @property
    def groups(self) -> dict[str, str]:
        """The columns ``group_...`` without that word, for example ``sex``."""
        return {
            name.removeprefix("group_"): value
            for name, value in self.columns.items()
            if name.startswith("group_")
        }


def write_particles(path: Path, points: FloatArray) -> None:
    """Write points (P, 3), one per line, with every digit.

    Raises
    ------
    ArtifactError
        If the file cannot be written.
    """
    text = "".join(f"{x!r} {y!r} {z!r}\n" for x, y, z in np.asarray(points).tolist())
    with atomically(path) as partial:
        partial.write_text(text, encoding="ascii")


def read_particles(path: Path) -> FloatArray:
    """Read the points (P, 3) of a particles file.

    Raises
    ------
    InputError
        If the file is missing or empty, or a line does not hold three numbers.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except FileNotFoundError:
        raise InputError(f"{path}: expected a particles file, found none: check the path") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(
            f"{path}: expected a particles file of text, found one that cannot be read ({error})"
        ) from None
    rows = []
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        try:
            row = [float(word) for word in line.split()]
        except ValueError:
            row = []
        if len(row) != 3 or not np.isfinite(row).all():
            raise InputError(
                f'{path}, line {number}: expected three numbers "x y z", found "{line[:60]}"'
            )
        rows.append(row)
    if not rows:
        raise InputError(f"{path}: expected one point per line, found an empty file")
    return np.array(rows)


def write_swproj(path: Path, rows: Sequence[ProjectRow], settings: Mapping[str, str]) -> None:
    """Write a project as JSON.

    Parameters
    ----------
    path : Path
        Ends in ``.swproj``.
    rows : sequence of ProjectRow
    settings : mapping of str to str
        Of the section ``optimize``, for example ``number_of_particles``.

    Raises
    ------
    ArtifactError
        If the file cannot be written.
    """
    project = {
        "data": [dict(row.columns) for row in rows],
        "groom": {},
        "optimize": dict(settings),
        "project": {"version": PROJECT_VERSION},
    }
    with atomically(path) as partial:
        partial.write_text(json.dumps(project, indent=1, ensure_ascii=False) + "\n", "utf-8")


def write_xlsx_project(path: Path, rows: Sequence[ProjectRow], settings: Mapping[str, str]) -> None:
    """Write a project as a spreadsheet: sheets ``data``, ``optimize`` and ``project``.

    Parameters and errors are those of `write_swproj`; the name ends in ``.xlsx``.
    """
    from openpyxl import Workbook

    book = Workbook()
    data = book.active
    data.title = "data"
    header = list(dict.fromkeys(name for row in rows for name in row.columns))
    data.append(header)
    for row in rows:
        data.append([row.columns.get(name, "") for name in header])
    for title, values in (("optimize", settings), ("project", {"version": PROJECT_VERSION})):
        sheet = book.create_sheet(title)
        sheet.append(["key", "value"])
        for pair in values.items():
            sheet.append(pair)
    with atomically(path) as partial:
        book.save(partial)


def read_project(path: Path) -> tuple[ProjectRow, ...]:
    """Read the subjects of a project, ``.swproj`` or ``.xlsx``.

    Raises
    ------
    InputError
        If the file is missing, damaged, of another kind, or lists no subject.
    """
    if not path.is_file():
        raise InputError(f"{path}: expected a ShapeWorks project, found no such file")
    rows = _xlsx_rows(path) if path.suffix.lower() == ".xlsx" else _json_rows(path)
    if not rows:
        raise InputError(f"{path}: expected a project that lists subjects, found none")
    return tuple(ProjectRow({name: value for name, value in row.items() if value}) for row in rows)


def _json_rows(path: Path) -> list[dict[str, str]]:
    try:
        project = json.loads(path.read_bytes())
        rows = [{str(k): str(v) for k, v in row.items()} for row in project["data"]]
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(
            f'{path}: expected a ShapeWorks project (JSON with a list "data"), found another or a '
            f"damaged file ({type(error).__name__}: {error})"
        ) from None
    return rows


def _xlsx_rows(path: Path) -> list[dict[str, str]]:
    from openpyxl import load_workbook

    try:
        book = load_workbook(path, read_only=True, data_only=True)
        cells: list[list[Any]] = [list(row) for row in book["data"].values]
        book.close()
    except Exception as error:
        # openpyxl lets whatever its zip and XML readers raise escape.
        raise InputError(
            f'{path}: expected a ShapeWorks project with a sheet "data", found a file that cannot '
            f"be read ({type(error).__name__})"
        ) from None
    texts = [["" if value is None else str(value).strip() for value in row] for row in cells]
    return [dict(zip(texts[0], row, strict=False)) for row in texts[1:] if any(row)]
