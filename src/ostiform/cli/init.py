"""``ostiform init``: propose a study file for a folder."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from ostiform import study
from ostiform.atomic import atomically
from ostiform.cli.options import DEFAULTS, Common
from ostiform.cli.running import run_command
from ostiform.errors import InputError

Folder = Annotated[Path, Parameter(help="Where the meshes or label maps are.")]
Target = Annotated[
    Path | None,
    Parameter(name=["--output", "-o"], help="The study file to write; default in FOLDER."),
]


def init(folder: Folder, output: Target = None, *, common: Common = DEFAULTS) -> int:
    """Look at a folder and write a commented study.toml: pattern, parts, openings and seams."""
    return run_command(common, lambda on_event: _init(folder, output, common))


def _init(folder: Path, output: Path | None, common: Common) -> int:
    target = folder / "study.toml" if output is None else output
    if target.exists():
        raise InputError(
            f"{target}: expected no file of this name, found one: give another with --output, or "
            "remove it"
        )
    text = study.proposed_study(folder, target)
    with atomically(target) as partial:
        partial.write_text(text, encoding="utf-8")
    if common.json:
        print(f'{{"study": "{target.as_posix()}"}}')
    elif not common.quiet:
        print(text, end="")
        print(f"written to {target}; next: ostiform check {target}", file=sys.stderr)
    return 0
