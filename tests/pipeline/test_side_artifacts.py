"""Artifacts beside the report: animations of the model, and the further columns of the sheet."""

from dataclasses import replace

import numpy as np
import pytest

from ostiform.errors import ArtifactError, InputError
from ostiform.execution import Workers
from ostiform.model import (
    StoredModel,
    dynamic_model_of,
    fit_model,
    mesh_of_template,
    project,
    write_model,
)
from ostiform.pipeline.animations import mean_cycle_animation, write_animations
from ostiform.pipeline.covariates import COVARIATES, read_covariates, write_covariates
from ostiform.pipeline.store import Store
from ostiform.study import ShapeId
from tests.populations import population


@pytest.fixture(scope="module")
def stored():
    shapes = population(3, 3, np.random.default_rng(3))
    model = fit_model(shapes.aligned, shapes.weights, mesh_of_template(shapes.template))
    return StoredModel(model, project(model, shapes.aligned), shapes.ids, shapes.template)


def test_animations_are_written_once_and_again_when_the_model_changes(stored, tmp_path):
    store = Store(tmp_path)
    write_model(
        tmp_path / "model.h5",
        replace(stored, model=stored.model.truncated(1), scores=stored.scores[:, :1]),
    )
    path = tmp_path / "animations" / "mode1.webp"
    with Workers(1) as workers:
        write_animations(store, "key", workers)
        assert (tmp_path / "animations" / "mode1" / "0000.png").is_file()
        assert not (tmp_path / "animations" / "cycle.webp").exists()
        first = path.stat().st_mtime_ns
        write_animations(store, "key", workers)
        assert path.stat().st_mtime_ns == first
        write_animations(store, "other", workers)
        assert path.stat().st_mtime_ns > first


def test_the_mean_cycle_is_animated(stored):
    animation = mean_cycle_animation(dynamic_model_of(stored), n_frames=3)
    assert len(animation.frames) == 3


def test_further_columns_are_kept_and_read_back(stored, tmp_path):
    entries = {id: {"age": f"{40 + index}"} for index, id in enumerate(stored.ids)}
    entries[ShapeId("left out", "0", 0.0)] = {"age": "99", "note": "not, in the model"}
    store = Store(tmp_path)
    write_covariates(store, list(entries), list(entries.values()))
    kept = tmp_path / COVARIATES
    assert kept.read_text("utf-8").splitlines()[0] == "subject,phase,age,note"
    rows = read_covariates(tmp_path, None, stored, None)
    assert [row[0] for row in rows] == [id.subject for id in stored.ids]
    assert [row[1]["age"] for row in rows] == [f"{40 + index}" for index in range(9)]
    one = read_covariates(tmp_path, None, stored, "ph01")
    assert [row[1]["age"] for row in one] == ["41", "44", "47"]
    first = kept.stat().st_mtime_ns
    write_covariates(store, list(entries), list(entries.values()))
    assert kept.stat().st_mtime_ns == first


def test_a_sheet_without_further_columns_leaves_no_file(stored, tmp_path):
    store = Store(tmp_path)
    write_covariates(store, stored.ids, [{"age": "40"} for _ in stored.ids])
    write_covariates(store, stored.ids, [{} for _ in stored.ids])
    assert not (tmp_path / COVARIATES).exists()
    with pytest.raises(ArtifactError, match="--sheet"):
        read_covariates(tmp_path, None, stored, None)


def test_a_sheet_about_others_is_refused(stored, tmp_path):
    sheet = tmp_path / "others.csv"
    sheet.write_text("subject,age\nX,1\n", encoding="utf-8")
    with pytest.raises(InputError, match="found X"):
        read_covariates(tmp_path, sheet, stored, None)
