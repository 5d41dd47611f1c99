"""Help waits for no numerical library: command modules take what they use from lazy faces."""

import json
import subprocess
import sys

import pytest

from ostiform.cli import COMMANDS

SLOW = ("numba", "scipy", "vtkmodules", "matplotlib", "h5py", "nibabel", "pydantic", "igl")
SCRIPT = """
import json, sys
from ostiform.cli import application
try:
    application(sys.argv[1])([*sys.argv[1:], "--help"])
except SystemExit:
    pass
print("\\n" + json.dumps(sorted({name.split(".")[0] for name in sys.modules})))
"""


def imported_for_help(command: str) -> set[str]:
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, command], capture_output=True, text=True, check=True
    )
    assert "Usage" in done.stdout
    return set(json.loads(done.stdout.splitlines()[-1]))


@pytest.mark.parametrize("command", sorted(COMMANDS))
def test_the_help_of_a_command_imports_no_slow_library(command):
    assert imported_for_help(command) & set(SLOW) == set()


def test_the_check_bites_on_a_module_that_imports_numbers():
    script = "import ostiform.model.pca, sys; print('scipy' in sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "True"
