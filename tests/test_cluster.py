"""The same work on a Dask cluster of real processes, whatever becomes of its workers."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from ostiform import execution
from ostiform.errors import InputError, OstiformError
from ostiform.execution import ClusterWorkers, cluster
from ostiform.model import read_correspondence
from ostiform.pipeline import Progress, Stage, build_study
from tests.test_execution import always_killed, doubled, killed_once, slow

distributed = pytest.importorskip("distributed")

pytestmark = pytest.mark.xdist_group("small_results")

KINDS = ("conformal", "euclidean", "optimal")


@pytest.fixture(scope="module")
def local():
    """Give two worker processes, started again by their nannies when they are killed."""
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        dashboard_address=":0",
        silence_logs=50,
    ) as started:
        yield started


def pids(address):
    with distributed.Client(address) as client:
        return [facts["pid"] for facts in client.run(process_facts).values()]


def process_facts():
    return {"pid": os.getpid(), "threads": os.environ.get("OPENBLAS_NUM_THREADS")}


def total(item, first, second):
    return item + float(first.sum()) + second


def is_read_only(_, array):
    return not array.flags.writeable


def test_every_item_has_one_outcome_and_failures_are_kept_apart(local):
    with ClusterWorkers(local.scheduler_address) as workers:
        assert workers.count == 2
        outcomes = sorted(workers.each(doubled, [1, -1, 3]), key=lambda outcome: outcome.index)
        assert list(workers.each(doubled, [])) == []
    assert [outcome.value for outcome in outcomes] == [2, None, 6]
    with pytest.raises(InputError, match="item -1"):
        _ = outcomes[1].result


@pytest.mark.parametrize("kind", [pytest.param("processes", marks=pytest.mark.long), "cluster"])
def test_what_items_share_arrives_as_it_was(local, kind):
    shared = np.arange(5.0)
    shared.flags.writeable = False
    workers = (
        execution.Workers(2) if kind == "processes" else ClusterWorkers(local.scheduler_address)
    )
    with workers:
        found = {o.index: o.value for o in workers.each(total, [1.0, 2.0, 3.0], shared, 0.5)}
        kept = [o.value for o in workers.each(is_read_only, [0, 1, 2], shared)]
    assert found == {0: 11.5, 1: 12.5, 2: 13.5}
    assert kept == [True] * 3


def test_a_killed_worker_costs_only_what_it_was_at(local, tmp_path):
    markers = [str(tmp_path / name) for name in "abcd"]
    for name in "bcd":
        (tmp_path / name).write_text("done")
    with ClusterWorkers(local.scheduler_address) as workers:
        found = {outcome.index: outcome.value for outcome in workers.each(killed_once, markers)}
    assert found == dict(enumerate("abcd"))


@pytest.mark.long
def test_an_item_that_kills_every_worker_fails_and_costs_no_other(local):
    with ClusterWorkers(local.scheduler_address) as workers:
        [outcome] = workers.each(always_killed, [1])
    with pytest.raises(OstiformError, match="several were killed at it"):
        _ = outcome.result


def test_the_model_is_that_of_one_process_though_workers_are_killed_in_mid_sweep(
    local, small_study, small_results, tmp_path
):
    killed = []

    def kill_at_sweeps(event):
        in_sweep = isinstance(event, Progress) and event.stage == "correspond" and event.done > 1
        if in_sweep and len(killed) < 2:
            victim = pids(local.scheduler_address)[0]
            os.kill(victim, signal.SIGKILL)
            killed.append(victim)

    build_study(
        small_study,
        tmp_path / "out",
        until=Stage.CORRESPOND,
        scheduler=local.scheduler_address,
        on_event=kill_at_sweeps,
    )
    assert len(killed) == 2
    for kind in KINDS:
        found = read_correspondence(tmp_path / "out" / kind / "correspondence.h5")
        expected = read_correspondence(small_results / kind / "correspondence.h5")
        for name in ("points", "aligned", "directions", "weights"):
            np.testing.assert_allclose(
                getattr(found, name), getattr(expected, name), rtol=0.0, atol=1e-9
            )
    assert not any((tmp_path / "out" / "unfinished").glob("*"))


def test_a_scheduler_that_does_not_answer_is_said_in_one_sentence(
    monkeypatch, tmp_path, small_study
):
    monkeypatch.setattr(cluster, "ANSWER_SECONDS", 1)
    with pytest.raises(InputError, match="answers within 1 s, found none; start one"):
        build_study(small_study, tmp_path / "out", scheduler="tcp://127.0.0.1:9")
    with pytest.raises(InputError, match="expected a Dask scheduler"):
        build_study(small_study, tmp_path / "out", scheduler="nonsense://x")


def test_without_dask_the_error_says_what_to_install(monkeypatch, tmp_path, small_study):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"pip install 'ostiform\[dask\]'"):
        build_study(small_study, tmp_path / "out", scheduler="tcp://127.0.0.1:8786")


def test_workers_of_another_version_or_without_the_folder_are_refused(local, monkeypatch, tmp_path):
    with ClusterWorkers(local.scheduler_address) as workers:
        workers.check(tmp_path)
        with pytest.raises(InputError, match="a file system that all machines share"):
            workers.check(tmp_path / "missing")
        monkeypatch.setattr(cluster, "__version__", "0.0.1")
        with pytest.raises(InputError, match=r"expected Ostiform 0\.0\.1 as here"):
            workers.check(tmp_path)


def test_a_scheduler_without_workers_is_said_in_one_sentence(monkeypatch):
    monkeypatch.setattr(cluster, "WORKER_SECONDS", 1)
    with (
        distributed.LocalCluster(
            n_workers=0, processes=False, dashboard_address=":0", silence_logs=50
        ) as empty,
        pytest.raises(InputError, match="at least 1 worker within 1 s"),
        ClusterWorkers(empty.scheduler_address),
    ):
        pass


@pytest.mark.long
def test_a_scheduler_that_is_lost_ends_the_run_in_one_sentence(tmp_path):
    told = tmp_path / "address"
    program = Path(__file__).with_name("lost_scheduler.py")
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])}
    process = subprocess.Popen(
        [sys.executable, program, told], start_new_session=True, env=environment
    )
    try:
        while not (told.is_file() and told.read_text()) and process.poll() is None:
            time.sleep(0.1)
        with ClusterWorkers(told.read_text()) as workers:
            outcomes = workers.each(slow, [0.1, 60.0, 60.0])
            assert next(outcomes).value is not None
            os.killpg(process.pid, signal.SIGKILL)
            with pytest.raises(OstiformError, match="run the same command again"):
                next(outcomes)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
