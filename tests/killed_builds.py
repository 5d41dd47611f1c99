"""Builds in processes of their own, killed on purpose, and everything that they leave behind."""

import csv
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ostiform.demo.demonstration import write_demonstration

TIMES = ("seconds",)
"""Facts that differ from run to run by nature."""


SMALL_WORKERS = 2
"""Processes that the results of the small study were made with."""

NASTY_NAMES = ("../../escaped", "<script>alert(1)</script>", "/etc/passwd", 'S 4 & "\u5fc3"')
"""Of the subjects of the small study: not one of them may leave its place."""


def write_small_study(folder: Path) -> Path:
    """Write a study whose evaluation takes about 12 s of processor time: 4 coarse left hearts."""
    path = write_demonstration(folder, 4, 4, seed=7, edge_mm=6.0)
    with (folder / "shapes.csv").open(newline="", encoding="utf-8") as stream:
        header, *rows = list(csv.reader(stream))
    column = header.index("subject")
    given = dict(zip([row[column] for row in rows], NASTY_NAMES, strict=True))
    for row in rows:
        row[column] = given[row[column]]
    with (folder / "shapes.csv").open("w", newline="", encoding="utf-8") as stream:
        csv.writer(stream).writerows([header, *rows])
    truth = json.loads((folder / "truth" / "truth.json").read_text("utf-8"))
    for shape, _ in truth["value"]["deformations"]:
        shape["subject"] = given[shape["subject"]]
    (folder / "truth" / "truth.json").write_text(json.dumps(truth), "utf-8")
    text = path.read_text("utf-8").replace(
        "[evaluation]", "[evaluation]\nmodes = 2\nspecificity_samples = 50"
    )
    path.write_text(f"{text}\n[template]\npoints = 200\n\n[correspondence]\nlevels = 3\n", "utf-8")
    return path


def command(*arguments: object) -> list[str]:
    return [sys.executable, "-m", "ostiform", *map(str, arguments)]


def ostiform(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command(*arguments), capture_output=True, text=True, check=False)


@contextmanager
def started(log: Path, *arguments: object) -> Iterator[subprocess.Popen[bytes]]:
    """Give a running command that writes what it says to a file; it is dead afterwards."""
    with log.open("wb") as stream:
        process = subprocess.Popen(
            command(*arguments), stdout=stream, stderr=stream, start_new_session=True
        )
        try:
            yield process
        finally:
            if process.poll() is None:
                process.kill()
            process.wait()


def killed_when(is_due: Callable[[], bool], log: Path, *arguments: object) -> bool:
    """Start a command, kill it with SIGKILL when due, and say whether that came in time."""
    with started(log, *arguments) as process:
        while process.poll() is None:
            if is_due():
                process.kill()
                process.wait()
                return process.returncode == -signal.SIGKILL
            time.sleep(0.002)
    return False


def workers_of(process: subprocess.Popen[bytes]) -> list[int]:
    """Return the worker processes of a running build (Linux)."""
    found = []
    for entry in Path("/proc").iterdir():
        if not entry.name.isdecimal():
            continue
        try:
            parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            words = (entry / "cmdline").read_bytes()
        except OSError:
            continue
        if parent == process.pid and b"spawn_main" in words:
            found.append(int(entry.name))
    return found


def kill(pid: int) -> None:
    try:
        os.kill(pid, signal.SIGKILL)
    except ProcessLookupError:
        return


def contents(output: Path) -> dict[str, Any]:
    """Return what every artifact of an output folder holds, but for processor times.

    The report and its pictures show these, so of them only the names are compared.
    """
    return {
        path.relative_to(output).as_posix(): _content(path)
        for path in sorted(output.rglob("*"))
        if path.is_file() and ".ostiform" not in path.parts
    }


def assert_same_contents(found: Path, expected: Path) -> None:
    """Compare every artifact of two output folders, bit for bit."""
    here, there = contents(found), contents(expected)
    assert list(here) == list(there)
    for name in here:
        assert here[name] == there[name], f"{name} differs"


def _content(path: Path) -> Any:
    if path.suffix == ".bin":
        _, facts, arrays = path.read_bytes().split(b"\n", 2)
        return _without_times(json.loads(facts)), arrays.lstrip(b"\0")
    if path.suffix == ".h5":
        items: dict[str, Any] = {}
        with h5py.File(path) as file:
            file.visititems(lambda name, item: items.update({name: _hdf5_item(item)}))
        return items
    if path.suffix == ".json":
        return _without_times(json.loads(path.read_text("utf-8")))
    if path.name == "report.html" or path.parent.name == "figures":
        return None
    return path.read_bytes()


def _hdf5_item(item: Any) -> Any:
    attributes = {name: np.asarray(value).tolist() for name, value in item.attrs.items()}
    if isinstance(item, h5py.Group):
        return attributes
    values = np.asarray(item[()])
    return attributes, values.tolist() if values.dtype == object else _bits(values)


def _bits(array: np.ndarray) -> tuple[str, tuple[int, ...], bytes]:
    return str(array.dtype), array.shape, array.tobytes()


def _without_times(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _without_times(item) for name, item in value.items() if name not in TIMES}
    return [_without_times(item) for item in value] if isinstance(value, list) else value
