"""A small study that is there whenever an example needs results."""

import os
import shutil
import sys
import tempfile
from os import PathLike
from pathlib import Path

from ostiform import __version__
from ostiform.demo import write_demonstration
from ostiform.errors import ArtifactError
from ostiform.pipeline import Stage, build_study

SUBJECTS = 3
SHAPES = 15
SEED = 2004
EDGE_MM = 4.0
"""About a quarter of the vertices of the demonstration."""
POINTS = 500
CACHE = "OSTIFORM_CACHE"


def example_study(folder: str | PathLike[str]) -> Path:
    """Write a small study of generated, beating left hearts and return its ``study.toml``.

    3 subjects in 5 phases, two parts (LV and LA) of about 800 vertices each that share the
    mitral annulus, and a template of 500 points.

    Parameters
    ----------
    folder : path
        Made if missing.
    """
    study = write_demonstration(Path(folder), SUBJECTS, SHAPES, SEED, EDGE_MM)
    with study.open("a", encoding="utf-8") as stream:
        stream.write(f"\n[template]\npoints = {POINTS}\n")
    return study


def example_results() -> Path:
    """Return the results folder of the small study of `example_study`, built when first needed.

    It lies in the user's cache folder (or in that of the environment variable
    ``OSTIFORM_CACHE``), one per version of Ostiform, with the study beside it; all stages but the
    report are run, which takes about a minute of one core. Delete the folder to have it made again.

    Returns
    -------
    folder : Path
        With ``model.h5``, ``correspondence.h5`` and everything else that `build` writes.

    Raises
    ------
    ArtifactError
        If the cache folder cannot be written.
    """
    home = _cache_folder() / f"example-{__version__}"
    if not (home / "results").is_dir():
        try:
            home.parent.mkdir(parents=True, exist_ok=True)
            _make(home)
        except OSError as error:
            raise ArtifactError(
                f"{home}: expected a cache folder that can be written, found {error}; name "
                f"another in the environment variable {CACHE}"
            ) from error
    return home / "results"


def _make(home: Path) -> None:
    """Build beside the final place and move there: whoever looks sees all of it or nothing."""
    with tempfile.TemporaryDirectory(prefix=f"{home.name}-", dir=home.parent) as temporary:
        made = Path(temporary) / "made"
        build_study(example_study(made / "study"), made / "results", until=Stage.EVALUATE)
        try:
            made.rename(home)
        except OSError:
            if not (home / "results").is_dir():  # else another process was faster
                shutil.rmtree(home, ignore_errors=True)
                made.rename(home)


def _cache_folder() -> Path:
    stated = os.environ.get(CACHE)
    if stated:
        return Path(stated)
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home())) / "ostiform"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "ostiform"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "ostiform"
