"""Fixtures shared by all tests."""

import os
from collections.abc import Iterator
from pathlib import Path

import hypothesis
import numpy as np
import pytest

# How long an example takes says nothing on a machine that does other work too.
hypothesis.settings.register_profile("any machine", deadline=None)
hypothesis.settings.load_profile("any machine")

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20041)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of real test surfaces beside the repository."""
    if not SHARED_DATA.is_dir():
        pytest.skip(f"real test surfaces not found at {SHARED_DATA}")
    return SHARED_DATA


@pytest.fixture(scope="session")
def example_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Results of the example study, built once; tests that use it join the xdist group "example".

    They lie in the folder that OSTIFORM_CACHE names, where it is set, else in one of this session.
    """
    import ostiform

    with pytest.MonkeyPatch.context() as patch:
        if "OSTIFORM_CACHE" not in os.environ:
            patch.setenv("OSTIFORM_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield ostiform.example_results()


@pytest.fixture(scope="session")
def small_study(tmp_path_factory) -> Path:
    """Give a study of four coarse left hearts with nasty names, built in seconds."""
    from tests.killed_builds import write_small_study

    return write_small_study(tmp_path_factory.mktemp("small"))


@pytest.fixture(scope="session")
def small_results(small_study, tmp_path_factory) -> Path:
    """Give its results up to the evaluation; tests that use them share a group of pytest-xdist."""
    from tests.killed_builds import SMALL_WORKERS, ostiform

    output = tmp_path_factory.mktemp("small_results") / "out"
    run = ostiform("evaluate", small_study, "-o", output, "-w", SMALL_WORKERS)
    if run.returncode != 0:
        raise RuntimeError(f"exit code {run.returncode}: {run.stderr}")
    return output
