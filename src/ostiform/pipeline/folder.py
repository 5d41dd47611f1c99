"""Taking an output folder into use: by one run at a time, within its own walls."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from ostiform.atomic import remove_leftovers
from ostiform.errors import ArtifactError, InputError
from ostiform.pipeline.store import RECORDS

LOCK = "lock"
HOLDER = "holder"


@contextmanager
def locked(root: Path) -> Iterator[None]:
    """Keep an output folder to this process while the block runs.

    The folder is made if it is missing. The lock is the operating system's on the file
    ``.ostiform/lock``: it ends with the process, so there are no stale locks. Beside it,
    ``holder`` has the number of the process, for people to read. Temporary files of killed runs
    are removed.

    Raises
    ------
    InputError
        If there is a file in the folder's place.
    ArtifactError
        If another run uses the folder, it cannot be written, or a link in it leads out of it.
    """
    if root.exists() and not root.is_dir():
        raise InputError(f"{root}: expected a folder for the results, found a file")
    records = root / RECORDS
    _refuse_links(root)
    # Another lock object of the same process is another run, which must not get in either.
    lock = FileLock(records / LOCK, is_singleton=False, thread_local=False)
    try:
        records.mkdir(parents=True, exist_ok=True)
        lock.acquire(timeout=0)
    except Timeout:
        raise ArtifactError(
            f"{root}: expected an output folder that no other run uses, found that process "
            f"{_holder(records)} is writing to it; wait for it to end, or choose another output "
            "folder"
        ) from None
    except OSError as error:
        raise ArtifactError(
            f"{root}: expected a folder to write results to, found that "
            f"{error.strerror or error}; make it writable or choose another output folder "
            "(what was there is unchanged)"
        ) from error
    try:
        remove_leftovers(root)
        _sign(records, root)
        yield
    finally:
        with suppress(OSError):  # only a name for people, and no lock
            (records / HOLDER).unlink()
        lock.release()


def _holder(records: Path) -> str:
    try:
        return (records / HOLDER).read_text("ascii").strip()[:20] or "unknown"
    except (OSError, UnicodeDecodeError):
        return "unknown"


def _sign(records: Path, root: Path) -> None:
    holder = records / HOLDER
    try:
        holder.unlink(missing_ok=True)  # a link in its place is removed, not followed
        holder.write_text(f"{os.getpid()}\n", "ascii")
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
