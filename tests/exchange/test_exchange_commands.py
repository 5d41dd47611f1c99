"""The commands export, adopt and widen: what they print, and one sentence for what is wrong."""

import json

import numpy as np
import pytest

from ostiform.cli.adopt import Source, adopt
from ostiform.cli.export import export
from ostiform.cli.options import Common
from ostiform.cli.widen import widen
from ostiform.model import (
    StoredModel,
    fit_model,
    mesh_of_template,
    project,
    read_model,
    write_correspondence,
    write_model,
)
from tests.populations import population

JSON = Common(json=True)


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    folder = tmp_path_factory.mktemp("results")
    shapes = population(3, 2, np.random.default_rng(1))
    model = fit_model(shapes.aligned, shapes.weights, mesh_of_template(shapes.template))
    write_correspondence(folder / "correspondence.h5", shapes)
    stored = StoredModel(model, project(model, shapes.aligned), shapes.ids, shapes.template)
    write_model(folder / "model.h5", stored)
    return folder


def test_what_is_exported_can_be_adopted_and_widened(results, tmp_path, capsys):
    assert export(results, tmp_path / "export", common=JSON) == 0
    assert str(tmp_path / "export" / "modes.glb") in json.loads(capsys.readouterr().out)
    files = Source(pattern="{subject}_{phase}.vtp", parts="LV, LA")
    assert adopt(tmp_path / "export" / "shapes", tmp_path / "out", files=files, common=JSON) == 0
    assert json.loads(capsys.readouterr().out)["shapes"] == 6
    wide = tmp_path / "wide.h5"
    assert widen(tmp_path / "out" / "model.h5", wide, sd="2", length="20", common=JSON) == 0
    told = json.loads(capsys.readouterr().out)
    found = read_model(wide)
    assert told["modes"] == len(found.model.modes)
    np.testing.assert_allclose(
        found.model.total_variance, told["variance_mm2"] + told["added_variance_mm2"], rtol=1e-9
    )
    assert len(found.ids) == 6


def test_the_summaries_are_sentences(results, tmp_path, capsys):
    export(results, tmp_path / "export", format="csv, particles")
    assert capsys.readouterr().out == f"23 files in {tmp_path / 'export'}\n"
    adopt(tmp_path / "export" / "particles", tmp_path / "out")
    assert "6 shapes of 144 points" in capsys.readouterr().out
    widen(results / "model.h5", tmp_path / "wide.h5", sd="1,0.5", length="20,5")
    assert "added (of 3.750 of the kernel)" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("run", "code", "sentence"),
    [
        (lambda r, t: export(r, t / "e", format="obj"), 2, "expected some of statismo"),
        (lambda r, t: export(t, t / "e"), 6, "expected a shape model"),
        (lambda r, t: adopt(t / "no", t / "o"), 2, "expected a folder or a ShapeWorks project"),
        (lambda r, t: widen(r / "model.h5", t / "w.h5", sd="x", length="1"), 2, "--sd: expected"),
        (lambda r, t: widen(r / "model.h5", t / "w.h5", sd="1,2", length="1"), 2, "as many of"),
        (lambda r, t: widen(r / "model.h5", t / "w.h5", sd="0", length="1"), 2, "above 0"),
    ],
)
def test_what_is_wrong_is_one_sentence(results, tmp_path, capsys, run, code, sentence):
    assert run(results, tmp_path) == code
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert sentence in error
    assert error.count("\n") == 1
