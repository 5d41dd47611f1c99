"""What `import ostiform` offers to a notebook."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import ostiform
from ostiform.errors import ArtifactError, InputError
from ostiform.model import ShapeModel

in_one_process = pytest.mark.xdist_group("example")


def fresh(code: str) -> str:
    """Return what a new interpreter prints."""
    command = [sys.executable, "-c", code]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def test_importing_ostiform_imports_no_numerical_library():
    code = "import sys, ostiform; print([n for n in ('numpy', 'vtk', 'numba') if n in sys.modules])"
    assert fresh(code) == "[]"


def test_every_public_name_is_there_and_listed():
    assert set(ostiform.__all__) <= set(dir(ostiform))
    for name in ostiform.__all__:
        assert getattr(ostiform, name)
    with pytest.raises(AttributeError, match="no attribute 'builds'"):
        _ = ostiform.builds


@in_one_process
def test_results_are_read_from_their_folder(example_folder):
    results = ostiform.read_results(str(example_folder))
    assert isinstance(results.model, ShapeModel)
    assert results.summary is None
    assert results.left_out == {}
    assert results.correspondence.points.shape == (15, len(results.model.mean), 3)
    assert results.evaluation.kind == "optimal"
    assert results.evaluated("conformal").kind == "conformal"
    np.testing.assert_array_equal(
        ostiform.read_model(results.model_path).model.mean, results.model.mean
    )


@in_one_process
def test_the_example_is_built_once(example_folder):
    before = (example_folder / "model.h5").stat().st_mtime_ns
    assert ostiform.example_results() == example_folder
    assert (example_folder / "model.h5").stat().st_mtime_ns == before


@in_one_process
def test_a_study_may_be_changed_before_it_is_built(example_folder, tmp_path):
    study = ostiform.read_study(example_folder.parent / "study" / "study.toml")
    events = []
    results = ostiform.build(
        replace(study, entries=study.entries[:2]),
        tmp_path / "out",
        until=ostiform.Stage.EMBED,
        on_event=events.append,
    )
    assert results.summary.shapes == 2
    assert {event.stage for event in events if hasattr(event, "stage")} >= {"read", "embed"}
    with pytest.raises(ArtifactError, match=r"model\.h5, found none"):
        ostiform.read_results(tmp_path / "out")


def test_a_kind_of_model_that_does_not_exist_is_refused(tmp_path):
    with pytest.raises(InputError, match="expected one of conformal, euclidean, optimal"):
        ostiform.Results(tmp_path).stored("best")  # type: ignore[arg-type]


def test_the_list_of_shapes_left_out_is_read_or_refused(tmp_path):
    facts = [{"subject": "S1", "phase": "0", "stage": "read", "reason": "because"}]
    (tmp_path / "failed.json").write_text(json.dumps(facts))
    assert ostiform.Results(tmp_path).left_out == {"S1/0": "because"}
    (tmp_path / "failed.json").write_text("{")
    with pytest.raises(ArtifactError, match="missing or damaged"):
        _ = ostiform.Results(tmp_path).left_out


def test_a_cache_that_cannot_be_written_is_named(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("OSTIFORM_CACHE", str(tmp_path / "file" / "cache"))
    with pytest.raises(ArtifactError, match="OSTIFORM_CACHE"):
        ostiform.example_results()


@pytest.mark.parametrize(
    ("platform", "variables", "expected"),
    [
        ("linux", {"XDG_CACHE_HOME": "/caches"}, "/caches/ostiform"),
        ("darwin", {}, "Library/Caches/ostiform"),
        ("win32", {"LOCALAPPDATA": "/local"}, "/local/ostiform"),
    ],
)
def test_the_cache_lies_where_the_system_keeps_caches(monkeypatch, platform, variables, expected):
    from ostiform.api.example import _cache_folder

    monkeypatch.delenv("OSTIFORM_CACHE", raising=False)
    monkeypatch.setattr(sys, "platform", platform)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert _cache_folder().as_posix().endswith(expected)


def test_a_second_process_that_was_slower_changes_nothing(tmp_path, monkeypatch):
    from ostiform.api import example

    home = tmp_path / "example"
    (home / "results").mkdir(parents=True)
    (home / "results" / "mine").write_text("first")
    monkeypatch.setattr(example, "example_study", lambda folder: folder)
    monkeypatch.setattr(
        example, "build_study", lambda study, output, until: output.mkdir(parents=True)
    )
    example._make(home)
    assert (home / "results" / "mine").read_text() == "first"
    assert [path.name for path in tmp_path.iterdir()] == ["example"]


@in_one_process
@pytest.mark.parametrize(
    "name", ["convergence", "distortion", "evidence", "maps", "paper_maps", "scores", "volumes"]
)
def test_figures_of_the_report_are_matplotlib_figures(name, example_folder):
    figure = getattr(ostiform.figures, name)(ostiform.read_results(example_folder))
    assert isinstance(figure, Figure)
    assert figure.axes


@in_one_process
def test_figures_refuse_what_is_not_there(example_folder):
    results = ostiform.read_results(example_folder)
    with pytest.raises(InputError, match="expected one of S1/00, .* found S9/00"):
        ostiform.figures.maps(results, "S9/00")
    with pytest.raises(InputError, match="expected one of LV, LA, found RV"):
        ostiform.figures.maps(results, part="RV")
    with pytest.raises(InputError, match="index from 0 to"):
        ostiform.figures.mode(results.model, 99)
    with pytest.raises(InputError, match="for 2 titles"):
        ostiform.figures.shapes(results.model, results.model.mean[None], ("a", "b"))


@in_one_process
def test_the_paper_chain_is_that_of_the_shape_asked_for(example_folder):
    results = ostiform.read_results(example_folder)
    titles = []
    for shape in ("S1/00", "S2/01"):
        figure = ostiform.figures.paper_maps(results, shape, "LV")
        titles.append(figure.axes[0].get_title())
    assert [title.split("\n")[1] for title in titles] == ["0 turned over"] * 2


@in_one_process
def test_figures_of_a_model_take_the_model_alone(example_model):
    assert ostiform.figures.mode(example_model, 0, (-1.0, 1.0)).axes
    drawn = ostiform.figures.shapes(example_model, example_model.sample(2), ("a", "b"))
    assert drawn.axes[0].get_title() == "a"


@pytest.fixture
def example_model(example_folder: Path) -> ShapeModel:
    return ostiform.read_results(example_folder).model
