"""The report of a finished run is made again from its folder alone."""

import json
import shutil
from dataclasses import replace

import pytest

from ostiform.errors import ArtifactError, InputError
from ostiform.exchange import read_shape_values_csv
from ostiform.pipeline.build import build_study
from ostiform.pipeline.events import Note
from ostiform.pipeline.record import (
    InputFile,
    RunRecord,
    after,
    changed_inputs,
    read_record,
    write_record,
)
from ostiform.pipeline.report import report_results
from ostiform.pipeline.run import Failure, Ready
from ostiform.pipeline.store import Store, file_hash
from ostiform.report.html import FIGURE_NAMES
from ostiform.study import ShapeId
from ostiform.study.settings_file import parsed_settings

FIRST, SECOND = ShapeId("a</script>", "1", 0.0), ShapeId("ä", "2", 0.5)


def record(**changes):
    whole = RunRecord(
        version="0.1.0",
        title="心 & <b>",
        study="study.toml",
        study_sha256="0",
        settings={"parts": {"LV": {}}, "report": {"part": None, "shape": None}},
        entries=3,
        shapes=(Ready(FIRST, "a", "key a"), Ready(SECOND, "b", "key b")),
        failures=(Failure(ShapeId("c", "1", 0.0), "read", "why"),),
        repairs={"a": ("filled a hole",)},
        warnings=("look",),
        seconds={"embed": 5.0},
        files=(InputFile("a/1", "LV", "a.vtp", "0"),),
        domain_key="domain",
        correspondence_key="correspondence",
    )
    return replace(whole, **changes)


def test_a_record_comes_back_as_it_was_written(tmp_path):
    store = Store(tmp_path)
    assert read_record(store) is None
    write_record(store, record())
    assert read_record(store) == record()
    assert record().part_names == ("LV",)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda facts: facts | {"schema": 99},
        lambda facts: {"schema": 1},
        lambda facts: [facts],
        lambda facts: facts | {"shapes": [{"name": "x"}]},
        lambda facts: facts | {"unknown": 1},
    ],
)
def test_a_damaged_record_is_refused_with_what_to_do(tmp_path, spoil):
    store = Store(tmp_path)
    write_record(store, record())
    path = store.path("run.json")
    path.write_text(json.dumps(spoil(json.loads(path.read_text("utf-8")))), "utf-8")
    with pytest.raises(ArtifactError, match=r"run\.json: expected the record of a run.*build"):
        read_record(store)


def test_a_run_that_found_all_done_keeps_what_the_earlier_one_did_and_said():
    now = record(repairs={}, warnings=(), seconds={"embed": 0.1, "report": 2.0})
    kept = after(record(), now)
    assert kept.repairs == {"a": ("filled a hole",)}
    assert kept.warnings == ("look",)
    assert kept.seconds == {"embed": 5.0, "report": 2.0}
    assert after(None, now) == now


def test_a_run_with_other_inputs_keeps_nothing_of_what_it_did_again():
    changed = (Ready(FIRST, "a", "another key"), Ready(SECOND, "b", "key b"))
    now = record(
        shapes=changed, repairs={}, warnings=(), seconds={"embed": 1.0}, correspondence_key="new"
    )
    kept = after(record(), now)
    assert kept.repairs == {}
    assert kept.warnings == ()
    assert kept.seconds == {"embed": 1.0}


def test_inputs_are_the_same_or_changed_or_gone(tmp_path):
    study, mesh = tmp_path / "study.toml", tmp_path / "a.vtp"
    study.write_text("x")
    mesh.write_text("y")
    files = (InputFile("a/1", "LV", "a.vtp", file_hash(mesh)),)
    known = record(study_sha256=file_hash(study), files=files)
    assert changed_inputs(known, study) == ([], [])
    mesh.write_text("z")
    assert changed_inputs(known, study) == ([str(mesh)], [])
    mesh.unlink()
    assert changed_inputs(known, study) == ([], [str(mesh)])


def test_a_folder_without_a_finished_run_is_refused(tmp_path):
    with pytest.raises(ArtifactError, match="found no run.json"):
        report_results(tmp_path)


def contents(folder):
    """Give the bytes of all files of a folder but those of its report and its lock."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
        and not {"figures", "animations", "report.html", "report.html.json", "lock"}
        & {*path.relative_to(folder).parts}
    }


@pytest.mark.xdist_group("small_results")
def test_a_copy_without_surfaces_has_the_same_report_and_nothing_else_is_written(
    small_results, tmp_path
):
    whole, bare = tmp_path / "whole", tmp_path / "elsewhere" / "bare"
    for copy in (whole, bare):
        shutil.copytree(small_results, copy)
    for name in ("opened", "shapes", "embeddings", "folds", "conformal/model.h5"):
        path = bare / name
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    before = contents(bare)
    pages = []
    for copy in (whole, bare):
        summary = report_results(copy)
        pages.append((copy / "report.html").read_text("utf-8"))
        figures = {path.name for path in (copy / "figures").iterdir()}
        assert {"maps-paper.svg", "flagged1.png"} <= figures
    assert contents(bare) == before
    assert summary.shapes == json.loads((bare / "run.json").read_text("utf-8"))["entries"]
    assert pages[0] == pages[1]


@pytest.mark.long
@pytest.mark.xdist_group("example")
@pytest.mark.xdist_group("small_results")
def test_sizes_of_the_meshes_stand_beside_those_that_the_model_samples(small_results):
    ids, columns, own = read_shape_values_csv(small_results / "surfaces.csv")
    sampled_ids, names, sampled = read_shape_values_csv(small_results / "clinical.csv")
    assert ids == sampled_ids
    assert {"LV_volume_ml", "LA_volume_ml", "LA_mitral_perimeter_mm"} <= set(columns)
    ratios = sampled[:, [names.index(column) for column in columns]] / own
    volumes = [place for place, column in enumerate(columns) if column.endswith("_volume_ml")]
    assert (ratios[:, volumes] < 1.0).all()  # chords cut corners
    assert (ratios[:, volumes] > 0.9).all()
    assert "surfaces.csv" in (small_results / "report.html").read_text(encoding="utf-8")


def test_the_report_needs_neither_study_nor_meshes(example_folder, tmp_path):
    shutil.copytree(example_folder.parent, tmp_path / "example")
    output = tmp_path / "moved"
    build_study(tmp_path / "example" / "study" / "study.toml", tmp_path / "example" / "results")
    (tmp_path / "example" / "results").rename(output)
    shutil.rmtree(tmp_path / "example")
    (output / "report.html").unlink()
    names = {path.stem for path in (output / "figures").iterdir()}
    assert all(FIGURE_NAMES.fullmatch(name) for name in names)
    shutil.rmtree(output / "figures")
    (output / "figures").mkdir()
    for name in ("flagged99.svg", "left-out.pdf", "mine.png"):
        (output / "figures" / name).write_text("an earlier one")
    heard = []
    summary = report_results(tmp_path / "gone" / "study.toml", output, on_event=heard.append)
    assert summary.shapes == json.loads((output / "run.json").read_text("utf-8"))["entries"]
    assert (output / "report.html").stat().st_size < 8_000_000
    for suffix in ("svg", "pdf", "png"):
        assert (output / "figures" / f"maps-paper.{suffix}").is_file()
    assert {path.stem for path in (output / "figures").iterdir()} == {*names, "mine"}
    notes = [event.text for event in heard if isinstance(event, Note)]
    assert any(text.startswith("gone since the last run") for text in notes)


STUDY = """
schema = 1
[parts.LV]
ostia = ["mitral"]
[shapes]
sheet = "shapes.csv"
[report]
title = "A title"
part = "{part}"
"""


def test_the_study_may_name_its_report_and_the_part_to_draw():
    found = parsed_settings(STUDY.format(part="LV")).report
    assert (found.title, found.part, found.shape) == ("A title", "LV", None)
    with pytest.raises(InputError, match=r'report\.part: expected a part of \[parts\], found "RV"'):
        parsed_settings(STUDY.format(part="RV"))
