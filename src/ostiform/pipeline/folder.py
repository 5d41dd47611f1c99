"""Taking an output folder into use: by one run at a time, within its own walls."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ostiform.atomic import remove_leftovers
from ostiform.errors import ArtifactError, InputError
from ostiform.pipeline.store import RECORDS

LOCK = "lock"


@contextmanager
def taken(root: Path) -> Iterator[None]:
    """Keep an output folder to this process while the block runs.

    The folder is made if it is missing. The lock is the operating system's on the file
    ``.ostiform/lock``, which also holds the process number for people to read: it ends with the
    process, so there are no stale locks. Temporary files of killed runs are removed. Where the
    system has no such locks (Windows) nothing is locked.

    Raises
    ------
    InputError
        If there is a file in the folder's place.
    ArtifactError
        If another run uses the folder, it cannot be written, or a link in it leads out of it.
    """
    if root.exists() and not root.is_dir():
        raise InputError(f"{root}: expected a folder for the results, found a file")
    path = root / RECORDS / LOCK
    _refuse_links(root)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o666)
    except OSError as error:
        raise ArtifactError(
            f"{root}: expected a folder to write results to, found that "
            f"{error.strerror or error}; make it writable or choose another output folder "
            "(what was there is unchanged)"
        ) from error
    try:
        _lock(handle, root)
        remove_leftovers(root)
        _sign(handle, root)
        yield
    finally:
        os.close(handle)


def _lock(handle: int, root: Path) -> None:
    if sys.platform == "win32":
        return
    import fcntl

    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        holder = os.read(handle, 20).decode("ascii", "replace").strip() or "unknown"
        raise ArtifactError(
            f"{root}: expected an output folder that no other run uses, found that process "
            f"{holder} is writing to it; wait for it to end, or choose another output folder"
        ) from None


def _sign(handle: int, root: Path) -> None:
    try:
        os.ftruncate(handle, 0)
        os.pwrite(handle, f"{os.getpid()}\n".encode(), 0)
    except OSError as error:
        raise ArtifactError(
            f"{root}: expected to write there, found that {error.strerror or error}; free some "
            "space or choose another output folder (what was there is unchanged)"
        ) from error


def _refuse_links(root: Path) -> None:
    """Refuse folders that lead out of the output folder; a file that is a link gets replaced."""
    inside = root.resolve()
    for parent, folders, _ in os.walk(root):
        for name in folders:
            path = Path(parent, name)
            if path.is_symlink() and not path.resolve().is_relative_to(inside):
                raise ArtifactError(
                    f"{path}: expected a folder of results, found a link that leads out of the "
                    f"output folder to {path.resolve()}; remove the link"
                )
