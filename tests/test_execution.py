import os
import signal
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
