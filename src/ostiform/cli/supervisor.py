"""Ctrl-C within a second, also in the midst of compiled code, which hears no signal.

Python acts on a signal between two of its instructions, so a kernel that runs for seconds delays
it. On Linux the command therefore works in a child process, and this one waits: what does not stop
by itself is ended. Files are written whole or not at all, so nothing finished is lost.
"""

import ctypes
import os
import signal
import sys
import time
from collections.abc import Callable
from types import FrameType
from typing import NoReturn

INTERRUPTED = 130
OTHER_FAILURE = 1
RESUME = "interrupted: what was finished is kept; run the same command again to go on"

PATIENCE_S = 0.6
"""Time that the child has to stop by itself."""

POLL_S = 0.02
PR_SET_PDEATHSIG = 1
SHOW_CURSOR = "\x1b[?25h"


def supervised(work: Callable[[], None]) -> None:
    """Do the work in a child process and end this one with its exit code (on Linux).

    Elsewhere the work is done here. The child ends with this process, however that one ends.

    Parameters
    ----------
    work : callable
        Ends its process itself where it has more to say than that all went well.
    """
    if sys.platform != "linux" or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        work()
        return
    parent = os.getpid()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    child = os.fork()
    if child == 0:
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:
            os._exit(OTHER_FAILURE)
        signal.signal(signal.SIGINT, _interrupt_once)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        work()
        return
    signal.signal(signal.SIGTERM, lambda *_: _end_both(child))
    _wait(child, before)


def _interrupt_once(_number: int, _frame: FrameType | None) -> NoReturn:
    """Raise KeyboardInterrupt, and be deaf to what comes while the process stops."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    raise KeyboardInterrupt


def _wait(child: int, mask: set[int | signal.Signals]) -> NoReturn:
    try:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        _, status = os.waitpid(child, 0)
    except KeyboardInterrupt:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        _stop(child)
        os._exit(INTERRUPTED)
    code = os.waitstatus_to_exitcode(status)
    if code >= 0:
        os._exit(code)
    print(
        f"error: expected the work to finish, found that the system ended it "
        f"({signal.Signals(-code).name}; out of memory, or a crash in compiled code); what was "
        "finished is kept: run the same command again, with fewer workers (-w 1) where memory is "
        "short",
        file=sys.stderr,
        flush=True,
    )
    os._exit(OTHER_FAILURE)


def _stop(child: int) -> None:
    """Give a child a moment to stop by itself, then end it and say what it could not say."""
    os.kill(child, signal.SIGINT)
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        if os.waitpid(child, os.WNOHANG)[0]:
            return
        time.sleep(POLL_S)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    if sys.stderr.isatty():
        sys.stderr.write(f"{SHOW_CURSOR}\n")
    print(RESUME, file=sys.stderr, flush=True)


def _end_both(child: int) -> NoReturn:
    os.kill(child, signal.SIGKILL)
    os._exit(128 + signal.SIGTERM)
