"""Where compiled kernels are kept when neither the installation nor a home folder can be written.

Numba keeps a kernel beside its source or below the user's cache folder, and raises where it can do
neither, when the module is imported.
"""

import os
import tempfile
from pathlib import Path

VARIABLE = "NUMBA_CACHE_DIR"


def kernels_kept() -> str | None:
    """See to it that kernels can be kept; call before a module with kernels is imported.

    Returns
    -------
    str or None
        A sentence for the user where they go to a folder of this run alone, made here and named in
        the environment, so that processes started later share it.
    """
    if VARIABLE in os.environ or any(map(_is_writable, _usual_folders())):
        return None
    folder = tempfile.mkdtemp(prefix="ostiform-kernels-")
    os.environ[VARIABLE] = folder
    return (
        f"{Path(__file__).parent}: expected to keep compiled kernels here or in the home folder, "
        f"found both read-only: they are compiled for this run alone, in {folder}; set {VARIABLE} "
        "to a folder that lasts"
    )


def _usual_folders() -> list[Path]:
    """Return where Numba looks: beside the source, and the user's cache."""
    user = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA") or "~"
    return [Path(__file__).parent / "__pycache__", Path(os.path.expanduser(user))]


def _is_writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False
