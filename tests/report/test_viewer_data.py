"""What the viewer gets is enough to show the model's shapes, to within half a unit."""

import base64
import json

import numpy as np
import pytest

from ostiform.evaluation import (
    ClinicalTable,
    clinical_table,
    left_out_point_residues,
    part_volumes,
)
from ostiform.model import (
    StoredModel,
    SurfaceField,
    dynamic_model_of,
    fit_model,
    mean_cycle,
    mesh_of_template,
    project,
    reconstruct,
)
from ostiform.report import viewer, viewer_data, viewer_section, volumes_section
from ostiform.report.viewer import point_spread
from tests.populations import population, two_part_template

TOLERANCE_MM = 0.02  # half units of the mean and of a dozen modes of some 50 mm, times scores


@pytest.fixture(scope="module")
def stored():
    shapes = population(3, 4, np.random.default_rng(4), two_part_template(9, 16))
    model = fit_model(shapes.aligned, shapes.weights, mesh_of_template(shapes.template))
    return StoredModel(model, project(model, shapes.aligned), shapes.ids, None)


@pytest.fixture(scope="module")
def data(stored):
    return json.loads(viewer_data(stored, dynamic_model_of(stored), residues(stored)))


def residues(stored):
    points = reconstruct(stored.model, stored.scores)
    return left_out_point_residues(points, stored.model.weights, stored.ids, 3)


def numbers(record):
    return record["unit"] * np.frombuffer(base64.b64decode(record["data"]), "<i2")


def shape(data, coefficients):
    mean = numbers(data["mean"]).reshape(-1, 3)
    basis = np.stack([numbers(mode).reshape(-1, 3) for mode in data["basis"]])
    return mean + np.tensordot(coefficients, basis, axes=1)


def assert_same_shape(found, expected, model):
    centre = model.mean.mean(axis=0)
    np.testing.assert_allclose(found, expected - centre, atol=TOLERANCE_MM)


def test_training_shapes_are_shown_as_they_are(data, stored):
    for record, scores in zip(data["shapes"], stored.scores, strict=True):
        expected = reconstruct(stored.model, scores)
        assert_same_shape(shape(data, record["scores"]), expected, stored.model)


def test_the_modes_of_all_sets_are_those_of_the_models(data, stored):
    dynamic = dynamic_model_of(stored)
    models = [stored.model, dynamic.between, dynamic.within]
    labels = [record["label"] for record in data["sets"]]
    assert labels == ["all shapes", "between subjects", "motion within subjects"]
    for record, model in zip(data["sets"], models, strict=True):
        for k, mode in enumerate(record["modes"]):
            coefficients = np.add(record["mean"], 2.0 * np.array(mode["coefficients"]))
            expected = model.mean + 2.0 * np.sqrt(model.variances[k]) * model.modes[k]
            assert_same_shape(shape(data, coefficients), expected, stored.model)
        spread = np.sqrt((model.variances[:, None, None] * model.modes**2).sum(axis=(0, 2)))
        np.testing.assert_allclose(point_spread(model), spread, rtol=1e-9)
        np.testing.assert_allclose(numbers(record["spread"]), spread, atol=TOLERANCE_MM)


def test_the_mean_cycle_is_that_of_the_dynamic_model(data, stored):
    frames = data["cycles"][0]["frames"]
    expected = mean_cycle(dynamic_model_of(stored), np.arange(len(frames)) / len(frames))
    for frame, points in zip(frames, expected, strict=True):
        assert_same_shape(shape(data, frame), points, stored.model)


def test_triangles_are_grouped_by_part(data, stored):
    faces = np.frombuffer(base64.b64decode(data["faces"]), "<u4").reshape(-1, 3)
    first = data["parts"][0]["faces"]
    mesh = stored.model.mesh
    assert {tuple(face) for face in faces[:first]} == {
        tuple(face) for face in mesh.faces[mesh.face_part == 0]
    }
    assert sum(part["faces"] for part in data["parts"]) == len(mesh.faces)
    assert [data["parts"][opening["part"]]["name"] for opening in data["openings"]] == [
        name.split(".")[0] for name in mesh.loops
    ]
    assert not any(part["encloses"] for part in data["parts"])


def test_without_phases_there_is_one_set_and_no_cycle(stored):
    data = json.loads(viewer_data(stored, None, None))
    assert len(data["sets"]) == 1
    assert data["cycles"] == []
    assert data["error"] is None
    assert "cycle" not in " ".join(viewer_section(stored, None, None).paragraphs)


def test_the_error_of_the_points_is_that_of_left_out_shapes(data, stored):
    np.testing.assert_allclose(numbers(data["error"]), residues(stored).rms, atol=TOLERANCE_MM)


def test_fields_are_carried_with_their_gaps(stored, monkeypatch):
    n_points = len(stored.model.mean)
    values = np.linspace(-3.0, 7.0, len(stored.ids) * n_points).reshape(-1, n_points)
    values[0, :4] = np.nan
    values[:, 5] = np.nan
    labels = np.where(np.isnan(values), np.nan, np.where(values > 2.0, 9.0, 4.0))
    fields = [
        SurfaceField("voltage", "mV", False, values),
        SurfaceField("region", "", True, labels),
        SurfaceField("nowhere", "", False, np.full_like(values, np.nan)),
    ]
    voltage, region = json.loads(viewer_data(stored, None, None, fields))["fields"]
    assert voltage["title"] == "voltage (mV)"
    np.testing.assert_allclose(voltage["ends"], [-2.9, 6.9], atol=0.04)
    np.testing.assert_allclose(gapped(voltage["mean"])[5:9], [np.nan, *values[:, 6:9].mean(axis=0)],
                               atol=1e-3)  # fmt: skip
    for record, own in zip(voltage["shapes"], values, strict=True):
        np.testing.assert_allclose(gapped(record), own, atol=1.1e-4)  # half a unit of 7 / 32767
    assert region["labels"] == ["4", "9"]
    assert len(region["colours"]) == 2
    for record, own in zip(region["shapes"], labels, strict=True):
        found = gapped(record)
        known = ~np.isnan(own)
        np.testing.assert_array_equal(np.array([4.0, 9.0])[found[known].astype(int)], own[known])
        assert np.isnan(found[~known]).all()
    monkeypatch.setattr(viewer, "FIELD_BUDGET", 3 * 2 * 8 * n_points)
    less = json.loads(viewer_data(stored, None, None, fields[:2]))["fields"]
    assert [len(field["shapes"]) for field in less] == [9, 9]
    names = [picture.name for picture in viewer_section(stored, None, None, fields).pictures]
    assert names == ["points", "fields"]


def gapped(record):
    found = numbers(record)
    return np.where(found == record["unit"] * viewer.MISSING, np.nan, found)


def test_a_page_carries_so_many_training_shapes_and_says_how_many_there_are(stored, monkeypatch):
    monkeypatch.setattr(viewer, "MOST_SHAPES", 5)
    data = json.loads(viewer_data(stored, None, None))
    assert len(data["shapes"]) == 5
    assert data["shape_count"] == len(stored.ids)


def test_a_page_that_would_grow_too_large_loses_the_last_modes(stored, monkeypatch):
    count = len(stored.model.mean)
    monkeypatch.setattr(viewer, "BUDGET", 3 * viewer.CHARACTERS_PER_POINT * count)
    data = json.loads(viewer_data(stored, dynamic_model_of(stored), None))
    assert len(data["basis"]) == 3
    assert sum(len(mode["data"]) for mode in data["basis"]) <= viewer.BUDGET
    variances = stored.model.variances
    np.testing.assert_allclose(
        data["left_out_share"], variances[3:].sum() / variances.sum(), atol=1e-6
    )


def test_volumes_are_told_as_curves_or_as_a_table(stored):
    points = stored.model.reconstruct(stored.scores)
    whole = clinical_table(stored.ids, points, points, stored.model.mesh)
    volumes = part_volumes(points, stored.model.mesh)
    for part, values in whole.volumes.items():
        np.testing.assert_allclose(values, volumes[part], rtol=1e-12)
    curves = volumes_section(whole)
    assert [picture.name for picture in curves.pictures] == ["volumes"]
    assert len(curves.tables[0].rows) == 6
    own = ClinicalTable(stored.ids[::-1], whole.columns[:1], 1.25 * whole.values[::-1, :1])
    told = volumes_section(whole, own).tables[1].rows
    assert [row[0] for row in told] == [whole.columns[0]]
    assert told[0][3:] == ("\N{MINUS SIGN}20.0", "\N{MINUS SIGN}20.0")
    few = [0, 4, 8]  # one phase of every subject
    ids = tuple(stored.ids[i] for i in few)
    table = volumes_section(ClinicalTable(ids, whole.columns, whole.values[few]))
    assert table.pictures == ()
    assert [row[0] for row in table.tables[0].rows] == [str(id) for id in ids]
