"""A build may be killed at any moment: the next one goes on and ends the same, bit for bit."""

import json
import os
import shutil
import signal
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from tests.killed_builds import (
    NASTY_NAMES,
    SMALL_WORKERS,
    assert_same_contents,
    kill,
    killed_when,
    ostiform,
    started,
    workers_of,
)

pytestmark = pytest.mark.xdist_group("small_results")

KILLS, SEED = int(os.environ.get("KILLS", "25")), int(os.environ.get("SEED", "20"))
COMMANDS = tuple(os.environ.get("COMMANDS", "evaluate build").split())
"""In turn: all but the report, which takes longest, and all."""
SHARE = 0.3
"""Of the time of a whole build, that one runs at most before it is killed."""


def test_a_build_killed_while_embedding_sweeping_and_evaluating_ends_the_same(
    small_study, small_results, tmp_path
):
    output, log = tmp_path / "out", tmp_path / "log"
    arguments = ("evaluate", small_study, "-o", output, "-w", SMALL_WORKERS, "-v")
    for sign in (
        ".ostiform/embeddings/*.json",
        ".ostiform/unfinished/correspondence-level-2.bin.json",
        ".ostiform/unfinished/fold-*.json",
    ):
        assert killed_when(lambda sign=sign: any(output.glob(sign)), log, *arguments), sign
    run = ostiform(*arguments)
    assert run.returncode == 0, run.stderr
    assert not any((output / "unfinished").glob("*"))
    assert_same_contents(output, small_results)


def test_sweeps_that_were_finished_are_not_done_again(small_study, small_results, tmp_path):
    output, log = tmp_path / "out", tmp_path / "log"
    arguments = ("correspond", small_study, "-o", output, "-w", SMALL_WORKERS, "-v")
    first_level = output / ".ostiform" / "unfinished" / "correspondence-level-1.bin.json"
    assert killed_when(first_level.is_file, log, *arguments)
    run = ostiform(*arguments)
    assert run.returncode == 0, run.stderr
    assert "goes on after level" in run.stderr
    assert "level 1 sweep 1:" not in run.stderr
    history = json.loads((output / "correspondence.json").read_text())["history"]
    expected = json.loads((small_results / "correspondence.json").read_text())["history"]
    assert [item["objective"] for item in history] == [item["objective"] for item in expected]


def test_a_worker_that_is_killed_changes_nothing(small_study, small_results, tmp_path):
    output, log = tmp_path / "out", tmp_path / "log"
    with started(log, "embed", small_study, "-o", output, "-w", SMALL_WORKERS, "-v") as process:
        while process.poll() is None and not any((output / "opened").glob("*.bin")):
            time.sleep(0.01)
        for worker in workers_of(process):
            kill(worker)
        assert process.wait() == 0, log.read_text()
    assert "left out" not in log.read_text()
    embeddings = tmp_path / "expected"
    (embeddings / "embeddings").mkdir(parents=True)
    (tmp_path / "found").mkdir()
    (output / "embeddings").rename(tmp_path / "found" / "embeddings")
    for path in (small_results / "embeddings").iterdir():
        (embeddings / "embeddings" / path.name).write_bytes(path.read_bytes())
    assert_same_contents(tmp_path / "found", embeddings)


def test_names_from_files_stay_in_their_place(small_study, small_results, tmp_path):
    shutil.copytree(small_results, tmp_path / "inner" / "out")
    run = ostiform("build", small_study, "-o", tmp_path / "inner" / "out", "-w", 1)
    assert run.returncode == 0, run.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["inner"]
    assert [path.name for path in (tmp_path / "inner").iterdir()] == ["out"]
    page = (tmp_path / "inner" / "out" / "report.html").read_text("utf-8")
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in page
    assert NASTY_NAMES[1] not in page
    for picture in (tmp_path / "inner" / "out" / "figures").glob("*.svg"):
        assert "<script" not in picture.read_text("utf-8")


@pytest.mark.long
def test_builds_killed_at_random_moments_end_the_same(small_study, tmp_path, record_property):
    log, expected, seconds = tmp_path / "log", {}, {}
    for command in COMMANDS:  # the second goes on where the first ended
        arguments = (command, small_study, "-w", SMALL_WORKERS, "-v")
        start = time.monotonic()
        with started(log, *arguments, "-o", tmp_path / "whole") as process:
            assert process.wait() == 0, log.read_text()
        seconds[command] = time.monotonic() - start + sum(seconds.values())
        expected[command] = tmp_path / command
        shutil.copytree(tmp_path / "whole", expected[command])
    rng = np.random.default_rng(SEED)
    hit: Counter[str] = Counter()
    builds = 0
    while hit.total() < KILLS:
        command, output = COMMANDS[builds % len(COMMANDS)], tmp_path / f"out{builds}"
        arguments = (command, small_study, "-w", SMALL_WORKERS, "-v")
        builds += 1
        is_done = False
        while not is_done:
            is_done = killed_or_done(arguments, output, log, seconds[command], rng, hit)
        assert_same_contents(output, expected[command])
        shutil.rmtree(output)
        print(f"{hit.total()} kills in {builds} builds:", dict(hit), flush=True)  # noqa: T201
    record_property("kills", dict(hit))


def killed_or_done(arguments, output, log, seconds, rng, hit) -> bool:
    """Go on with a build, kill it at a random moment, and say whether it is whole.

    The moment is counted from its first word on, and within a share of what a whole build takes:
    a build is killed several times on its way, in all of its stages, not begun anew each time.
    Every third time a worker is killed before.
    """
    of_worker = bool(rng.random() < 0.33)
    moments = np.sort(rng.uniform(0.0, SHARE * seconds, 2))
    with started(log, *arguments, "-o", output) as process:
        while process.poll() is None and not stages(log):
            time.sleep(0.02)
        begin = time.monotonic()
        for moment, worker in zip(moments, (True, False), strict=True):
            while process.poll() is None and time.monotonic() < begin + moment:
                time.sleep(0.02)
            victims = workers_of(process) if worker else [process.pid]
            if process.poll() is not None or not victims or hit.total() >= KILLS:
                continue
            if of_worker or not worker:
                kill(victims[0])
                stage = (stages(log) or ["start"])[-1]
                hit[f"{stage}{' (a worker)' if worker else ''}"] += 1
        code = process.wait()
        assert code in (0, -signal.SIGKILL), log.read_text()
        return code == 0


def stages(log: Path) -> list[str]:
    """Return the stage of every line that a build wrote with ``-v``."""
    lines = log.read_text("utf-8", "replace").splitlines()
    return [line.split()[0] for line in lines if "/" in line and ":" in line and line[0].islower()]
