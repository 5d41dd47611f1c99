"""What the report says about motion, with and without phases, and the files beside it."""

from dataclasses import replace

import numpy as np
import pytest

from ostiform.errors import ArtifactError
from ostiform.evaluation import (
    ClinicalTable,
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
    variance_shares,
    with_landmarks_aligned,
)
from ostiform.pipeline.dynamics import read_dynamics, write_dynamics
from ostiform.pipeline.store import Store
from ostiform.report import clinical_section, cycles_section
from ostiform.report.cycles import _panels, _size_name, clinical_figure
from ostiform.report.style import percent
from ostiform.study import ShapeId, StudySettings
from tests.populations import population, two_part_template


def settings_of(landmarks):
    return StudySettings.model_validate(
        {
            "schema": 1,
            "units": "mm",
            "frame": "LPS",
            "parts": {"LV": {"ostia": ["mitral"]}},
            "shapes": {"sheet": "shapes.csv"},
            "cycle": {"landmarks": landmarks},
            "evaluation": {"specificity_samples": 50},
        }
    )


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


def test_parts_with_underscores_keep_their_names():
    names = (
        "LA_volume_ml",
        "LA_wall_volume_ml",
        "LA_wall_left_vein_area_mm2",
        "LA_mitral_area_mm2",
    )
    ids = tuple(ShapeId("s", str(k), k / 3) for k in range(3))
    table = ClinicalTable(ids, names, np.random.default_rng(0).uniform(1.0, 2.0, (3, 4)))
    assert [_size_name(table, name) for name in names] == [
        "LA volume (ml)",
        "LA_wall volume (ml)",
        "LA_wall.left_vein area (mm²)",
        "LA.mitral area (mm²)",
    ]
    drawn = [title for panel in _panels(table) for _, title in panel]
    assert drawn == ["LA.mitral: area (mm²)", "LA_wall.left_vein: area (mm²)"]


def test_what_rounds_to_zero_has_no_sign():
    assert [percent(share) for share in (-0.0004, 0.0, -0.012)] == [
        "0.0",
        "0.0",
        "\N{MINUS SIGN}1.2",
    ]


def test_a_population_without_phases_has_sizes_but_no_motion(tmp_path):
    shapes, stored = stored_population(5, 1)
    store = Store(tmp_path)
    write_dynamics(store, "key", stored, settings_of({}))
    assert read_dynamics(store) is None
    clinical = clinical_table(shapes.ids, shapes.points, shapes.aligned, stored.model.mesh)
    for section in (cycles_section(None), clinical_section(clinical)):
        assert len(section.paragraphs) == 1
        assert not section.pictures
    assert not cycles_section(None).tables
    (sizes,) = clinical_section(clinical).tables
    rows = {row[0]: row[1:] for row in sizes.rows}
    volumes = clinical.column("LV_volume_ml")
    assert float(rows["LV volume (ml)"][0]) == pytest.approx(volumes.mean(), abs=0.05)
    assert str(shapes.ids[int(volumes.argmax())]) in rows["LV volume (ml)"][3]
    assert "LV.aortic largest diameter (mm)" in rows


def test_what_a_run_knows_of_motion_comes_back_without_a_fit(tmp_path):
    _, stored = stored_population(3, 4)
    events = {f"subject {s}": [0.3 + 0.1 * s] for s in range(3)}
    store = Store(tmp_path)
    write_dynamics(store, "key", stored, settings_of(events))
    found = read_dynamics(store)
    # The events of the three subjects fall on their mean, 0.4 of the cycle.
    times = {str(id): id.time for id in found.model.ids}
    np.testing.assert_allclose(times["subject 0/ph01"], 0.25 / 0.3 * 0.4)
    ids = with_landmarks_aligned(stored.ids, events)
    fitted = evaluate_dynamic_model(dynamic_model_of(replace(stored, ids=ids)), 0, 50)
    assert dynamic_evaluation_facts(found) == dynamic_evaluation_facts(fitted)
    facts = store.read_json("dynamics.json")
    store.write_json("dynamics.json", "key", {**facts, "levels": {}})
    with pytest.raises(ArtifactError, match="expected the evaluation of dynamics.h5"):
        read_dynamics(store)


def test_two_subjects_are_not_left_out():
    evaluation = evaluate_dynamic_model(dynamic_model_of(stored_population(2, 4)[1]), 0, 20)
    assert evaluation.residues is None
    assert evaluation.shares["between"].low is None
    section = cycles_section(evaluation)
    assert "Fewer than three" in section.paragraphs[1]
    assert len(section.pictures[0].figure.axes) == 2
