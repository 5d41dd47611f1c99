import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from ostiform.errors import InputError, OstiformError
from ostiform.execution import Workers


def doubled(item: int) -> int:
    if item < 0:
        raise InputError(f"item {item}: expected a number not below 0")
    return 2 * item


def killed_once(marker: str) -> str:
    """Kill the process at the first call, return at the second."""
    path = Path(marker)
    if not path.exists():
        path.write_text("killed")
        os.kill(os.getpid(), signal.SIGKILL)
    return path.name


def always_killed(_: int) -> int:
    os.kill(os.getpid(), signal.SIGKILL)
    return 0


def killed_if_odd(item: int) -> int:
    if item % 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return item


def worker_of_worker(pid_file: str) -> int:
    Path(pid_file).write_text(str(os.getpid()))
    time.sleep(600.0)
    return 0


def slow(seconds: float) -> int:
    time.sleep(seconds)
    return os.getpid()


@pytest.mark.parametrize("count", [1, 2])
def test_every_item_has_one_outcome_and_failures_are_kept_apart(count):
    with Workers(count) as workers:
        outcomes = sorted(workers.each(doubled, [1, -1, 3]), key=lambda outcome: outcome.index)
    assert [outcome.value for outcome in outcomes] == [2, None, 6]
    assert isinstance(outcomes[1].error, InputError)
    with pytest.raises(InputError, match="item -1"):
        _ = outcomes[1].result


def test_a_killed_worker_costs_only_its_own_items(tmp_path):
    markers = [str(tmp_path / name) for name in ("a", "b", "c")]
    for name in ("b", "c"):
        (tmp_path / name).write_text("done")
    with Workers(2) as workers:
        found = {outcome.index: outcome.value for outcome in workers.each(killed_once, markers)}
    assert found == {0: "a", 1: "b", 2: "c"}


def test_workers_that_keep_dying_end_in_one_sentence():
    with Workers(2) as workers, pytest.raises(OstiformError, match="run again with fewer workers"):
        list(workers.each(always_killed, [1, 2]))


def test_items_that_crash_their_worker_fail_and_cost_no_other():
    with Workers(2) as workers:
        outcomes = sorted(workers.each(killed_if_odd, [0, 1, 2, 4, 6, 3, 8]), key=lambda o: o.index)
    assert [outcome.value for outcome in outcomes] == [0, None, 2, 4, 6, None, 8]
    for failed in (outcomes[1], outcomes[5]):
        with pytest.raises(OstiformError, match="crash in compiled code"):
            _ = failed.result


def test_workers_end_when_their_parent_is_killed(tmp_path):
    pid_file = tmp_path / "pid"
    program = (
        "from ostiform.execution import Workers\n"
        "from tests.test_execution import worker_of_worker\n"
        "if __name__ == '__main__':\n"
        f"    list(Workers(2).each(worker_of_worker, [{str(pid_file)!r}] * 2))\n"
    )
    (tmp_path / "program.py").write_text(program)
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])}
    with subprocess.Popen([sys.executable, tmp_path / "program.py"], env=environment) as parent:
        while not (pid_file.is_file() and pid_file.read_text()) and parent.poll() is None:
            time.sleep(0.05)
        worker = int(pid_file.read_text())
        parent.kill()
    while is_running(worker):  # the test ends only if the worker does
        time.sleep(0.05)


def is_running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_the_same_processes_serve_several_calls():
    with Workers(2) as workers:
        first = {outcome.value for outcome in workers.each(slow, [0.2] * 4)}
        second = {outcome.value for outcome in workers.each(slow, [0.2] * 4)}
    assert first == second
    assert os.getpid() not in first


def test_an_exception_ends_the_processes_at_once():
    start = time.monotonic()
    with pytest.raises(KeyboardInterrupt), Workers(2) as workers:  # noqa: PT012
        for _ in workers.each(slow, [0.0, 60.0, 60.0]):
            raise KeyboardInterrupt
    assert time.monotonic() - start < 50.0  # the tasks would take a minute
