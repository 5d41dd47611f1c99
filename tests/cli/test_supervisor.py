"""Ctrl-C, the end of the work by the system, and exit codes, where a child process works."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from ostiform.cli.supervisor import RESUME

pytestmark = pytest.mark.skipif(
    sys.platform != "linux", reason="elsewhere the command works in its own process"
)

HEAD = """
import os, signal, sys
from itertools import repeat
from pathlib import Path
from ostiform.cli.supervisor import supervised

def work():
    Path(sys.argv[1]).write_text(str(os.getpid()))
"""
DEAF = "    sum(repeat(0))  # compiled, without an end, and without an ear for signals\n"
POLITE = """
    try:
        while True:
            pass
    except KeyboardInterrupt:
        print("stopping", file=sys.stderr)
        sys.exit(130)
"""


def started(tmp_path, body, **options):
    script = tmp_path / "work.py"
    script.write_text(f"{HEAD}{body}\nsupervised(work)\n")
    return subprocess.Popen(
        [sys.executable, script, tmp_path / "busy"],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
        **options,
    )


def child_of(process, tmp_path):
    """Wait until the child works, and return its number."""
    marker = tmp_path / "busy"
    while process.poll() is None and not (marker.is_file() and marker.read_text()):
        time.sleep(0.02)
    return int(marker.read_text())


def is_running(number):
    status = Path(f"/proc/{number}/stat")
    try:
        return status.read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.parametrize("is_terminal", [True, False])
def test_ctrl_c_ends_compiled_code_and_says_how_to_go_on(tmp_path, is_terminal):
    with started(tmp_path, DEAF) as process:
        child = child_of(process, tmp_path)
        # A terminal tells the whole group, `kill` only the process that is named.
        (os.killpg if is_terminal else os.kill)(process.pid, signal.SIGINT)
        _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert errors == f"{RESUME}\n"
    assert not is_running(child)


@pytest.mark.parametrize("is_terminal", [True, False])
def test_what_can_stop_by_itself_stops_by_itself(tmp_path, is_terminal):
    with started(tmp_path, POLITE) as process:
        child_of(process, tmp_path)
        (os.killpg if is_terminal else os.kill)(process.pid, signal.SIGINT)
        _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert errors == "stopping\n"


def test_work_that_the_system_ends_is_told_in_one_sentence(tmp_path):
    with started(tmp_path, "    os.kill(os.getpid(), signal.SIGKILL)\n") as process:
        _, errors = process.communicate(timeout=60)
    assert process.returncode == 1
    assert errors.startswith("error: expected the work to finish")
    assert "SIGKILL" in errors
    assert errors.count("\n") == 1


@pytest.mark.parametrize("signal_number", [signal.SIGKILL, signal.SIGTERM])
def test_the_work_ends_with_the_process_that_waits_for_it(tmp_path, signal_number):
    with started(tmp_path, DEAF) as process:
        child = child_of(process, tmp_path)
        os.kill(process.pid, signal_number)
        process.wait(timeout=60)
        while is_running(child):  # the test ends only if it does
            time.sleep(0.02)


@pytest.mark.parametrize(("body", "code"), [("    pass\n", 0), ("    sys.exit(6)\n", 6)])
def test_the_exit_code_is_that_of_the_work(tmp_path, body, code):
    with started(tmp_path, body) as process:
        _, errors = process.communicate(timeout=60)
    assert process.returncode == code
    assert errors == ""
