"""One population through the command line: files in, model and evidence out, nothing lost."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from ostiform.artifacts import load
from ostiform.demo.demonstration import write_demonstration
from ostiform.embedding import Embeddings
from ostiform.evaluation import read_evaluation
from ostiform.model import read_correspondence, read_model
from ostiform.surface import exact_orientations

pytestmark = pytest.mark.xdist_group("end_to_end")

SHAPES = 6
ON_RIM_MM = 1e-6  # the promise of the design: rims are sampled on their own polyline


def ostiform(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "ostiform", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.fixture(scope="session")
def study(tmp_path_factory) -> Path:
    """Six coarse left hearts of three subjects, with settings that keep the run short."""
    path = write_demonstration(tmp_path_factory.mktemp("study"), 3, SHAPES, seed=7, edge_mm=4.0)
    text = path.read_text("utf-8").replace(
        "[evaluation]", "[evaluation]\nmodes = 3\nspecificity_samples = 100"
    )
    path.write_text(f"{text}\n[template]\npoints = 400\n\n[correspondence]\nlevels = 3\n", "utf-8")
    return path


@pytest.fixture(scope="session")
def results(study, tmp_path_factory) -> Path:
    output = tmp_path_factory.mktemp("built") / "out"
    run = ostiform("build", study, "-o", output, "-w", 1, "--json")
    assert run.returncode == 0, run.stderr
    summary = json.loads(run.stdout)
    assert (summary["shapes"], summary["used"], summary["failed"]) == (SHAPES, SHAPES, [])
    return output


def test_the_output_tree_is_as_promised(results):
    for kind in ("conformal", "euclidean", "optimal"):
        for name in ("correspondence.h5", "model.h5", "evaluation.json"):
            assert (results / kind / name).is_file()
    for name in ("correspondence.h5", "model.h5", "failed.json", "report.html"):
        assert (results / name).is_file()
    assert json.loads((results / "failed.json").read_text()) == []
    assert (results / "correspondence.h5").read_bytes() == (
        results / "optimal" / "correspondence.h5"
    ).read_bytes()
    assert len(list((results / "meshes" / "shapes").glob("*.vtp"))) == SHAPES


def test_the_correspondence_file_has_the_promised_layout(results):
    with h5py.File(results / "correspondence.h5") as file:
        n, p, _ = file["points"].shape
        assert n == SHAPES
        assert file["points"].dtype == file["aligned"].dtype == np.float64
        assert file["aligned"].shape == (n, p, 3)
        assert file["transforms"].shape == (n, 4, 4)
        assert file["faces"].shape == (len(file["face_part"]), 3)
        np.testing.assert_allclose(file["weights"][:].sum(), 1.0, rtol=1e-12)
        assert [s.decode() for s in file["subject"][:]] == ["S1", "S1", "S2", "S2", "S3", "S3"]
        assert ((file["time"][:] >= 0) & (file["time"][:] < 1)).all()
        lv, la = file["loops/LV/mitral"][:], file["loops/LA/mitral"][:]
        assert set(lv) == set(la)  # a seam point is stored once
        assert sorted(file["loops/LA"]) == ["LIPV", "LSPV", "RIPV", "RSPV", "mitral"]
        transforms = file["transforms"][:]
        moved = np.einsum("nij,npj->npi", transforms[:, :3, :3], file["points"][:])
        moved += transforms[:, None, :3, 3]
        np.testing.assert_allclose(moved, file["aligned"][:], atol=1e-9)


def test_every_map_and_every_warp_is_free_of_folds(results):
    for path in sorted((results / "embeddings").glob("*.bin")):
        for embedding in load(path, Embeddings):
            assert embedding.certificate.problems == ()
            signs = exact_orientations(embedding.directions, embedding.component.faces)
            assert (signs > 0).all()
    correspondence = read_correspondence(results / "correspondence.h5")
    for directions in correspondence.directions:
        assert (exact_orientations(directions, correspondence.template.faces) > 0).all()


def test_rim_points_lie_on_their_rims(results):
    correspondence = read_correspondence(results / "correspondence.h5")
    names = sorted((results / "embeddings").glob("*.bin"))
    for points, path in zip(correspondence.points, names, strict=True):
        (embedding,) = load(path, Embeddings)
        component = embedding.component
        for name, rim in component.rims.items():
            loop = component.vertices[rim]
            for point in points[correspondence.template.loops[name]]:
                assert distance_to_polyline(point, loop) < ON_RIM_MM


def distance_to_polyline(point, loop) -> float:
    start, step = loop, np.roll(loop, -1, axis=0) - loop
    along = np.einsum("ij,ij->i", point - start, step) / np.einsum("ij,ij->i", step, step)
    nearest = start + np.clip(along, 0.0, 1.0)[:, None] * step
    return float(np.linalg.norm(nearest - point, axis=1).min())


def test_the_optimal_model_is_the_most_concise_and_covers_the_shapes(results):
    evaluations = {
        kind: read_evaluation(results / kind / "evaluation.json")
        for kind in ("conformal", "euclidean", "optimal")
    }
    optimal = evaluations.pop("optimal")
    assert optimal.description_length < evaluations["conformal"].description_length
    # Coherence has its say beside the length, and six shapes are few: the shorter of these two
    # differs between processors (11.52 against 11.48 on one).
    assert optimal.description_length < 1.01 * evaluations["euclidean"].description_length
    for other in evaluations.values():
        assert optimal.l_cut == other.l_cut
    assert optimal.truth.mean < 1.02 * evaluations["conformal"].truth.mean
    for item, start in zip(optimal.coverage, evaluations["conformal"].coverage, strict=True):
        assert item.p95 < 1.2 * start.p95
        assert item.smallest_share_ratio > 0.2
    model = read_model(results / "model.h5").model
    np.testing.assert_allclose(optimal.compactness.total, model.total_variance, rtol=1e-6)


def test_a_second_build_changes_nothing(study, results):
    before = {path: path.stat().st_mtime_ns for path in results.rglob("*.h5")}
    run = ostiform("build", study, "-o", results, "-w", 1)
    assert run.returncode == 0, run.stderr
    assert {path: path.stat().st_mtime_ns for path in results.rglob("*.h5")} == before


def test_a_damaged_artifact_is_made_again(study, results, tmp_path):
    output = shutil.copytree(results, tmp_path / "out")
    damaged = sorted((output / "embeddings").glob("*.bin"))[0]
    content = bytearray(damaged.read_bytes())
    content[len(content) // 2] ^= 0xFF
    damaged.write_bytes(content)
    run = ostiform("embed", study, "-o", output, "-w", 1)
    assert run.returncode == 0, run.stderr
    (mended,), (good,) = (
        load(damaged, Embeddings),
        load(results / "embeddings" / damaged.name, Embeddings),
    )
    np.testing.assert_array_equal(mended.directions, good.directions)


@pytest.fixture
def broken(study, tmp_path) -> Path:
    """A copy of the study whose first file is truncated."""
    folder = shutil.copytree(study.parent, tmp_path / "broken")
    victim = sorted(folder.rglob("*.vtp"))[0]
    victim.write_bytes(victim.read_bytes()[:200])
    return folder / study.name


def test_a_broken_shape_is_left_out_and_named(broken, tmp_path):
    output = tmp_path / "out"
    run = ostiform("embed", broken, "-o", output, "-w", 1, "--json")
    assert run.returncode == 0, run.stderr
    assert json.loads(run.stdout)["used"] == SHAPES - 1
    (failure,) = json.loads((output / "failed.json").read_text())
    assert failure["subject"] == "S1"
    assert ".vtp" in failure["reason"]


def test_a_study_may_say_that_a_broken_shape_stops_the_run(broken, tmp_path):
    text = broken.read_text("utf-8").replace("[shapes]", '[shapes]\non_error = "stop"')
    broken.write_text(text, "utf-8")
    run = ostiform("build", broken, "-o", tmp_path / "out", "-w", 1)
    assert run.returncode == 2
    assert run.stderr.count("error:") == 1
    assert "Traceback" not in run.stderr


def test_check_names_the_shape_that_cannot_be_used(broken):
    run = ostiform("check", broken, "-w", 1, "--json")
    assert run.returncode == 2
    problems = [check["problem"] for check in json.loads(run.stdout)]
    assert sum(problem is not None for problem in problems) == 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "expected this key"),
        ("schema = 1\nspelling = 2\n", "spelling: unknown key"),
        ("schema = [", "expected TOML"),
    ],
)
def test_a_wrong_study_is_one_sentence_and_exit_code_2(tmp_path, text, message):
    (tmp_path / "study.toml").write_text(text)
    run = ostiform("build", tmp_path / "study.toml", "-o", tmp_path / "out")
    assert run.returncode == 2
    assert message in run.stderr
    assert "Traceback" not in run.stderr


def test_a_file_in_the_place_of_the_output_folder_is_refused(study, tmp_path):
    (tmp_path / "out").write_text("in the way")
    run = ostiform("build", study, "-o", tmp_path / "out")
    assert run.returncode == 2
    assert "expected a folder for the results" in run.stderr
