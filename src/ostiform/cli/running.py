"""What every command does around its work: watching, summary, errors, exit codes."""

from __future__ import annotations

import json
import os
import sys
import traceback
from collections.abc import Callable

from ostiform import pipeline
from ostiform.cli.options import Common
from ostiform.cli.supervisor import INTERRUPTED, RESUME
from ostiform.cli.watch import watching
from ostiform.errors import (
    ArtifactError,
    CollapseError,
    ConvergenceError,
    EmbeddingError,
    InputError,
    OstiformError,
    TopologyError,
)
from ostiform.kernel_cache import kernels_kept

EXIT_CODES: dict[type[OstiformError], int] = {
    InputError: 2,
    TopologyError: 3,
    EmbeddingError: 4,
    ConvergenceError: 5,
    ArtifactError: 6,
    CollapseError: 7,
}
OTHER_FAILURE = 1


def run_command(common: Common, work: Callable[[pipeline.OnEvent], int]) -> int:
    """Do a command's work and return its exit code; errors become one sentence each."""
    try:
        with watching(common.quiet, common.verbose) as on_event:
            if note := kernels_kept():
                on_event(pipeline.Warn(note))
            return work(on_event)
    except OstiformError as error:
        if common.debug:
            traceback.print_exc()
        print(f"error: {error}", file=sys.stderr)
        return EXIT_CODES.get(type(error), OTHER_FAILURE)
    except OSError as error:
        if common.debug:
            traceback.print_exc()
        if isinstance(error, BrokenPipeError):
            raise
        where = f"{error.filename}: " if error.filename else ""
        print(
            f"error: {where}expected to read and write here, found: {error.strerror or error}; "
            "check the disk, the permissions and the path, and run the same command again",
            file=sys.stderr,
        )
        return OTHER_FAILURE
    except MemoryError:
        print(
            "error: expected enough memory, found too little; use fewer workers (-w 1) or a "
            "smaller template (template.points), and run the same command again",
            file=sys.stderr,
        )
        return OTHER_FAILURE
    except KeyboardInterrupt:
        print(RESUME, file=sys.stderr)
        return INTERRUPTED


def worker_count(common: Common) -> int:
    """Return the number of processes to use."""
    if common.workers is not None:
        if common.workers < 1:
            raise InputError(
                f"--workers: expected at least 1, found {common.workers}; leave it out for one "
                "per processor core"
            )
        return common.workers
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def show_summary(common: Common, summary: pipeline.Summary) -> int:
    """Say how a run ended; shapes left out are named again at the end."""
    if common.json:
        print(json.dumps(summary.as_json(), indent=1, ensure_ascii=False))
    elif not common.quiet:
        used = summary.shapes - len(summary.failures)
        seconds = sum(summary.seconds.values())
        print(
            f"{used} of {summary.shapes} shapes used, {seconds:.0f} s, results in {summary.output}"
        )
        for failure in summary.failures:
            print(f"  left out: {failure.id} ({failure.stage}): {failure.reason}")
    return 0
