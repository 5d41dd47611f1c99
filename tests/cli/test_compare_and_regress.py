"""`ostiform compare` and `ostiform regress`: from a results folder to a page with maps."""

import csv
import json

import numpy as np
import pytest

from ostiform.cli import application
from ostiform.model import StoredModel, fit_model, mesh_of_template, project, write_model
from ostiform.pipeline.statistics import smallest_p_value
from ostiform.statistics import covariate_of
from ostiform.surface import read_mesh
from tests.populations import population

SUBJECTS = 16


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """A results folder of subjects in two phases; patients' hearts are longer by 20 %."""
    folder = tmp_path_factory.mktemp("results")
    rng = np.random.default_rng(11)
    shapes = population(SUBJECTS, 2, rng)
    group = ["control", "patient"] * (SUBJECTS // 2)
    aligned = np.array(shapes.aligned)
    for index in range(len(aligned)):
        aligned[index, :, 2] *= 1.4 if group[index // 2] == "patient" else 1.0
    model = fit_model(aligned, shapes.weights, mesh_of_template(shapes.template))
    stored = StoredModel(model, project(model, aligned), shapes.ids, shapes.template)
    write_model(folder / "model.h5", stored)
    with (folder / "covariates.csv").open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["subject", "phase", "group", "age", "centre"])
        for id in shapes.ids:
            subject = int(id.subject.split()[1])
            age = "" if subject == 3 else f"{40 + 1.5 * subject:g}"
            writer.writerow([id.subject, id.phase, group[subject], age, subject % 3])
    return folder


@pytest.fixture
def run(tmp_path, capsys):
    def call(*words):
        out = ["-o", str(tmp_path / "answer")]
        out += [] if "--permutations" in words else ["--permutations", "199"]
        with pytest.raises(SystemExit) as end:
            application(words[0])([*map(str, words), *out])
        printed = capsys.readouterr()
        return end.value.code or 0, printed.out, printed.err, tmp_path / "answer"

    return call


def test_a_group_difference_is_found_and_written(run, results):
    code, out, _, answer = run("compare", results, "--group", "group", "--json")
    assert code == 0
    facts = json.loads(out)
    assert facts == json.loads((answer / "summary.json").read_text("utf-8"))
    assert facts["categories"] == {"control": 8, "patient": 8}
    assert facts["whole_shape"]["p_value"] <= 0.05
    assert facts["stands_for_a_subject"] == "mean over the cycle"
    effect = read_mesh(answer / "effect.vtp")
    assert {"effect_mm", "outward_mm", "p", "q", "p_family", "t2"} <= set(effect.point_data)
    assert (effect.point_data["q"] <= 0.05).sum() == facts["points"]["found_q_0.05"] > 0
    fitted = [read_mesh(answer / f"fitted_{name}.vtp").vertices for name in ("control", "patient")]
    np.testing.assert_allclose(fitted[1] - fitted[0], effect.point_data["effect_mm"], atol=1e-9)
    with (answer / "points.csv").open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    np.testing.assert_allclose([float(row["q"]) for row in rows], effect.point_data["q"], rtol=1e-5)
    for name in ("effect.png", "effect.svg", "effect.pdf", "null.svg"):
        assert (answer / "figures" / name).stat().st_size > 1000
    page = (answer / "report.html").read_text("utf-8")
    assert "Shape and group" in page
    assert 'http-equiv="Content-Security-Policy"' in page


def test_a_regression_adjusts_and_says_who_is_left_out(run, results):
    code, out, _, answer = run("regress", results, "--on", "age", "--adjust", "group", "-v")
    assert code == 0
    assert "subject subject 3 left out: no value of age" in out
    facts = json.loads((answer / "summary.json").read_text("utf-8"))
    assert facts["adjusted"] == ["group"]
    assert facts["type"] == "continuous"
    assert len(facts["subjects"]) == SUBJECTS - 1
    assert len(list(answer.glob("fitted_*.vtp"))) == 2


def test_a_column_of_numbers_can_be_groups_and_several(run, results):
    code, out, _, answer = run("compare", results, "--group", "centre", "--movement", "normal")
    assert code == 0
    assert "centre: 16 subjects" in out
    effect = read_mesh(answer / "effect.vtp")
    assert {"effect_mm centre: 1 - 0", "effect_mm centre: 2 - 0"} <= set(effect.point_data)
    assert (answer / "figures" / "effect2.png").is_file()


def test_a_sheet_of_ones_own_and_one_phase_can_be_chosen(run, results, tmp_path):
    sheet = tmp_path / "few.csv"
    lines = [f"subject {s};{'ab'[s % 2]};{50 + s**2}" for s in range(6)]
    sheet.write_text("subject;kind;ef\n" + "\n".join(lines) + "\n", encoding="utf-8")
    words = ["compare", results, "--group", "kind", "--sheet", sheet, "--movement", "normal"]
    code, out, _, answer = run(*words, "--phase", "ph01")
    assert code == 0
    assert "kind: 6 subjects" in out
    assert "with 6 subjects no p-value can be below 0.05" not in out  # exactly 1 / 20
    facts = json.loads((answer / "summary.json").read_text("utf-8"))
    assert facts["stands_for_a_subject"] == "phase ph01"


def test_too_few_subjects_for_a_small_p_value_are_warned_of():
    group = covariate_of("kind", list("aabbb"))
    assert smallest_p_value(group) == 0.1
    assert smallest_p_value(covariate_of("age", list("1234"))) == 1.0 / 24.0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["compare", "--group", "height"], "found age, centre, group"),
        (["regress", "--on", "age", "--adjust", "age"], "different columns"),
        (["compare", "--group", "group", "--phase", "ph09"], "found ph09"),
        (["compare", "--group", "age"], "at least 2 subjects in every category"),
        (["compare", "--group", "group", "--permutations", "0"], "at least 1, found 0"),
        (["compare", "--group", "group", "--modes", "99"], "found 99"),
    ],
)
def test_wrong_questions_are_answered_in_one_sentence(run, results, words, message):
    command, *options = words
    code, _, err, _ = run(command, results, *options)
    assert code == 2
    assert message in err


def test_a_sheet_of_others_is_refused(run, results, tmp_path):
    sheet = tmp_path / "others.csv"
    sheet.write_text("subject,group\nX1,a\n", encoding="utf-8")
    code, _, err, _ = run("compare", results, "--group", "group", "--sheet", sheet)
    assert code == 2
    assert "found X1" in err


def test_results_without_columns_are_refused(run, results, tmp_path):
    bare = tmp_path / "bare"
    bare.mkdir()
    (bare / "model.h5").write_bytes((results / "model.h5").read_bytes())
    code, _, err, _ = run("compare", bare, "--group", "group")
    assert code == 6
    assert "--sheet" in err
