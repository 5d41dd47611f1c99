"""A difference planted in a field is found where it was planted, and nowhere else."""

import csv
import json

import numpy as np
import pytest

from ostiform.artifacts import save
from ostiform.cli import application
from ostiform.errors import InputError
from ostiform.model import (
    StoredModel,
    SurfaceField,
    fit_model,
    mesh_of_template,
    project,
    write_model,
)
from ostiform.pipeline.carried_fields import FIELDS, Fields
from ostiform.statistics import (
    Covariate,
    EffectSettings,
    covariate_of,
    field_effect,
    subject_field,
)
from ostiform.surface import read_mesh
from tests.populations import population

SUBJECTS = 20
PHASES = 2
PLANTED = 1.0
"""mV, beside noise of 0.4 mV between subjects."""


@pytest.fixture(scope="module")
def planted():
    """Shapes that do not differ by group, and a voltage that does, at the northern cap only.

    Five points have no value in some subject, and subject 19 none anywhere.
    """
    rng = np.random.default_rng(5)
    shapes = population(SUBJECTS, PHASES, rng)
    model = fit_model(shapes.aligned, shapes.weights, mesh_of_template(shapes.template))
    stored = StoredModel(model, project(model, shapes.aligned), shapes.ids, shapes.template)
    north = shapes.template.points[:, 2] > 0.6
    patient = np.arange(SUBJECTS) % 2 == 1
    values = rng.normal(5.0, 0.4, size=(SUBJECTS, 1, len(north))).repeat(PHASES, axis=1)
    values += PLANTED * patient[:, None, None] * north
    values[3, :, 7:12] = np.nan
    values[19] = np.nan
    values[2, 1, 0] = np.nan  # its other phase speaks for it
    field = SurfaceField("voltage", "mV", False, values.reshape(-1, len(north)))
    group = [["control", "patient"][int(is_patient)] for is_patient in patient]
    return stored, field, group, north


@pytest.fixture(scope="module")
def effect(planted):
    stored, field, group, _ = planted
    own = subject_field(stored.ids, field)
    assert own.subjects == tuple(f"subject {s}" for s in range(SUBJECTS - 1))
    settings = EffectSettings(permutations=1999, seed=5)
    return field_effect(own, stored.model.weights, covariate_of("group", group[:-1]), (), settings)


def test_the_planted_difference_is_found_and_nothing_else(planted, effect):
    north = planted[3][effect.tested]
    found = effect.points.q_value <= 0.05
    assert effect.whole.p_value <= 0.05
    assert found[north].mean() > 0.9
    assert found[~north].sum() <= 0.05 * found.sum() + 1.0
    assert effect.coefficients[0, north].mean() == pytest.approx(PLANTED, abs=0.1)
    assert effect.coefficients[0, ~north].mean() == pytest.approx(0.0, abs=0.1)
    step = effect.values_at("patient") - effect.values_at("control")
    np.testing.assert_allclose(step, effect.coefficients[0], atol=1e-12)


def test_points_that_some_subject_lacks_are_not_tested(planted, effect):
    n_points = len(planted[3])
    np.testing.assert_array_equal(
        effect.tested, np.setdiff1d(np.arange(n_points), np.arange(7, 12))
    )
    spread = effect.everywhere(effect.mean, n_points)
    assert np.isnan(spread[7:12]).all()
    np.testing.assert_array_equal(spread[effect.tested], effect.mean)


def test_a_subject_is_the_mean_of_the_phases_that_have_a_value(planted):
    stored, field, _, _ = planted
    own = subject_field(stored.ids, field)
    np.testing.assert_allclose(own.values[2], field.values[4], rtol=1e-14)
    one = subject_field(stored.ids, field, "ph01")
    assert np.isnan(one.values[2, 0])
    assert one.what == "phase ph01"


def test_without_an_effect_small_p_values_are_rare(rng):
    """Of 200 populations without an effect 5 % have a p-value of 0.05 or less."""
    count = 0
    weights = np.full(20, 0.05)
    from ostiform.statistics import SubjectField

    names = tuple(map(str, range(12)))
    for _ in range(200):
        field = SubjectField("v", "", names, rng.normal(size=(12, 20)), "the one shape")
        age = Covariate("age", rng.normal(size=12))
        settings = EffectSettings(permutations=99, seed=int(rng.integers(1 << 30)))
        count += field_effect(field, weights, age, (), settings).whole.p_value <= 0.05
    assert 2 <= count <= 21  # 10 expected, sd 3.1


def test_what_cannot_be_tested_is_told(planted):
    stored, field, group, _ = planted
    labels = SurfaceField("region", "", True, field.values)
    with pytest.raises(InputError, match="field region: expected numbers to test, found labels"):
        subject_field(stored.ids, labels)
    gaps = np.array(field.values)
    for index in range(len(gaps)):
        gaps[index, index % gaps.shape[1]] = 1.0
        gaps[index, np.arange(gaps.shape[1]) % 5 == index // 2 % 5] = np.nan
    own = subject_field(stored.ids, SurfaceField("voltage", "mV", False, gaps))
    with pytest.raises(InputError, match="expected points at which all 20 subjects have one"):
        field_effect(own, stored.model.weights, covariate_of("group", group))


@pytest.fixture
def results(planted, tmp_path):
    stored, field, group, _ = planted
    write_model(tmp_path / "model.h5", stored)
    save(tmp_path / FIELDS, (field,), Fields)
    with (tmp_path / "covariates.csv").open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["subject", "phase", "group"])
        writer.writerows(
            [id.subject, id.phase, group[k // PHASES]] for k, id in enumerate(stored.ids)
        )
    return tmp_path


def test_the_answer_is_written_and_printed(results, planted, capsys):
    words = ["compare", results, "--group", "group", "--field", "voltage", "--permutations", "499"]
    with pytest.raises(SystemExit) as end:
        application("compare")([str(word) for word in words])
    assert not end.value.code
    printed = capsys.readouterr().out
    assert "voltage by group: 19 subjects, p = 0.00" in printed
    assert "subject subject 19 left out: no value of voltage" in printed
    answer = results / "statistics" / "voltage by group"
    facts = json.loads((answer / "summary.json").read_text("utf-8"))
    assert facts["field"] == "voltage"
    assert facts["effects"][0]["units"] == "mV"
    assert facts["points"]["number"] == len(planted[3]) - 5
    assert any(warning.startswith("5 of ") for warning in facts["warnings"])
    effect = read_mesh(answer / "effect.vtp").point_data
    assert np.isnan(effect["q"][7:12]).all()
    assert (effect["q"] <= 0.05).sum() == facts["points"]["found_q_0.05"] > 0
    fitted = [
        read_mesh(answer / f"fitted_{name}.vtp").point_data["voltage"]
        for name in ("control", "patient")
    ]
    np.testing.assert_allclose(fitted[1] - fitted[0], effect["effect"], atol=1e-12)
    rows = (answer / "points.csv").read_text("utf-8").splitlines()
    assert rows[0] == "point,part,x_mm,y_mm,z_mm,effect,t2,p,q,p_family"
    assert rows[8].endswith(",,,,,")
    page = (answer / "report.html").read_text("utf-8")
    assert "Where the field voltage differs" in page
    assert (answer / "figures" / "effect.png").stat().st_size > 1000


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--field", "scar"], "field scar: expected one of voltage, found none of that name"),
        (["--field", "voltage", "--movement", "normal"], "a field has no direction"),
    ],
)
def test_a_wrong_field_or_movement_is_told(results, capsys, words, said):
    with pytest.raises(SystemExit) as end:
        application("compare")(["compare", str(results), "--group", "group", *words])
    assert end.value.code == 2
    assert said in " ".join(capsys.readouterr().err.split())
