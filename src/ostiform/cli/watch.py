"""How a run is shown: progress bars on a terminal, one clean line per stage in a pipe or a log."""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import timedelta

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
)
from rich.text import Text

from ostiform.pipeline import events

DETAIL_WIDTH = 40
"""Characters of what was just finished, so that a bar stays on one line."""


class _Pace(ProgressColumn):
    """The rate so far (seconds per step where a step is long) and the time that is left."""

    def render(self, task: Task) -> Text:
        """Return nothing before the first step is done."""
        elapsed = task.finished_time if task.finished else task.elapsed
        if not elapsed or not task.completed:
            return Text("")
        rate = task.completed / elapsed
        pace = f"{rate:.1f}/s" if rate >= 1.0 else f"{1.0 / rate:.1f} s each"
        if task.finished or task.total is None:
            return Text(pace)
        left = timedelta(seconds=round((task.total - task.completed) / rate))
        return Text(f"{pace}, {left} left")


@dataclass
class _Bars:
    """Progress bars on a terminal."""

    progress: Progress
    verbose: bool
    tasks: dict[str, TaskID] = field(default_factory=dict)

    def show(self, event: events.Event) -> None:
        """Show one event."""
        console = self.progress.console
        if isinstance(event, events.Note):
            console.print(event.text, markup=False, highlight=False)
        elif isinstance(event, events.Warn):
            console.print(f"warning: {event.text}", style="yellow", markup=False, highlight=False)
        else:
            if event.stage not in self.tasks:
                self.tasks[event.stage] = self.progress.add_task(
                    event.stage, total=event.total, detail=""
                )
            self.progress.update(
                self.tasks[event.stage],
                completed=event.done,
                total=event.total,
                detail="" if event.done == event.total else event.detail[:DETAIL_WIDTH],
            )
            if self.verbose and event.detail:
                console.print(f"{event.stage}: {event.detail}", markup=False, highlight=False)


@dataclass
class _Lines:
    """One line per finished stage, for pipes and logs."""

    console: Console
    verbose: bool
    started: dict[str, float] = field(default_factory=dict)

    def show(self, event: events.Event) -> None:
        """Print one event where it deserves a line."""
        if isinstance(event, events.Note):
            self._line(event.text)
        elif isinstance(event, events.Warn):
            self._line(f"warning: {event.text}")
        else:
            start = self.started.setdefault(event.stage, time.monotonic())
            if self.verbose and event.detail:
                self._line(f"{event.stage} {event.done}/{event.total}: {event.detail}")
            if event.done == event.total:
                seconds = time.monotonic() - start
                self._line(f"{event.stage}: {event.done}/{event.total} in {seconds:.1f} s")

    def _line(self, text: str) -> None:
        self.console.print(text, markup=False, highlight=False, soft_wrap=True)


@contextmanager
def watching(quiet: bool, verbose: bool) -> Iterator[events.OnEvent]:
    """Give the function that shows a run's events on standard error.

    Parameters
    ----------
    quiet : bool
        Show nothing but warnings.
    verbose : bool
        Show the detail of every step.
    """
    console = Console(stderr=True)
    if quiet:
        lines = _Lines(console, verbose=False)
        yield lambda event: lines.show(event) if isinstance(event, events.Warn) else None
    elif sys.stderr.isatty():
        with Progress(
            TextColumn("{task.description:<10}"),
            BarColumn(bar_width=20),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            _Pace(),
            TextColumn("{task.fields[detail]}", style="dim", markup=False),
            console=console,
        ) as progress:
            yield _Bars(progress, verbose).show
    else:
        yield _Lines(console, verbose).show
