"""Options that several commands share."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

__all__ = ["DEFAULTS", "Common", "Output", "StudyPath"]

StudyPath = Annotated[Path, Parameter(help="The study file (study.toml).")]
Output = Annotated[
    Path, Parameter(name=["--output", "-o"], help="Folder for the results; made if missing.")
]


@Parameter(name="*")
@dataclass(frozen=True)
class Common:
    """How a run works and what it says."""

    workers: Annotated[
        int | None,
        Parameter(name=["--workers", "-w"], help="Processes; default one per processor core."),
    ] = None
    quiet: Annotated[
        bool, Parameter(name=["--quiet", "-q"], negative="", help="Say nothing but warnings.")
    ] = False
    verbose: Annotated[
        bool, Parameter(name=["--verbose", "-v"], negative="", help="Say what every step does.")
    ] = False
    json: Annotated[
        bool, Parameter(negative="", help="Print a summary as JSON on standard output.")
    ] = False
    debug: Annotated[bool, Parameter(negative="", help="Show the traceback of an error.")] = False


DEFAULTS = Common()
