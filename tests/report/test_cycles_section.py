"""What the report says about motion, with and without phases, and the files beside it."""

import csv

import numpy as np
import pytest

from ostiform.evaluation import (
    clinical_table,
    dynamic_evaluation_facts,
    evaluate_dynamic_model,
)
from ostiform.model import (
    StoredModel,
    dynamic_model_of,
    fit_model,
    mesh_of_template,
    project,
    read_model,
    variance_shares,
)
from ostiform.pipeline.dynamics import write_dynamics
from ostiform.pipeline.store import Store
from ostiform.report import clinical_section, cycles_section
from ostiform.report.cycles import clinical_figure
from tests.populations import population, two_part_template

SETTINGS = {"seed": 0, "evaluation": {"specificity_samples": 50}}


def stored_population(subjects, phases):
    shapes = population(subjects, phases, np.random.default_rng(1), two_part_template(5, 8))
    model = fit_model(shapes.aligned, shapes.weights, mesh_of_template(shapes.template))
    return shapes, StoredModel(model, project(model, shapes.aligned), shapes.ids, shapes.template)


@pytest.fixture(scope="module")
def evaluation():
    return evaluate_dynamic_model(dynamic_model_of(stored_population(4, 5)[1]), 0, 50)


def test_the_levels_share_the_whole_variance(evaluation):
    shares = evaluation.shares
    np.testing.assert_allclose(shares["between"].value + shares["within"].value, 1.0)
    np.testing.assert_allclose(
        shares["common"].value + shares["departure"].value, shares["within"].value
    )
    total = evaluation.model.total.total_variance
    for name, share in shares.items():
        np.testing.assert_allclose(evaluation.level(name).total_variance, share.value * total)
        assert share.low <= share.value <= share.high
    assert variance_shares(evaluation.model)["common"] == shares["common"]


def test_the_facts_hold_every_level(evaluation):
    facts = dynamic_evaluation_facts(evaluation)
    assert list(facts["levels"]) == ["total", "between", "within", "common", "departure"]
    for name in ("between", "within", "common", "departure"):
        level = facts["levels"][name]
        assert len(level["left_out_residue_mm"]) == len(facts["mode_counts"])
        assert level["specificity_mm"]["mean"][-1] > 0.0
    assert facts["left_out_phases"]["trajectory_mm"] < facts["left_out_phases"]["interpolation_mm"]


def test_a_population_of_phases_has_figures_and_tables(evaluation):
    section = cycles_section(evaluation)
    assert [picture.name for picture in section.pictures] == ["levels"]
    assert len(section.pictures[0].figure.axes) == 3
    assert [len(table.rows) for table in section.tables] == [4, 2]
    shapes, stored = stored_population(4, 5)
    clinical = clinical_section(
        clinical_table(shapes.ids, shapes.aligned, shapes.aligned, stored.model.mesh)
    )
    assert len(clinical.pictures[0].figure.axes) == 6
    assert len(clinical.tables[0].rows) == 4
    assert clinical.tables[0].header[1] == "LV ejection fraction (%)"


def test_an_opening_that_two_parts_share_is_drawn_once():
    shapes, stored = stored_population(4, 5)
    table = clinical_table(shapes.ids, shapes.aligned, shapes.aligned, stored.model.mesh)
    titles = [axes.get_title() for axes in clinical_figure(table).axes]
    assert sum("mitral" in title for title in titles) == 1
    assert "LA.vein: area (mm²)" in titles


def test_a_population_without_phases_has_sizes_but_no_motion(tmp_path):
    shapes, stored = stored_population(5, 1)
    found = write_dynamics(Store(tmp_path), "key", stored, shapes, SETTINGS)
    assert found.evaluation is None
    for section in (cycles_section(found.evaluation), clinical_section(found.clinical)):
        assert len(section.paragraphs) == 1
        assert not section.pictures
    assert not cycles_section(found.evaluation).tables
    (sizes,) = clinical_section(found.clinical).tables
    rows = {row[0]: row[1:] for row in sizes.rows}
    volumes = found.clinical.column("LV_volume_ml")
    assert float(rows["LV volume (ml)"][0]) == pytest.approx(volumes.mean(), abs=0.05)
    assert str(shapes.ids[int(volumes.argmax())]) in rows["LV volume (ml)"][3]
    assert "LV.aortic largest diameter (mm)" in rows
    assert not (tmp_path / "dynamics.json").exists()
    assert (tmp_path / "clinical.csv").is_file()


def test_the_dynamic_model_can_be_read_back(tmp_path):
    shapes, stored = stored_population(3, 4)
    events = {f"subject {s}": [0.3 + 0.1 * s] for s in range(3)}
    settings = {**SETTINGS, "cycle": {"landmarks": events}}
    found = write_dynamics(Store(tmp_path), "key", stored, shapes, settings)
    again = dynamic_model_of(read_model(tmp_path / "dynamics.h5"))
    model = found.evaluation.model
    np.testing.assert_allclose(again.between.variances, model.between.variances, rtol=1e-6)
    np.testing.assert_allclose(
        again.trajectories.left_out_errors, model.trajectories.left_out_errors, rtol=1e-5
    )
    # The events of the three subjects fall on their mean, 0.4 of the cycle.
    times = {str(id): id.time for id in again.ids}
    np.testing.assert_allclose(times["subject 0/ph01"], 0.25 / 0.3 * 0.4)
    with (tmp_path / "clinical.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 12
    assert float(rows[0]["LV_volume_ml"]) > 0.0


def test_two_subjects_are_not_left_out():
    evaluation = evaluate_dynamic_model(dynamic_model_of(stored_population(2, 4)[1]), 0, 20)
    assert evaluation.residues is None
    assert evaluation.shares["between"].low is None
    section = cycles_section(evaluation)
    assert "Fewer than three" in section.paragraphs[1]
    assert len(section.pictures[0].figure.axes) == 2
