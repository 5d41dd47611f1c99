"""Files that are either written whole or not at all."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ostiform.errors import ArtifactError

PREFIX = ".writing-"
"""Of temporary files, which only a kill leaves behind."""


@contextmanager
def atomically(path: Path) -> Iterator[Path]:
    """Give a temporary path beside `path`, and rename it to `path` when the block succeeds.

    A reader sees the old file or the new one, never a part; after an exception or a kill the old
    file is untouched.

    Parameters
    ----------
    path : Path
        The file to write; its folder is made.

    Yields
    ------
    Path
        An empty temporary file with the same suffix, to be filled.

    Raises
    ------
    ArtifactError
        If the folder cannot be written or the disk is full.
    """
    temporary: Path | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=PREFIX, suffix=path.suffix, dir=path.parent)
        os.close(handle)
        temporary = Path(name)
        yield temporary
        with temporary.open("rb") as written:
            os.fsync(written.fileno())
        temporary.chmod(0o666 & ~_umask())
        temporary.replace(path)
    except OSError as error:
        raise ArtifactError(
            f"{path}: expected to write this file, found that {error.strerror or error}; "
            "free some space or choose another output folder (what was there is unchanged)"
        ) from error
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


def remove_leftovers(folder: Path) -> None:
    """Remove the temporary files that killed programs left below a folder; links are not followed.

    Nobody else may be writing there.

    Raises
    ------
    ArtifactError
        If one cannot be removed.
    """
    for parent, _, names in os.walk(folder):
        for name in names:
            if name.startswith(PREFIX):
                path = Path(parent, name)
                try:
                    path.unlink(missing_ok=True)
                except OSError as error:
                    raise ArtifactError(
                        f"{path}: expected to remove this leftover of a killed run, found that "
                        f"{error.strerror or error}; make the output folder writable or choose "
                        "another one"
                    ) from error


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
