"""Fixtures shared by all tests."""

from pathlib import Path

import numpy as np
import pytest

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
