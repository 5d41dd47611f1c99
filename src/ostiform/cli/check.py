"""``ostiform check``: inspect every shape of a study without building."""

import json
from dataclasses import asdict

from rich.console import Console
from rich.table import Table

from ostiform.cli.options import DEFAULTS, Common, StudyPath
from ostiform.cli.running import EXIT_CODES, run_command, worker_count
from ostiform.errors import InputError
from ostiform.pipeline.check import ShapeCheck, check_study

__all__ = ["check"]


def check(study: StudyPath, *, common: Common = DEFAULTS) -> int:
    """Read every shape and say whether it can be used; the exit code is 0 only if all can."""
    return run_command(
        common,
        lambda tell: _show(common, check_study(study, worker_count(common), tell)),
    )


def _show(common: Common, checks: list[ShapeCheck]) -> int:
    if common.json:
        print(json.dumps([asdict(check) for check in checks], indent=1, ensure_ascii=False))
    elif not common.quiet:
        _print_table(checks)
    return 0 if all(check.problem is None for check in checks) else EXIT_CODES[InputError]


def _print_table(checks: list[ShapeCheck]) -> None:
    table = Table("shape", "part", "vertices", "triangles", "ostia", "worst triangle", "verdict")
    for check in checks:
        for row in check.parts:
            table.add_row(
                str(check.id),
                row.part,
                str(row.n_vertices),
                str(row.n_faces),
                ", ".join(row.ostia) or "closed",
                f"{row.worst_triangle:.3f}",
                "usable",
            )
        if check.problem is not None:
            table.add_row(str(check.id), "", "", "", "", "", "not usable")
    console = Console()
    console.print(table)
    for check in checks:
        for repair in check.repairs:
            console.print(f"{check.id}: {repair}", markup=False, highlight=False, soft_wrap=True)
        if check.problem is not None:
            console.print(check.problem, markup=False, highlight=False, soft_wrap=True)
    usable = sum(check.problem is None for check in checks)
    console.print(f"{usable} of {len(checks)} shapes can be used")
