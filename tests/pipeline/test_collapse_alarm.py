"""A run whose model has collapsed ends loudly, with everything written, or warns if told to."""

import shutil

import pytest

from ostiform.cli.running import EXIT_CODES
from ostiform.errors import CollapseError
from ostiform.evaluation import collapse, read_evaluation, signs_of_collapse
from ostiform.pipeline import Stage, build_study
from ostiform.pipeline.events import Warn
from ostiform.pipeline.store import Store

pytestmark = pytest.mark.xdist_group("small_results")


@pytest.fixture
def copied(small_study, small_results, tmp_path):
    """Give a copy of the small study and its results."""
    folder = shutil.copytree(small_study.parent, tmp_path / "study")
    return folder / small_study.name, shutil.copytree(small_results, tmp_path / "out")


@pytest.fixture
def alarmed(monkeypatch):
    """Let the alarm go off for every model."""
    monkeypatch.setattr(collapse, "MOST_WEIGHT_DRIFT", -1.0)


def test_the_small_study_has_not_collapsed(small_results):
    start = read_evaluation(small_results / "conformal" / "evaluation.json")
    for kind in ("euclidean", "optimal"):
        found = read_evaluation(small_results / kind / "evaluation.json")
        assert signs_of_collapse(found, start) == ()
    assert (small_results / "evaluation.csv").exists()


def test_a_collapsed_model_ends_the_run_after_everything_is_written(copied, alarmed):
    study, output = copied
    before = {path: path.stat().st_mtime_ns for path in output.rglob("evaluation.json")}
    with pytest.raises(CollapseError) as raised:
        build_study(study, output, until=Stage.EVALUATE)
    said = str(raised.value)
    assert "the optimal model has collapsed: expected" in said
    assert "found" in said
    assert 'collapse = "warn" in [evaluation]' in said
    assert "\n" not in said
    assert EXIT_CODES[type(raised.value)] == 7
    assert {path: path.stat().st_mtime_ns for path in output.rglob("evaluation.json")} == before


def test_a_collapsed_model_is_a_warning_where_the_study_says_so(copied, alarmed):
    study, output = copied
    text = study.read_text("utf-8")
    study.write_text(text.replace("[evaluation]", '[evaluation]\ncollapse = "warn"'), "utf-8")
    told = []
    before = Store(output).path("optimal/evaluation.json").stat().st_mtime_ns
    build_study(study, output, until=Stage.EVALUATE, on_event=told.append)
    warnings = [event.text for event in told if isinstance(event, Warn)]
    assert any("the optimal model has collapsed" in text for text in warnings)
    # Going on costs nothing again.
    assert Store(output).path("optimal/evaluation.json").stat().st_mtime_ns == before


def test_a_sound_model_ends_without_an_alarm(copied):
    study, output = copied
    told = []
    build_study(study, output, until=Stage.EVALUATE, on_event=told.append)
    assert not any("collapsed" in event.text for event in told if isinstance(event, Warn))
