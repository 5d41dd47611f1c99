"""`ostiform synthesize`: meshes and animations of what was asked for."""

import csv
import json

import numpy as np
import pytest

from ostiform.cli import application
from ostiform.model import (
    StoredModel,
    dynamic_model_of,
    fit_model,
    mean_cycle,
    mesh_of_template,
    project,
    resampled_cycle,
    write_model,
)
from ostiform.surface import read_mesh
from tests.populations import population


def stored_population(subjects, phases):
    shapes = population(subjects, phases, np.random.default_rng(3))
    model = fit_model(shapes.aligned, shapes.weights, mesh_of_template(shapes.template))
    return StoredModel(model, project(model, shapes.aligned), shapes.ids, shapes.template)


@pytest.fixture(scope="module")
def stored():
    return stored_population(4, 4)


@pytest.fixture(scope="module")
def model_file(stored, tmp_path_factory):
    path = tmp_path_factory.mktemp("model") / "model.h5"
    write_model(path, stored)
    return path


@pytest.fixture
def synthesize(model_file, tmp_path, capsys):
    def run(*options, model=model_file):
        words = ["synthesize", str(model), "-o", str(tmp_path / "made"), *options]
        with pytest.raises(SystemExit) as end:
            application("synthesize")(words)
        printed = capsys.readouterr()
        return end.value.code or 0, printed.out, printed.err, tmp_path / "made"

    return run


def test_without_a_choice_it_makes_the_mean_modes_and_the_cycle(synthesize, stored):
    code, out, _, made = synthesize("--times", "3", "--json")
    assert code == 0
    files = set(json.loads(out)["files"])
    assert {"mean.vtp", "mode1_-2sd.vtp", "mode3_+2sd.vtp", "cycle_mean/0002.vtp"} <= files
    assert {"mode1.webp", "mode2.webp", "mode3.webp", "cycle_mean.webp"} <= files
    assert all((made / name).is_file() for name in files)
    assert (made / "cycle_mean_frames" / "0002.png").is_file()
    np.testing.assert_array_equal(read_mesh(made / "mean.vtp").vertices, stored.model.mean)
    expected = stored.model.mean + 2.0 * np.sqrt(stored.model.variances[0]) * stored.model.modes[0]
    np.testing.assert_allclose(read_mesh(made / "mode1_+2sd.vtp").vertices, expected, atol=1e-9)


def test_cycles_are_those_of_the_dynamic_model(synthesize, stored):
    code, _, _, made = synthesize(
        "--cycle", "mean", "--cycle", "subject 2", "--times", "4", "--no-animations", "-q"
    )
    assert code == 0
    dynamic, times = dynamic_model_of(stored), np.arange(4) / 4
    for name, expected in (
        ("cycle_mean", mean_cycle(dynamic, times)),
        ("cycle_subject 2", resampled_cycle(dynamic, "subject 2", times)),
    ):
        found = [read_mesh(made / name / f"{k:04d}.vtp").vertices for k in range(4)]
        np.testing.assert_allclose(found, expected, atol=1e-9)
    assert not list(made.glob("*.webp"))


def test_samples_follow_from_the_seed_and_scores_are_written(synthesize, stored):
    code, _, _, made = synthesize(
        "--samples", "2", "--seed", "7", "--scores=-1,0.5", "--no-animations", "-q"
    )
    assert code == 0
    expected = stored.model.sample(2, seed=7)
    for number in (1, 2):
        found = read_mesh(made / f"sample{number:04d}.vtp").vertices
        np.testing.assert_allclose(found, expected[number - 1], atol=1e-9)
    with (made / "scores.csv").open(encoding="utf-8", newline="") as stream:
        rows = {row["shape"]: row for row in csv.DictReader(stream)}
    assert set(rows) == {"mean", "chosen", "sample0001", "sample0002"}
    deviations = np.sqrt(stored.model.variances[:2])
    np.testing.assert_allclose(
        [float(rows["chosen"][f"mode{k}_mm"]) for k in (1, 2)],
        [-deviations[0], 0.5 * deviations[1]],
        rtol=1e-4,
    )


def test_a_new_heart_beats_with_the_motion_of_the_population(synthesize, stored):
    code, _, _, made = synthesize("--heart", "0,0", "--times", "3", "--no-animations", "-q")
    assert code == 0
    found = [read_mesh(made / "heart" / f"{k:04d}.vtp").vertices for k in range(3)]
    expected = mean_cycle(dynamic_model_of(stored), np.arange(3) / 3)
    np.testing.assert_allclose(np.mean(found, axis=0), stored.model.mean, atol=1.0)
    np.testing.assert_allclose(np.diff(found, axis=0), np.diff(expected, axis=0), atol=1e-6)


def test_every_format_holds_the_same_shape(synthesize, stored):
    formats = [word for name in ("vtp", "ply", "stl", "obj") for word in ("--format", name)]
    code, _, _, made = synthesize("--scores", "1", "--no-animations", "-q", *formats)
    assert code == 0
    expected = read_mesh(made / "chosen.vtp")
    for suffix in (".ply", ".stl", ".obj"):
        found = read_mesh(made / f"chosen{suffix}")
        np.testing.assert_allclose(
            found.vertices[found.faces], expected.vertices[expected.faces], atol=1e-4
        )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--mode", "99"], "expected a number from 1 to 15, found 99"),
        (["--scores", "1,x"], '--scores: expected numbers separated by commas, found "1,x"'),
        (["--scores", ",".join(["1"] * 40)], "found 40"),
        (["--cycle", "nobody"], "found nobody"),
        (["--samples", "-1"], "samples: expected at least 0, found -1"),
        (["--cycle", "mean", "--times", "1"], "at least 2, found 1"),
    ],
)
def test_what_cannot_be_made_is_said_in_one_sentence(synthesize, options, message):
    code, _, err, _ = synthesize(*options)
    assert code == 2
    assert message in err
    assert "Traceback" not in err


def test_a_model_of_single_shapes_has_no_cycle(synthesize, tmp_path):
    path = tmp_path / "single.h5"
    write_model(path, stored_population(4, 1))
    code, _, err, _ = synthesize("--cycle", "mean", model=path)
    assert code == 2
    assert "one shape for each of 4 subjects" in err
    code, out, _, _ = synthesize("--json", "--no-animations", model=path)
    assert code == 0
    assert "cycle" not in out


def test_a_missing_model_is_named(synthesize, tmp_path):
    code, _, err, _ = synthesize(model=tmp_path / "none.h5")
    assert code == 6
    assert "none.h5" in err
