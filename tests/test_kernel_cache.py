import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import ostiform
from ostiform.kernel_cache import VARIABLE, kernels_kept


@pytest.fixture
def read_only(tmp_path):
    """An installation that keeps nothing, and the environment of a user without a home."""
    package = tmp_path / "installed" / "ostiform"
    shutil.copytree(
        Path(ostiform.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__")
    )
    for folder in (package, *(path for path in package.rglob("*") if path.is_dir())):
        (
            folder / "__pycache__"
        ).touch()  # a file where a folder should be: root cannot write either
    (tmp_path / "home").touch()
    environment = {
        name: text
        for name, text in os.environ.items()
        if name not in (VARIABLE, "XDG_CACHE_HOME", "LOCALAPPDATA")
    }
    places = {"PYTHONPATH": str(package.parent), "HOME": str(tmp_path / "home")}
    return {**environment, **places, "TMPDIR": str(tmp_path), "PYTHONDONTWRITEBYTECODE": "1"}


def run(environment, *words):
    command = [sys.executable, *words]
    return subprocess.run(command, capture_output=True, text=True, env=environment, check=False)


def test_without_a_place_for_kernels_a_module_with_kernels_cannot_be_imported(read_only):
    found = run(read_only, "-c", "import ostiform.embedding.energy")
    assert "cannot cache function" in found.stderr


def test_a_read_only_installation_without_a_home_runs_and_says_so_in_one_line(read_only, tmp_path):
    study = tmp_path / "study.toml"
    found = run(read_only, "-m", "ostiform", "check", str(study), "-w", "1")
    assert found.returncode == 2
    warned, error = found.stderr.splitlines()
    assert warned.startswith("warning: ")
    assert VARIABLE in warned
    assert error.startswith(f"error: {study}")


def test_where_kernels_can_be_kept_nothing_is_changed(monkeypatch, tmp_path):
    monkeypatch.setenv(VARIABLE, str(tmp_path))
    assert kernels_kept() is None
    assert os.environ[VARIABLE] == str(tmp_path)
