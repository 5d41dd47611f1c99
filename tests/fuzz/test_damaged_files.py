"""Damaged files of every kind: a reader refuses them with an error of Ostiform, or reads them.

Longer: ``python -m tests.fuzz --cases 1000``.
"""

import os
import signal
from collections.abc import Mapping
from pathlib import Path

import pytest

from ostiform.errors import InputError
from tests.fuzz.campaign import Finding, case_content, run_apart, run_case, run_here
from tests.fuzz.targets import Target, make_targets

CASES = range(25)
FEWEST_READERS = 25


@pytest.fixture(scope="module")
def targets(tmp_path_factory) -> Mapping[str, Target]:
    return make_targets(tmp_path_factory.mktemp("sound"))


def test_every_reader_reads_the_sound_files(targets, tmp_path):
    assert len(targets) >= FEWEST_READERS
    for target in targets.values():
        for content in target.seeds:
            folder = tmp_path / target.name.replace(" ", "_")
            folder.mkdir(exist_ok=True)
            (folder / target.file).write_bytes(content)
            target.read(folder / target.file)


# Libraries leave files open where they refuse them.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_damaged_files_are_refused_or_read_by_every_reader(targets, tmp_path):
    tally = run_here(list(targets.values()), CASES, tmp_path)
    assert tally.findings == []
    for name in targets:
        refused, read = (tally.outcomes[name, outcome] for outcome in ("refused", "read"))
        assert refused + read == len(CASES)
        assert refused > 0 or name == "record json"  # which is believed or not, never refused


def test_a_case_is_the_same_file_wherever_it_is_made(targets):
    for target in targets.values():
        for case in range(3):
            if "h5" not in target.name:  # its library writes the time and unused bytes
                assert case_content(target, case) == case_content(target, case)


def fails(path: Path) -> None:
    raise KeyError(path.name)


def hangs(_: Path) -> None:
    while True:
        pass


def crashes(_: Path) -> None:
    os.kill(os.getpid(), signal.SIGSEGV)


def refuses(path: Path) -> None:
    raise InputError(f"{path}: expected something else")


def chatters(path: Path) -> None:
    raise InputError(f"{path}: {'word ' * 2000}")


def bad_targets(_: Path) -> Mapping[str, Target]:
    """Readers that are wrong in every way that a campaign must notice."""
    readers = (fails, crashes, refuses)
    return {r.__name__: Target(r.__name__, "file", (b"12 34",), r) for r in readers}


@pytest.mark.parametrize(
    ("reader", "what"), [(fails, "KeyError"), (hangs, "hang"), (chatters, "thousands of letters")]
)
def test_errors_of_others_hangs_and_endless_messages_are_noticed(reader, what, tmp_path):
    finding = run_case(Target("reader", "file", (b"12 34",), reader), 0, tmp_path, 0.2)
    assert isinstance(finding, Finding)
    assert what in finding.what


def test_a_crash_is_noticed_and_the_campaign_goes_on(tmp_path):
    names = ["refuses", "crashes", "fails"]
    tally = run_apart(names, range(2), tmp_path, bad_targets)
    assert tally.outcomes == {
        ("refuses", "refused"): 2,
        ("crashes", "failed"): 2,
        ("fails", "failed"): 2,
    }
    assert {finding.what.split()[0] for finding in tally.findings} == {"crash", "KeyError"}
