"""Model files, correspondence files and VTP: round trips, the published layout, every refusal."""

from pathlib import Path

import h5py
import numpy as np
import pytest

from ostiform.errors import ArtifactError, InputError
from ostiform.model import (
    StoredModel,
    fit_model,
    mesh_of_template,
    project,
    read_correspondence,
    read_model,
    read_statismo,
    truncated,
    write_corresponded_shape,
    write_correspondence,
    write_mean,
    write_mode,
    write_model,
)
from ostiform.surface.files import read_mesh
from tests.compare import assert_same_model
from tests.populations import population

SINGLE = 2e-6  # relative: the published layout holds single precision


@pytest.fixture
def shapes():
    return population(3, 4, np.random.default_rng(11))


@pytest.fixture
def stored(shapes):
    model = truncated(
        fit_model(shapes.aligned, shapes.weights, mesh_of_template(shapes.template)), 5
    )
    return StoredModel(model, project(model, shapes.aligned), shapes.ids, shapes.template)


@pytest.fixture
def model_path(tmp_path, stored):
    path = tmp_path / "model.h5"
    write_model(path, stored)
    return path


def assert_same_template(actual, expected):
    for name in ("points", "sphere", "part", "faces", "face_part", "curve"):
        np.testing.assert_array_equal(getattr(actual, name), getattr(expected, name))
    assert (actual.parts, actual.curves) == (expected.parts, expected.curves)
    assert list(actual.loops) == list(expected.loops)
    for name, loop in expected.loops.items():
        np.testing.assert_array_equal(actual.loops[name], loop)
    assert len(actual.levels) == len(expected.levels)
    for mine, theirs in zip(actual.levels, expected.levels, strict=True):
        for name in ("index", "faces", "face_part"):
            np.testing.assert_array_equal(getattr(mine, name), getattr(theirs, name))


def test_a_model_file_keeps_every_bit(model_path, stored):
    again = read_model(model_path)
    for name in ("mean", "modes", "variances", "weights"):
        np.testing.assert_array_equal(getattr(again.model, name), getattr(stored.model, name))
    assert_same_model(again.model, stored.model)
    assert again.model.sample_count == stored.model.sample_count
    np.testing.assert_array_equal(again.scores, stored.scores)
    assert again.ids == stored.ids
    assert again.template is not None
    assert_same_template(again.template, stored.template)


def test_equal_models_make_equal_files(tmp_path, model_path, stored):
    write_model(tmp_path / "again.h5", stored)
    assert (tmp_path / "again.h5").read_bytes() == model_path.read_bytes()


def test_a_model_without_a_template_keeps_its_mesh(tmp_path, stored):
    bare = StoredModel(stored.model, np.empty((0, 5)), (), None)
    write_model(tmp_path / "bare.h5", bare)
    again = read_model(tmp_path / "bare.h5")
    assert again.template is None
    assert_same_model(again.model, stored.model)


def test_the_published_layout_has_the_published_types(model_path, stored):
    count, n_modes = len(stored.model.mean), len(stored.model.modes)
    with h5py.File(model_path) as file:
        for name, value in (("majorVersion", 0), ("minorVersion", 9)):
            version = file["version"][name]
            assert (version.shape, version.dtype, version[()]) == ((), np.int32, value)
        attributes = file["representer"].attrs
        assert attributes["name"] == b"vtkStandardMeshRepresenter"
        assert attributes["datasetType"] == b"POLYGON_MESH"
        found = {
            name: (file[name].shape, file[name].dtype.name)
            for name in (
                "representer/points",
                "representer/cells",
                "model/mean",
                "model/pcaBasis",
                "model/pcaVariance",
                "model/noiseVariance",
                "modelinfo/scores",
            )
        }
        texts = [
            file[f"modelinfo/{name}"].dtype.kind
            for name in ("build-time", "modelBuilder-0/builderName", "modelBuilder-0/buildTime")
        ]
        assert set(file["modelinfo/modelBuilder-0"]) >= {"dataInfo", "parameters"}
    assert found == {
        "representer/points": ((3, count), "float32"),
        "representer/cells": ((3, len(stored.model.mesh.faces)), "int32"),
        "model/mean": ((3 * count,), "float32"),
        "model/pcaBasis": ((3 * count, n_modes), "float32"),
        "model/pcaVariance": ((n_modes,), "float32"),
        "model/noiseVariance": ((), "float32"),
        "modelinfo/scores": ((n_modes, 12), "float32"),
    }
    assert texts == ["S", "S", "S"]


def published_covariance(path):
    with h5py.File(path) as file:
        basis = np.asarray(file["model/pcaBasis"], dtype=np.float64)
        variances = np.asarray(file["model/pcaVariance"], dtype=np.float64)
    return basis, variances, (basis * variances) @ basis.T


def test_the_published_columns_are_orthonormal_and_give_the_same_covariance(model_path, stored):
    basis, variances, covariance = published_covariance(model_path)
    np.testing.assert_allclose(basis.T @ basis, np.eye(len(variances)), atol=SINGLE)
    assert (np.diff(variances) <= 0.0).all()
    model = stored.model
    root = (model.modes * np.sqrt(model.variances)[:, None, None]).reshape(len(variances), -1).T
    expected = root @ root.T
    np.testing.assert_allclose(covariance, expected, atol=SINGLE * np.abs(expected).max())


def test_the_published_scores_reproduce_the_training_shapes_of_the_model(model_path, stored):
    basis, variances, _ = published_covariance(model_path)
    with h5py.File(model_path) as file:
        scores = np.asarray(file["modelinfo/scores"], dtype=np.float64)  # (K, N)
        mean = np.asarray(file["model/mean"], dtype=np.float64)
    shapes = (mean[:, None] + (basis * np.sqrt(variances)) @ scores).T
    expected = stored.model.mean.ravel() + stored.scores @ stored.model.modes.reshape(5, -1)
    np.testing.assert_allclose(shapes, expected, atol=SINGLE * 60.0)


def test_noise_in_the_published_layout_is_per_coordinate(model_path, stored):
    with h5py.File(model_path) as file:
        noise = float(file["model/noiseVariance"][()])
    np.testing.assert_allclose(3.0 * noise, stored.model.residual_variance, rtol=SINGLE)


def write_foreign(path, version=9, cells=None, basis_columns=3):
    """Write a model as other programs do: unit columns in 0.9, columns times sd in 0.8."""
    rng = np.random.default_rng(2)
    basis, _ = np.linalg.qr(rng.normal(size=(24, 3)))
    variances = np.array([90.0, 40.0, 10.0])
    mean = rng.normal(scale=30.0, size=24)
    with h5py.File(path, "w") as file:
        if version:
            file["version/majorVersion"] = np.int32(0)
            file["version/minorVersion"] = np.int32(version)
        stored = basis if version == 9 else basis * np.sqrt(variances)
        file["representer/points"] = mean.reshape(-1, 3).T.astype(np.float32)
        default = np.array([[0, 1, 2], [2, 3, 4]], dtype=np.uint32).T
        file["representer/cells"] = default if cells is None else cells
        file["model/mean"] = mean.astype(np.float32)
        file["model/pcaBasis"] = stored[:, :basis_columns].astype(np.float32)
        file["model/pcaVariance"] = variances.astype(np.float32)
        file["model/noiseVariance"] = np.array([0.5], dtype=np.float32)
    return mean, (basis * variances) @ basis.T


@pytest.mark.parametrize("version", [9, 8, 0])
def test_models_of_other_programs_are_read(tmp_path, version):
    mean, covariance = write_foreign(tmp_path / "foreign.h5", version)
    stored = read_model(tmp_path / "foreign.h5")
    model = stored.model
    np.testing.assert_allclose(model.mean.ravel(), mean, rtol=SINGLE, atol=1e-5)
    root = (model.modes * np.sqrt(model.variances)[:, None, None]).reshape(3, -1).T
    np.testing.assert_allclose(root @ root.T, covariance, atol=SINGLE * covariance.max() * 10)
    np.testing.assert_allclose(model.variances, [90.0 / 8, 40.0 / 8, 10.0 / 8], rtol=SINGLE)
    np.testing.assert_allclose(model.residual_variance, 1.5, rtol=SINGLE)
    assert (stored.ids, stored.template, len(stored.scores)) == ((), None, 0)
    np.testing.assert_array_equal(model.mesh.faces, [[0, 1, 2], [2, 3, 4]])


def test_reading_our_own_file_as_other_programs_do_gives_the_same_distribution(model_path, stored):
    theirs = read_statismo(model_path)
    assert theirs.sample_count == 12
    spread = np.sqrt(theirs.variances)[:, None, None]
    root = (theirs.modes * spread).reshape(5, -1).T
    _, _, covariance = published_covariance(model_path)
    np.testing.assert_allclose(root @ root.T, covariance, atol=SINGLE * covariance.max())


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda path: None, "missing, foreign or damaged"),
        (lambda path: path.write_bytes(b"no HDF5"), "missing, foreign or damaged"),
        (lambda path: h5py.File(path, "w").close(), "missing, foreign or damaged"),
        (lambda path: write_foreign(path, version=7), "version is 0.7"),
        (lambda path: write_foreign(path, basis_columns=2), "basis has shape"),
        (lambda path: write_foreign(path, cells=np.zeros((4, 2), np.int32)), "cells have shape"),
        (lambda path: write_foreign(path, cells=np.full((3, 1), 99, np.int32)), "faces"),
    ],
)
def test_what_is_no_model_is_refused(tmp_path, make, message):
    path = tmp_path / "model.h5"
    make(path)
    with pytest.raises(ArtifactError, match=message):
        read_model(path)


def test_a_model_of_another_schema_is_refused(model_path):
    with h5py.File(model_path, "a") as file:
        file["ostiform"].attrs["schema"] = 99
    with pytest.raises(ArtifactError, match="schema is 99"):
        read_model(model_path)


def test_a_failed_write_leaves_the_old_file(tmp_path, model_path, stored):
    before = model_path.read_bytes()
    model = stored.model
    mesh = type(model.mesh)(
        model.mesh.faces,
        model.mesh.face_part,
        model.mesh.part,
        model.mesh.parts,
        {"no dot": np.arange(3)},
    )
    with pytest.raises(InputError, match="PART.OSTIUM"):
        write_model(
            model_path,
            StoredModel(
                type(model)(
                    model.mean,
                    model.modes,
                    model.variances,
                    model.weights,
                    mesh,
                    model.residual_variance,
                    0,
                ),
                np.empty((0, 5)),
                (),
                None,
            ),
        )
    assert model_path.read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["model.h5"]


def test_a_correspondence_file_keeps_everything(tmp_path, shapes):
    path = tmp_path / "correspondence.h5"
    write_correspondence(path, shapes)
    again = read_correspondence(path)
    for name in ("points", "aligned", "transforms", "weights", "directions"):
        np.testing.assert_array_equal(getattr(again, name), getattr(shapes, name))
    assert again.ids == shapes.ids
    assert_same_template(again.template, shapes.template)


def test_a_correspondence_file_has_the_promised_layout(tmp_path, shapes):
    path = tmp_path / "correspondence.h5"
    write_correspondence(path, shapes)
    count, points, faces = len(shapes.ids), len(shapes.weights), len(shapes.template.faces)
    with h5py.File(path) as file:
        found = {
            name: (file[name].shape, file[name].dtype.kind)
            for name in file
            if isinstance(file[name], h5py.Dataset)
        }
        assert file["subject"].asstr()[0] == "subject 0"
        assert h5py.check_string_dtype(file["phase"].dtype).encoding == "utf-8"
        assert (file.attrs["schema"], file.attrs["units"], file.attrs["frame"]) == (1, "mm", "LPS")
        assert list(file.attrs["parts"]) == ["LV", "LA"]
        assert file["weights"][:].sum() == pytest.approx(1.0)
        np.testing.assert_array_equal(file["loops/LA/vein"][:], shapes.template.loops["LA.vein"])
        assert set(file["loops/LV/mitral"][:]) == set(file["loops/LA/mitral"][:])
        assert set(file["levels/0"]) == {"index", "faces", "face_part"}
        moved = np.einsum(
            "nij,npj->npi",
            file["transforms"][:],
            np.pad(file["points"][:], ((0, 0), (0, 0), (0, 1)), constant_values=1.0),
        )
        np.testing.assert_allclose(moved[..., :3], file["aligned"][:], atol=1e-9)
    assert found == {
        "points": ((count, points, 3), "f"),
        "aligned": ((count, points, 3), "f"),
        "directions": ((count, points, 3), "f"),
        "transforms": ((count, 4, 4), "f"),
        "faces": ((faces, 3), "i"),
        "face_part": ((faces,), "i"),
        "part": ((points,), "i"),
        "sphere": ((points,), "i"),
        "curve": ((points,), "i"),
        "template_points": ((points, 3), "f"),
        "weights": ((points,), "f"),
        "subject": ((count,), "O"),
        "phase": ((count,), "O"),
        "time": ((count,), "f"),
    }


def test_names_of_any_script_survive_a_correspondence_file(tmp_path, shapes):
    ids = tuple(type(id)("Jürgen 王", "Öffnung/½", id.time) for id in shapes.ids)
    renamed = type(shapes)(
        shapes.template,
        ids,
        shapes.directions,
        shapes.points,
        shapes.aligned,
        shapes.transforms,
        shapes.weights,
    )
    write_correspondence(tmp_path / "c.h5", renamed)
    assert read_correspondence(tmp_path / "c.h5").ids == ids


def test_what_is_no_correspondence_is_refused(tmp_path, model_path):
    for path in (model_path, tmp_path / "missing.h5"):
        with pytest.raises(ArtifactError, match="correspondence of ostiform"):
            read_correspondence(path)


def test_surfaces_are_written_where_the_model_puts_them(tmp_path, shapes, stored):
    model = stored.model
    write_mean(tmp_path / "mean.vtp", model)
    write_mode(tmp_path / "mode.vtp", model, 1, -2.0)
    write_corresponded_shape(tmp_path / "shape.vtp", shapes, 3)
    mean, mode, shape = (
        read_mesh(Path(tmp_path / f"{name}.vtp")) for name in ("mean", "mode", "shape")
    )
    np.testing.assert_array_equal(mean.vertices, model.mean)
    np.testing.assert_array_equal(mean.cell_data["part"], model.mesh.face_part)
    displaced = model.mean - 2.0 * np.sqrt(model.variances[1]) * model.modes[1]
    np.testing.assert_allclose(mode.vertices, displaced, rtol=1e-12)
    np.testing.assert_allclose(
        mode.point_data["displacement_mm"], displaced - model.mean, atol=1e-12
    )
    np.testing.assert_array_equal(shape.vertices, shapes.points[3])
    np.testing.assert_array_equal(shape.faces, shapes.template.faces)


def test_a_mode_that_does_not_exist_is_not_written(tmp_path, stored):
    with pytest.raises(InputError, match="index from 0 to 4"):
        write_mode(tmp_path / "mode.vtp", stored.model, 5, 2.0)
    assert not list(tmp_path.glob("mode*"))
