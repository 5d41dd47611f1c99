"""``ostiform check``: inspect every shape of a study without building."""

from __future__ import annotations

import json
from dataclasses import asdict

from rich.console import Console
from rich.table import Table

from ostiform import pipeline
from ostiform.cli.options import DEFAULTS, Common, StudyPath
from ostiform.cli.running import EXIT_CODES, run_command, worker_count
from ostiform.errors import InputError

FILE_WIDTH = 160
"""Columns of the table in a pipe or a log."""

MOST_NAMED = 3
"""Shapes of which the same is said, by name."""


def check(study: StudyPath, *, common: Common = DEFAULTS) -> int:
    """Read every shape and say whether it can be used; the exit code is 0 only if all can."""
    return run_command(
        common,
        lambda on_event: _show(common, pipeline.check_study(study, worker_count(common), on_event)),
    )


def _show(common: Common, checks: list[pipeline.ShapeCheck]) -> int:
    if common.json:
        print(json.dumps([asdict(check) for check in checks], indent=1, ensure_ascii=False))
    elif not common.quiet:
        _print_table(checks)
    return 0 if all(check.problem is None for check in checks) else EXIT_CODES[InputError]


def _print_table(checks: list[pipeline.ShapeCheck]) -> None:
    table = Table(
        "shape", "part", "vertices", "openings", "genus", "components", "worst triangle", "verdict"
    )
    for check in checks:
        verdict = "not usable" if check.problem else "usable, mended" if check.repairs else "usable"
        verdict = "excluded" if check.is_excluded else verdict
        for row in check.parts:
            named = ", ".join(row.ostia) or ("closed" if row.n_openings == 0 else "")
            openings = "?" if row.n_openings is None else str(row.n_openings)
            table.add_row(
                str(check.id),
                row.part,
                str(row.n_vertices),
                f"{openings} ({named})" if named else openings,
                "?" if row.genus is None else str(row.genus),
                str(row.n_components),
                f"{row.worst_triangle:.3f}",
                verdict,
            )
        if not check.parts:
            table.add_row(str(check.id), "", "", "", "", "", "", verdict)
    console = Console()
    if not console.is_terminal:
        console = Console(width=FILE_WIDTH)
    console.print(table)
    told: dict[str, list[str]] = {}
    for check in checks:
        for repair in check.repairs:
            told.setdefault(repair, []).append(str(check.id))
    lines = [f"{_listed(shapes)}: {repair}" for repair, shapes in told.items()]
    for line in (*lines, *(check.problem for check in checks if check.problem is not None)):
        console.print(line, markup=False, highlight=False, soft_wrap=True)
    arrays = ", ".join(dict.fromkeys(name for check in checks for name in check.arrays))
    if arrays:
        text = f"arrays on the surfaces that no table of [fields] names: {arrays}"
        console.print(text, markup=False, highlight=False, soft_wrap=True)
    looked_at = [check for check in checks if not check.is_excluded]
    usable = sum(check.problem is None for check in looked_at)
    console.print(f"{usable} of {len(looked_at)} shapes can be used")


def _listed(shapes: list[str]) -> str:
    more = len(shapes) - MOST_NAMED
    return ", ".join(shapes[:MOST_NAMED]) + (f" and {more} more" if more > 0 else "")
