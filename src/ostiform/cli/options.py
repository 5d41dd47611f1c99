"""Options that several commands share."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Group, Parameter

StudyPath = Annotated[Path, Parameter(help="The study file (study.toml).")]
Output = Annotated[
    Path, Parameter(name=["--output", "-o"], help="Folder for the results; made if missing.")
]

Scheduler = Annotated[
    str | None,
    Parameter(
        name="--scheduler",
        help="Address of a Dask scheduler (tcp://HOST:PORT) whose workers do the work, instead "
        "of processes of this machine.",
        show_default=False,
    ),
]


def _flag(text: str, *names: str) -> Parameter:
    return Parameter(name=names, negative="", show_default=False, help=text)


@Parameter(name="*", group=Group("Common options", sort_key=1))
@dataclass(frozen=True)
class Common:
    """How a run works and what it says."""

    workers: Annotated[
        int | None,
        Parameter(name=["--workers", "-w"], help="Processes; default one per processor core."),
    ] = None
    quiet: Annotated[bool, _flag("Say nothing but warnings.", "--quiet", "-q")] = False
    verbose: Annotated[bool, _flag("Say what every step does.", "--verbose", "-v")] = False
    json: Annotated[bool, _flag("Print a summary as JSON on standard output.", "--json")] = False
    debug: Annotated[bool, _flag("Show the traceback of an error.", "--debug")] = False


DEFAULTS = Common()
