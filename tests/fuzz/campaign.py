"""Giving damaged files to readers, and what came of it.

Case k of a reader is the same file wherever and whenever it is made. A case fails if anything but
an error of Ostiform comes out of the reader, if it takes too long, or if it ends the process.
"""

import multiprocessing
import os
import resource
import signal
import time
import traceback
import warnings
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ostiform.errors import OstiformError
from tests.fuzz.mutations import damaged
from tests.fuzz.targets import Target, make_targets

__all__ = ["Finding", "Tally", "case_content", "run_apart", "run_case", "run_here"]

LONGEST_S = 10.0
"""For one small file."""

MOST_MEMORY = 8 * 2**30
"""Address space of a process that reads damaged files, bytes."""


@dataclass(frozen=True)
class Finding:
    """A case that failed.

    Attributes
    ----------
    target : str
    case : int
    what : str
        Kind of error and place, the same for the same fault.
    detail : str
    """

    target: str
    case: int
    what: str
    detail: str


@dataclass
class Tally:
    """What came of many cases."""

    outcomes: Counter[tuple[str, str]] = field(default_factory=Counter)
    findings: list[Finding] = field(default_factory=list)

    def add(self, target: str, outcome: str | Finding) -> None:
        """Count one outcome."""
        if isinstance(outcome, Finding):
            self.findings.append(outcome)
            outcome = "failed"
        self.outcomes[target, outcome] += 1


class _TooLong(BaseException):
    pass


def case_content(target: Target, case: int) -> bytes:
    """Return the damaged file of a case."""
    rng = np.random.default_rng([zlib.crc32(target.name.encode()), case])
    seed = int(rng.integers(len(target.seeds)))
    others = [content for number, content in enumerate(target.seeds) if number != seed]
    return damaged(target.seeds[seed], others, rng)


def run_case(
    target: Target, case: int, folder: Path, longest_s: float = LONGEST_S
) -> str | Finding:
    """Give a damaged file to a reader; return "read", "refused" or what went wrong."""
    path = folder / target.file
    path.write_bytes(case_content(target, case))
    try:
        with _at_most(longest_s), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            target.read(path)
    except OstiformError as error:
        if len(str(error)) > 4000:
            return Finding(target.name, case, "a message of thousands of letters", str(error)[:300])
        return "refused"
    except _TooLong:
        return Finding(target.name, case, "hang", f"more than {longest_s:g} s")
    except Exception as error:
        frames = traceback.extract_tb(error.__traceback__)
        ours = [frame for frame in frames if "ostiform" in frame.filename] or frames
        place = f"{Path(ours[-1].filename).name}:{ours[-1].lineno}"
        return Finding(
            target.name, case, f"{type(error).__name__} at {place}", traceback.format_exc()
        )
    return "read"


def run_here(targets: Sequence[Target], cases: Sequence[int], folder: Path) -> Tally:
    """Run cases of every target in this process."""
    tally = Tally()
    for target in targets:
        inside = folder / target.name.replace(" ", "_")
        inside.mkdir(parents=True, exist_ok=True)
        for case in cases:
            tally.add(target.name, run_case(target, case, inside))
    return tally


def run_apart(
    names: Sequence[str],
    cases: Sequence[int],
    folder: Path,
    make: Callable[[Path], Mapping[str, Target]] = make_targets,
) -> Tally:
    """Run cases of targets in a process that may crash or hang: it is replaced, the case noted."""
    jobs = [(name, case) for case in cases for name in names]
    tally = Tally()
    context = multiprocessing.get_context("spawn")
    position = 0
    while position < len(jobs):
        here, there = context.Pipe(duplex=False)
        process = context.Process(
            target=_work, args=(jobs[position:], folder, there, make), daemon=True
        )
        process.start()
        there.close()
        fault = "crash"
        try:
            while position < len(jobs):
                # The first answer waits for the imports and the sound files.
                if not here.poll(20.0 * LONGEST_S):
                    fault = "hang in compiled code"
                    break
                tally.add(jobs[position][0], here.recv())
                position += 1
        except EOFError:
            process.join(LONGEST_S)
        process.kill()
        process.join()
        if position < len(jobs):
            name, case = jobs[position]
            tally.add(name, Finding(name, case, fault, f"exit code {process.exitcode}"))
            position += 1
    return tally


def _work(
    jobs: Sequence[tuple[str, int]],
    folder: Path,
    answers: Any,
    make: Callable[[Path], Mapping[str, Target]],
) -> None:
    targets = make(folder / "sound")
    memory = resource.getrlimit(resource.RLIMIT_AS)[1]
    resource.setrlimit(resource.RLIMIT_AS, (MOST_MEMORY, memory))
    for name, case in jobs:
        inside = folder / str(os.getpid()) / name.replace(" ", "_")
        inside.mkdir(parents=True, exist_ok=True)
        answers.send(run_case(targets[name], case, inside))
    time.sleep(60.0)  # until the answers are read


@contextmanager
def _at_most(seconds: float) -> Iterator[None]:
    """Interrupt the block after so many seconds of processor time, once Python code runs."""

    def stop(_signal: int, _frame: Any) -> None:
        raise _TooLong

    before = signal.signal(signal.SIGVTALRM, stop)
    signal.setitimer(signal.ITIMER_VIRTUAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        signal.signal(signal.SIGVTALRM, before)
