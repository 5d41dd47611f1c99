"""Adding a subject to a finished model: the others stay as they are, the new one fits in."""

import json
import shutil

import numpy as np
import pytest

from ostiform.api.results import read_results
from ostiform.artifacts import load
from ostiform.correspondence import (
    Correspondence,
    build_shared_metric,
    correspond,
    place,
    sampler,
)
from ostiform.demo import write_demonstration
from ostiform.demo.truth import material_coordinates, read_truth, true_positions
from ostiform.domain import domain_from_json
from ostiform.embedding import Embeddings
from ostiform.errors import ArtifactError, InputError
from ostiform.evaluation import distance_to_truth
from ostiform.model import project, read_correspondence, read_model
from ostiform.pipeline.add import add_shapes
from ostiform.pipeline.build import Stage, build_study
from ostiform.pipeline.correspond import correspondence_settings
from ostiform.pipeline.prepare import read_poses
from ostiform.pipeline.store import Store, slug
from ostiform.study import read_study

EDGE_MM = 5.0


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A model of two subjects, and the study in which a third is listed by now."""
    folder = tmp_path_factory.mktemp("adding")
    study = write_demonstration(folder / "study", 3, 9, 2004, EDGE_MM)
    with study.open("a", encoding="utf-8") as stream:
        stream.write("\n[template]\npoints = 400\n")
    sheet = folder / "study" / "shapes.csv"
    everything = sheet.read_text()
    sheet.write_text("".join(x for x in everything.splitlines(True) if not x.startswith("S3")))
    build_study(study, folder / "results", until=Stage.MODEL)
    sheet.write_text(everything)
    return folder / "results", study


@pytest.fixture(scope="module")
def added(finished, tmp_path_factory):
    results, study = finished
    output = tmp_path_factory.mktemp("added") / "larger"
    return output, add_shapes(results, study, output)


def test_the_others_stay_bit_for_bit(finished, added):
    before = read_correspondence(finished[0] / "correspondence.h5")
    after = read_correspondence(added[0] / "correspondence.h5")
    count = len(before.ids)
    assert after.ids[:count] == before.ids
    assert [str(id) for id in after.ids[count:]] == ["S3/00", "S3/01", "S3/02"]
    for name in ("points", "aligned", "transforms", "directions"):
        np.testing.assert_array_equal(getattr(after, name)[:count], getattr(before, name))
    np.testing.assert_array_equal(after.weights, before.weights)
    np.testing.assert_array_equal(after.template.points, before.template.points)


def embedded(folder, ids, domain):
    names = [f"embeddings/{slug(id)}.bin" for id in ids]
    return [sampler(load(folder / name, Embeddings), domain) for name in names]


def test_the_new_shapes_lie_where_they_would_if_they_had_been_left_out(finished, added):
    results, study = finished
    before = read_correspondence(results / "correspondence.h5")
    after = read_correspondence(added[0] / "correspondence.h5")
    new = after.ids[len(before.ids) :]
    domain = domain_from_json(json.loads((results / "domain.json").read_text()))
    poses = np.array([one.transform for one in read_poses(Store(results))])
    settings = correspondence_settings(read_study(study))
    training = embedded(results, before.ids, domain)
    shared = build_shared_metric(training, before.ids, domain, poses, settings)
    fold = correspond(training, before.ids, shared, settings)["optimal"]
    placed = place(embedded(added[0], new, domain), new, fold.frozen)
    np.testing.assert_allclose(after.points[-3:], placed.points, atol=1e-9, rtol=0.0)
    np.testing.assert_allclose(after.directions[-3:], placed.directions, atol=1e-9, rtol=0.0)
    np.testing.assert_allclose(after.transforms[-3:], placed.transforms, atol=1e-9, rtol=0.0)


def test_every_shape_old_or_new_has_its_warp(finished, added):
    for folder in (finished[0], added[0]):
        results = read_results(folder)
        shapes = results.correspondence
        template = shapes.template
        for id, directions in zip(shapes.ids, shapes.directions, strict=True):
            found = results.warp(id)(template.points, template.sphere)
            np.testing.assert_allclose(found, directions, atol=1e-9, rtol=0.0)
    with pytest.raises(ArtifactError, match="warp of S7/00"):
        results.warp("S7/00")


def test_the_model_is_that_of_all_shapes(added):
    stored = read_model(added[0] / "model.h5")
    after = read_correspondence(added[0] / "correspondence.h5")
    assert stored.model.sample_count == 9
    np.testing.assert_allclose(stored.model.mean, after.aligned.mean(axis=0), atol=1e-9)
    np.testing.assert_allclose(project(stored.model, after.aligned), stored.scores, atol=1e-9)


def mean_distance(truth, correspondence: Correspondence) -> float:
    return distance_to_truth(
        correspondence,
        lambda shape, part, points: material_coordinates(truth, shape, part, points),
        lambda shape, part, material: true_positions(truth, shape, part, material),
    ).mean


@pytest.mark.long
def test_the_new_shapes_are_as_near_to_the_truth_as_those_that_were_built_together(
    finished, added, tmp_path
):
    results, study = finished
    truth = read_truth(study.parent / "truth" / "truth.json")
    build_study(study, tmp_path / "rebuilt", until=Stage.CORRESPOND)
    rebuilt = mean_distance(truth, read_correspondence(tmp_path / "rebuilt" / "correspondence.h5"))
    larger = mean_distance(truth, read_correspondence(added[0] / "correspondence.h5"))
    assert larger < 1.1 * rebuilt


def test_what_was_added_is_told(added):
    output, addition = added
    assert (addition.before, addition.after) == (6, 9)
    told = json.loads((output / "added.json").read_text())
    assert told["added"] == [
        {
            "subject": item.subject,
            "phase": item.phase,
            "residue_mm": item.residue_mm,
            "coverage_p95_mm": item.coverage_p95_mm,
        }
        for item in addition.added
    ]
    assert all(0.0 < item.residue_mm < 10.0 for item in addition.added)


def test_one_phase_can_be_added_alone(finished, tmp_path):
    results, study = finished
    first = add_shapes(results, study, tmp_path / "one", ["S3/00"])
    assert [(item.subject, item.phase) for item in first.added] == [("S3", "00")]


@pytest.mark.parametrize(
    ("wanted", "message"),
    [
        (["S9"], "S9: expected a shape SUBJECT/PHASE or a subject"),
        (["S1"], "S1: expected a new shape, found it in the model already"),
    ],
)
def test_shapes_that_cannot_be_added_are_refused(finished, tmp_path, wanted, message):
    results, study = finished
    with pytest.raises(InputError, match=message):
        add_shapes(results, study, tmp_path / "out", wanted)


def test_folders_that_cannot_be_added_to_are_refused(finished, tmp_path):
    results, study = finished
    with pytest.raises(InputError, match="another folder than the results"):
        add_shapes(results, study, results)
    with pytest.raises(ArtifactError, match="correspondence"):
        add_shapes(tmp_path, study, tmp_path / "out")
    copy = tmp_path / "copy"
    shutil.copytree(results, copy)
    (copy / "correspondence.json").write_text('{"settings": {"levels": 2}}')
    with pytest.raises(ArtifactError, match="only be added to a model that this program built"):
        add_shapes(copy, study, tmp_path / "out")


def test_a_study_without_new_shapes_is_refused(finished, tmp_path):
    results, study = finished
    other = tmp_path / "study"
    shutil.copytree(study.parent, other)
    sheet = other / "shapes.csv"
    lines = sheet.read_text().splitlines(True)
    sheet.write_text("".join(line for line in lines if not line.startswith("S3")))
    with pytest.raises(InputError, match="shapes that the model does not have, found none"):
        add_shapes(results, other / "study.toml", tmp_path / "out")
