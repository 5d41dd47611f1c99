"""Results are never lost, never trusted blindly, and never written anywhere else."""

import ast
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import ostiform
from ostiform.artifacts import load, save
from ostiform.correspondence import Checkpoint
from ostiform.embedding import Embeddings
from ostiform.errors import ArtifactError, InputError, OstiformError
from ostiform.execution import Workers
from ostiform.pipeline.events import Warn
from ostiform.pipeline.folder import locked
from ostiform.pipeline.run import Run, over_shapes
from ostiform.pipeline.store import Store
from ostiform.study import Shape, ShapeId
from ostiform.surface import Surface
from tests.killed_builds import (
    assert_same_contents,
    command,
    contents,
)
from tests.killed_builds import ostiform as run_ostiform
from tests.pipeline_of_many import BROKEN, CRASHING, FULL, UNFORESEEN, light_stage
from tests.pipeline_of_many import stage_on_a_full_disk as full_disk_stage

pytestmark = pytest.mark.xdist_group("small_results")

NOBODY = 65534
RECORDS = ".ostiform"


@pytest.fixture
def copy(small_results, tmp_path) -> Path:
    return shutil.copytree(small_results, tmp_path / "out")


def artifacts(output: Path) -> list[str]:
    return [
        path.relative_to(output).as_posix()
        for path in sorted(output.rglob("*"))
        if path.is_file() and RECORDS not in path.parts
    ]


def key_of_record(output: Path, name: str) -> str:
    return Store(output)._record(name)["key"]


def flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-1])


def test_every_artifact_has_a_record_and_one_flipped_bit_is_noticed(copy):
    store = Store(copy)
    for name in artifacts(copy):
        key = key_of_record(copy, name)
        assert store.is_current(name, key), name
        flip(store.path(name))
        assert not store.is_current(name, key), name
        flip(store.path(name))
        assert store.is_current(name, key), name
        cut(store.path(name))
        assert not store.is_current(name, key), name


def test_damaged_artifacts_of_every_kind_are_made_again(small_study, small_results, copy):
    """Per folder and suffix one file is flipped, one cut, one replaced by its sibling's."""
    kinds: dict[tuple[str, str], list[str]] = {}
    for name in artifacts(copy):
        path = Path(name)
        kinds.setdefault((path.parent.as_posix(), path.suffix), []).append(name)
    for members in kinds.values():
        if len(members) > 2:  # with its record: another shape's artifact in this one's place
            for folder in (copy, copy / RECORDS):
                suffix = "" if folder == copy else ".json"
                shutil.copy(folder / (members[1] + suffix), folder / (members[2] + suffix))
        flip(copy / members[0])
        if len(members) > 1:
            cut(copy / members[1])
    run = run_ostiform("evaluate", small_study, "-o", copy, "-w", 1)
    assert run.returncode == 0, run.stderr
    assert_same_contents(copy, small_results)


def test_results_of_an_older_layout_are_made_again(small_study, small_results, copy):
    for record in (copy / RECORDS).rglob("*.json"):
        record.write_text(record.read_text().replace('"schema": 1', '"schema": 0'))
    assert any((copy / "shapes").glob("*.bin"))
    run = run_ostiform("embed", small_study, "-o", copy, "-w", 1, "-v")
    assert run.returncode == 0, run.stderr
    for folder in ("opened", "shapes", "embeddings"):
        (kept, made) = (
            {name: item for name, item in contents(output).items() if name.startswith(folder)}
            for output in (small_results, copy)
        )
        assert kept == made
        for path in (copy / RECORDS / folder).rglob("*.json"):
            assert '"schema": 1' in path.read_text()


def test_results_of_another_study_are_not_used(small_study, small_results, copy, tmp_path):
    other = shutil.copytree(small_study.parent, tmp_path / "other")
    for part in ("LA", "LV"):  # another study gives the same names to other hearts
        first, second = sorted((other / "shapes").glob(f"*{part}*.vtp"))[:2]
        content = first.read_bytes()
        first.write_bytes(second.read_bytes())
        second.write_bytes(content)
    run = run_ostiform("embed", other / small_study.name, "-o", copy, "-w", 1)
    assert run.returncode == 0, run.stderr
    before, after = contents(small_results), contents(copy)
    shapes = [name for name in before if name.startswith("shapes/")]
    assert sum(before[name] != after[name] for name in shapes) == 2


def test_an_npz_with_a_pickle_runs_nothing(tmp_path):
    class Malicious:
        def __reduce__(self):
            return os.system, (f"touch {tmp_path / 'ran'}",)

    path = tmp_path / "evil.npz"
    array = np.array([Malicious()], dtype=object)
    facts = np.frombuffer(b'{"kind": "embeddings", "schema": 1}', np.uint8)
    np.savez(path, facts=facts, **{"0.vertices": array})  # type: ignore[arg-type]
    np.load(path, allow_pickle=True)["0.vertices"]
    assert (tmp_path / "ran").is_file()  # the trap works
    (tmp_path / "ran").unlink()
    for kind in (Embeddings, Checkpoint):
        with pytest.raises(ArtifactError, match="expected the .* that an earlier stage wrote"):
            load(path, kind)
    assert not (tmp_path / "ran").exists()


FORBIDDEN_CALLS = {"eval", "exec", "compile", "__import__", "system", "popen", "literal_eval"}
FORBIDDEN_MODULES = {"pickle", "cPickle", "dill", "marshal", "shelve", "subprocess", "yaml"}


def test_no_source_file_can_run_what_a_file_says():
    for path in sorted(Path(ostiform.__file__).parent.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Import | ast.ImportFrom):
                names = [alias.name for alias in node.names] + [getattr(node, "module", "") or ""]
                assert not FORBIDDEN_MODULES & {name.partition(".")[0] for name in names}, path
                from_os = getattr(node, "module", "") == "os"
                assert not (from_os and FORBIDDEN_CALLS & {*names}), path
            elif isinstance(node, ast.Call):
                called = node.func
                if isinstance(called, ast.Name):
                    is_term = called.id == "system"  # of the objective; never imported from os
                    assert is_term or called.id not in FORBIDDEN_CALLS, (path, node.lineno)
                elif isinstance(called, ast.Attribute):
                    is_pattern = called.attr == "compile"  # of a regular expression
                    of_os = isinstance(called.value, ast.Name) and called.value.id == "os"
                    is_term = called.attr == "system" and not of_os  # of the objective
                    is_allowed = is_pattern or is_term or called.attr not in FORBIDDEN_CALLS
                    assert is_allowed, (path, node.lineno)
                for keyword in node.keywords:
                    pickles = keyword.arg == "allow_pickle" and not (
                        isinstance(keyword.value, ast.Constant) and keyword.value.value is False
                    )
                    assert not pickles, (path, node.lineno)


def test_a_link_out_of_the_results_folder_is_refused(small_study, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "shapes").symlink_to(tmp_path / "elsewhere", target_is_directory=True)
    run = run_ostiform("embed", small_study, "-o", tmp_path / "out", "-w", 1)
    assert run.returncode == 6
    assert "leads out of the output folder" in run.stderr
    assert "Traceback" not in run.stderr
    assert list((tmp_path / "elsewhere").iterdir()) == []


def test_an_artifact_is_never_written_through_a_link(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "kept.txt").write_text("kept")
    store = Store(tmp_path / "out")
    store.root.mkdir()
    store.path("a.txt").symlink_to(tmp_path / "elsewhere" / "kept.txt")
    store.write_json("a.txt", "key", 1)
    assert (tmp_path / "elsewhere" / "kept.txt").read_text() == "kept"
    assert not store.path("a.txt").is_symlink()
    store.path("folder").symlink_to(tmp_path / "elsewhere", target_is_directory=True)
    for name in ("folder/a.txt", "../escaped.txt"):
        with pytest.raises(ArtifactError, match="expected to write within"):
            store.write_json(name, "key", 1)
    assert [path.name for path in (tmp_path / "elsewhere").iterdir()] == ["kept.txt"]


def test_one_run_at_a_time_uses_an_output_folder(tmp_path):
    with locked(tmp_path / "out"):
        with pytest.raises(ArtifactError, match=f"process {os.getpid()} is writing to it"):  # noqa: SIM117
            with locked(tmp_path / "out"):
                pass
    with locked(tmp_path / "out"):
        pass


def test_the_lock_of_a_killed_run_is_no_lock(tmp_path):
    program = (
        "import os, signal, sys\n"
        "from pathlib import Path\n"
        "from ostiform.pipeline.folder import locked\n"
        "with locked(Path(sys.argv[1])):\n"
        "    Path(sys.argv[1], '.writing-half.npz').write_text('half')\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    ended = subprocess.run([sys.executable, "-c", program, tmp_path / "out"], check=False)
    assert ended.returncode < 0
    assert (tmp_path / "out" / RECORDS / "lock").is_file()
    with locked(tmp_path / "out"):
        assert not (tmp_path / "out" / ".writing-half.npz").exists()


def test_a_second_build_into_the_same_folder_is_refused_and_harms_nothing(small_study, copy):
    files = [path for path in copy.rglob("*") if path.is_file() and path.name != "lock"]
    before = {path: path.read_bytes() for path in files}
    with locked(copy):
        second = run_ostiform("embed", small_study, "-o", copy, "-w", 1)
        assert second.returncode == 6
        assert f"process {os.getpid()} is writing to it" in second.stderr
        assert "Traceback" not in second.stderr
    for path, content in before.items():
        assert path.read_bytes() == content


def run_of_many(store: Path, on_error: str, workers: Workers, heard: list[str]) -> Run:
    settings = SimpleNamespace(shapes=SimpleNamespace(on_error=on_error))

    def on_event(event) -> None:
        if isinstance(event, Warn):
            heard.append(event.text)

    return Run(SimpleNamespace(settings=settings), Store(store), workers, on_event)  # type: ignore[arg-type]


MANY = list(range(500))
IDS = [ShapeId(f"s{number}", "0", 0.0) for number in MANY]


def test_broken_shapes_among_500_are_left_out_and_named(tmp_path):
    heard: list[str] = []
    with Workers(2) as workers:
        run = run_of_many(tmp_path, "skip", workers, heard)
        found, failures = over_shapes(run, "embed", light_stage, MANY, IDS)
    lost = {BROKEN, UNFORESEEN, CRASHING}
    assert [number for number, value in enumerate(found) if value is None] == sorted(lost)
    assert {failure.id for failure in failures} == {IDS[number] for number in lost}
    assert len(heard) == 3
    for failure, words in zip(
        failures, ("half of one", "not foreseen", "killed 3 times"), strict=True
    ):
        assert words in failure.reason
        assert str(failure.id) in failure.reason


def test_a_study_may_say_that_the_first_broken_shape_stops_the_run(tmp_path):
    run = run_of_many(tmp_path, "stop", Workers(1), [])
    with pytest.raises(InputError, match="half of one"):
        over_shapes(run, "embed", light_stage, MANY[: BROKEN + 1], IDS)
    with pytest.raises(OstiformError, match=r"not foreseen \(ZeroDivisionError"):
        over_shapes(run, "embed", light_stage, [UNFORESEEN], IDS)


def test_a_full_disk_is_no_shape_s_fault_and_stops_the_run(tmp_path):
    run = run_of_many(tmp_path, "skip", Workers(1), [])
    with pytest.raises(ArtifactError, match="no space left"):
        over_shapes(run, "embed", full_disk_stage, MANY[: FULL + 1], IDS)


def tiny_shape(size: int = 2000) -> Shape:
    points = np.random.default_rng(1).normal(size=(size, 3))
    faces = np.stack([np.arange(size - 2), np.arange(1, size - 1), np.arange(2, size)], axis=1)
    return Shape(ShapeId("s", "0", 0.0), {"A": Surface(points, faces, {})}, (), ("mended",))


@contextmanager
def small_disk(folder: Path, kib: int):
    """Mount a file system of so many KiB; skip where that is not permitted."""
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={kib}k", "tmpfs", str(folder)]
    if shutil.which("mount") is None or subprocess.run(mount, capture_output=True).returncode:
        pytest.skip("mounting a small file system is not permitted here")
    try:
        yield
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def test_a_full_disk_leaves_earlier_artifacts_and_a_later_run_goes_on(
    small_study, small_results, tmp_path
):
    with small_disk(tmp_path / "disk", 700):
        output = tmp_path / "disk" / "out"
        full = run_ostiform("evaluate", small_study, "-o", output, "-w", 1)
        assert full.returncode == 6, full.stderr
        assert "No space left on device" in full.stderr
        assert "Traceback" not in full.stderr
        store, done = Store(output), artifacts(output)
        assert done
        whole = [n for n in done if (r := store._record(n)) and store.is_current(n, r["key"])]
        assert len(whole) >= len(done) - 1  # at most the last one lacks its record
        assert list(output.rglob(".writing-*")) == []
        shutil.copytree(output, tmp_path / "out")
    run = run_ostiform("evaluate", small_study, "-o", tmp_path / "out", "-w", 1)
    assert run.returncode == 0, run.stderr
    assert_same_contents(tmp_path / "out", small_results)


def test_a_file_that_cannot_grow_leaves_the_old_one(tmp_path):
    store, small, large = Store(tmp_path), tiny_shape(50), tiny_shape()
    with store.writing("shape.bin", "old") as path:
        save(path, small)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, before[1]))
    try:
        with (
            pytest.raises(ArtifactError, match="File too large"),
            store.writing("shape.bin", "new") as path,
        ):
            save(path, large)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert store.is_current("shape.bin", "old")
    assert load(store.path("shape.bin"), Shape).repairs == ("mended",)
    assert sorted(path.name for path in tmp_path.iterdir()) == [RECORDS, "shape.bin"]


@contextmanager
def without_rights():
    """Do without the rights of root, who may write everywhere."""
    if os.geteuid() != 0:
        yield
        return
    os.seteuid(NOBODY)
    try:
        yield
    finally:
        os.seteuid(0)


def test_a_read_only_output_folder_is_one_clear_sentence_and_stays_as_it_is():
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o755)
        root = Path(name, "out")
        store = Store(root)
        store.write_json("a.json", "key", 1)
        read_only = [root, root / RECORDS]
        for folder in read_only:
            folder.chmod(0o555)
        with without_rights():
            assert store.is_current("a.json", "key")
            with pytest.raises(ArtifactError, match="Permission denied"), locked(root):
                pass
            with pytest.raises(ArtifactError, match="expected to write this file"):
                store.write_json("a.json", "new key", 2)
            with pytest.raises(ArtifactError, match="expected to remove"):
                store.remove("a.json")
        for folder in read_only:
            folder.chmod(0o755)
        assert store.is_current("a.json", "key")
        store.write_json("a.json", "new key", 2)
        assert store.is_current("a.json", "new key")


BUSY = """
import sys
from pathlib import Path
import numba
from ostiform.execution import Workers

@numba.njit
def long_loop(steps):
    total = 0.0
    for step in range(steps):
        total += (step % 7) ** 0.5
    return total

def busy(marker):
    long_loop(10)
    Path(marker).write_text("busy")
    return long_loop(10**15)

if __name__ == "__main__":
    with Workers(2) as workers:
        list(workers.each(busy, sys.argv[1:]))
"""


def test_ctrl_c_ends_workers_in_the_midst_of_compiled_code(tmp_path):
    (tmp_path / "busy.py").write_text(BUSY)
    markers = [tmp_path / "one", tmp_path / "two"]
    with subprocess.Popen(
        [sys.executable, tmp_path / "busy.py", *markers],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=hear_interrupts,
    ) as process:
        while process.poll() is None and not all(marker.is_file() for marker in markers):
            time.sleep(0.02)
        os.killpg(process.pid, signal.SIGINT)
        _, errors = process.communicate(timeout=120)  # the loops would take years
    assert "KeyboardInterrupt" in errors
    assert errors.count("Traceback") == 1  # the workers say nothing
    while running_in_group(process.pid):  # the test ends only if they do
        time.sleep(0.05)


def hear_interrupts() -> None:
    """Undo what a shell does to the commands that it starts in the background."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def running_in_group(group: int) -> list[int]:
    """Return the processes of a group that have not ended (Linux; elsewhere none)."""
    found = []
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, its_group = status.read_text().rpartition(")")[2].split()[:3]
        except OSError:
            continue
        if int(its_group) == group and state != "Z":
            found.append(int(status.parent.name))
    return found


def test_ctrl_c_stops_a_build_and_says_how_to_go_on(small_study, tmp_path):
    output = tmp_path / "out"
    with subprocess.Popen(
        command("build", small_study, "-o", output, "-w", 2),
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=hear_interrupts,
    ) as process:
        while process.poll() is None and not any((output / "shapes").glob("*.bin")):
            time.sleep(0.02)
        os.killpg(process.pid, signal.SIGINT)
        _, errors = process.communicate(timeout=120)
    assert process.returncode == 130
    assert "run the same command again to go on" in errors
    assert "Traceback" not in errors
