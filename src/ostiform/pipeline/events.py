"""What a running pipeline tells whoever watches it; the library itself prints nothing."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias


@dataclass(frozen=True, slots=True)
class Progress:
    """So much of a stage is done.

    Attributes
    ----------
    stage : str
    done, total : int
    detail : str
        What was just finished, or the objective, for a watcher who wants it.
    """

    stage: str
    done: int
    total: int
    detail: str = ""


@dataclass(frozen=True, slots=True)
class Note:
    """A fact worth a line."""

    text: str


@dataclass(frozen=True, slots=True)
class Warn:
    """Something that went wrong and did not end the run."""

    text: str


Event: TypeAlias = Progress | Note | Warn
OnEvent: TypeAlias = Callable[[Event], None]
