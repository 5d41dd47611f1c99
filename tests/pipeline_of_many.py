"""Stage functions for runs of many made-up shapes, importable by worker processes."""

import os
import signal

from ostiform.errors import ArtifactError, InputError

BROKEN, UNFORESEEN, CRASHING, FULL = 250, 251, 252, 253


def light_stage(number: int) -> int:
    """Do nothing but fail for some shapes, each in its own way."""
    if number == BROKEN:
        raise InputError(f"shape s{number}/0: expected a surface, found half of one")
    if number == UNFORESEEN:
        return number // 0
    if number == CRASHING:
        os.kill(os.getpid(), signal.SIGSEGV)
    return number


def stage_on_a_full_disk(number: int) -> int:
    if number == FULL:
        raise ArtifactError("out/s: expected to write this file, found no space left on device")
    return number
