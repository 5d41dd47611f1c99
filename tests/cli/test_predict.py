"""`ostiform predict`: a cycle from the file of a phase, and what it says when it cannot."""

import csv
import json

import numpy as np
import pytest

from ostiform.cli.predict import predict
from ostiform.model import StoredModel, fit_model, mesh_of_template, project, write_model
from ostiform.surface import read_mesh, write_surface
from tests.populations import population, two_part_template


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("predict")
    shapes = population(4, 5, np.random.default_rng(1), two_part_template(9, 16))
    model = fit_model(shapes.aligned[:15], shapes.weights, mesh_of_template(shapes.template))
    scores = project(model, shapes.aligned[:15])
    write_model(folder / "model.h5", StoredModel(model, scores, shapes.ids[:15], shapes.template))
    write_surface(folder / "unseen.vtp", shapes.aligned[15], model.mesh.faces)
    return folder


def test_a_phase_in_correspondence_becomes_a_cycle_with_its_numbers(files, tmp_path, capsys):
    code = predict(
        files / "model.h5", str(files / "unseen.vtp"), times="0", frames=4, output=tmp_path
    )
    assert code == 0
    said = capsys.readouterr()
    assert "the prior is weak" in said.err
    assert "points in correspondence" in said.out
    facts = json.loads((tmp_path / "prediction.json").read_text(encoding="utf-8"))
    assert facts["training_subjects"] == 3
    for rule in ("error", "mean_motion", "nearest_subject"):
        assert 0.0 < facts[f"left_out_{rule}_mm"] < 10.0
    assert "by the mean motion" in said.out
    assert facts["mean_sd_mm"][0] < 1e-2 < facts["mean_sd_mm"][2]
    assert sorted(path.name for path in tmp_path.glob("*.vtp")) == [
        f"phase_{index:04d}.vtp" for index in (0, 2500, 5000, 7500)
    ]
    with (tmp_path / "clinical.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert float(rows[2]["LV_volume_ml"]) < float(rows[0]["LV_volume_ml"])  # systole


def test_a_phase_in_correspondence_is_read_in_its_units(files, tmp_path, capsys):
    phase = read_mesh(files / "unseen.vtp")
    write_surface(files / "in_cm.vtp", 0.1 * phase.vertices, phase.faces)
    given = [str(files / f"{name}.vtp") for name in ("unseen", "in_cm")]
    outputs = [tmp_path / name for name in ("unseen", "in_cm")]
    assert predict(files / "model.h5", given[0], times="0", output=outputs[0]) == 0
    assert predict(files / "model.h5", given[1], times="0", output=outputs[1], units="cm") == 0
    one, other = (read_mesh(output / "phase_0000.vtp") for output in outputs)
    np.testing.assert_allclose(other.vertices, one.vertices, rtol=1e-5)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"times": "0,0.5"}, "a time for each"),
        ({"times": "now"}, "numbers with commas"),
        ({"frames": 0}, "at least 1"),
    ],
)
def test_wrong_requests_are_refused_in_a_sentence(files, tmp_path, capsys, changes, message):
    arguments = {"times": "0", "frames": 4, "output": tmp_path, **changes}
    assert predict(files / "model.h5", str(files / "unseen.vtp"), **arguments) == 2
    assert message in capsys.readouterr().err


def test_a_phase_in_other_units_is_refused(files, tmp_path, capsys):
    phase = read_mesh(files / "unseen.vtp")
    write_surface(files / "small.vtp", 0.1 * phase.vertices, phase.faces)
    write_surface(files / "turned.vtp", 0.1 * phase.vertices, np.roll(phase.faces, 1, axis=1))
    for name in ("small.vtp", "turned.vtp"):
        assert predict(files / "model.h5", str(files / name), times="0", output=tmp_path) == 2
        assert "0.1 times that: state the units of the file" in capsys.readouterr().err


def test_a_model_of_two_phases_says_that_it_interpolates(tmp_path, capsys):
    shapes = population(4, 2, np.random.default_rng(1), two_part_template(9, 16))
    model = fit_model(shapes.aligned, shapes.weights, mesh_of_template(shapes.template))
    scores = project(model, shapes.aligned)
    write_model(tmp_path / "model.h5", StoredModel(model, scores, shapes.ids, shapes.template))
    write_surface(tmp_path / "a.vtp", shapes.aligned[0], model.mesh.faces)
    given = str(tmp_path / "a.vtp")
    assert predict(tmp_path / "model.h5", given, frames=20, output=tmp_path / "out") == 0
    said = "knows 2 times of the cycle (0, 0.5): 18 of the 20 shapes lie between them"
    assert said in capsys.readouterr().err
    assert predict(tmp_path / "model.h5", given, frames=2, output=tmp_path / "out") == 0
    assert "lie between them" not in capsys.readouterr().err
