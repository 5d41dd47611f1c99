"""Kernels are compiled by one process and loaded by the others, also where all start at once."""

import os
import subprocess
import sys

MODULE = """
from ostiform.compiled import kernel

@kernel
def inner(x):
    return x + 1.0

@kernel(error_model="numpy")
def outer(x):
    return inner(x) / 2.0
"""

CALL = """
from numba.core import event
found = []
with event.install_listener("numba:compile", event.RecordingListener()) as listener:
    from loops import outer
    assert outer(3.0) == 2.0
print(sum(at.is_start and at.data["dispatcher"].py_func.__module__ == "loops"
          for _, at in listener.buffer))
"""


def test_kernels_that_two_processes_want_at_once_are_compiled_by_one(tmp_path):
    (tmp_path / "loops.py").write_text(MODULE)
    paths = os.pathsep.join([str(tmp_path), *sys.path])
    environment = {**os.environ, "PYTHONPATH": paths, "NUMBA_CACHE_DIR": str(tmp_path / "kept")}
    runs = [
        subprocess.Popen(
            [sys.executable, "-c", CALL], env=environment, stdout=subprocess.PIPE, text=True
        )
        for _ in range(3)
    ]
    compiled = [int(run.communicate(timeout=120)[0]) for run in runs]
    assert [run.returncode for run in runs] == [0, 0, 0]
    assert sum(compiled) == 2  # inner and outer, once each
