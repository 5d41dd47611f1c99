"""Model files in the layouts that statismo and scalismo published, built here from the layout."""

import json
import uuid

import h5py
import numpy as np
import pytest

from ostiform.errors import ArtifactError
from ostiform.model import StoredModel, read_model, read_statismo, write_model

SINGLE = 4e-6  # relative: the layout holds single precision
VARIANCES = np.array([90.0, 40.0, 10.0])
NOISE = 0.5
LEGACY = b"""# vtk DataFile Version 3.0
reference
ASCII
DATASET POLYDATA
POINTS 8 float
"""


def distribution():
    rng = np.random.default_rng(2)
    basis, _ = np.linalg.qr(rng.normal(size=(24, 3)))
    return rng.normal(scale=30.0, size=24), basis


def foreign(file, version, kind="POLYGON_MESH", root="/"):
    """Fill a file as those programs do; columns times deviations up to version 0.8."""
    mean, basis = distribution()
    group = file.require_group(root)
    if version is not None:
        file["version/majorVersion"] = np.int32(version[0])
        file["version/minorVersion"] = np.int32(version[1])
    old = version in (None, (0, 8))
    representer = group.create_group("representer")
    representer.attrs["name"] = "itkStandardMeshRepresenter"
    representer.attrs["datasetType"] = kind
    group["representer/points"] = mean.reshape(-1, 3).T.astype(np.float32)
    if kind == "POLYGON_MESH":
        group["representer/cells"] = np.array([[0, 1, 2], [2, 3, 4]], dtype=np.int32).T
    group["model/mean"] = mean.astype(np.float32)
    group["model/pcaBasis"] = (basis * np.sqrt(VARIANCES) if old else basis).astype(np.float32)
    group["model/pcaVariance"] = VARIANCES.astype(np.float32)
    group["model/noiseVariance"] = np.array([NOISE], dtype=np.float32)


def assert_is_the_distribution(model):
    mean, basis = distribution()
    np.testing.assert_allclose(model.mean.ravel(), mean, rtol=SINGLE, atol=1e-5)
    root = (model.modes * np.sqrt(model.variances)[:, None, None]).reshape(3, -1)
    np.testing.assert_allclose(root.T @ root, (basis * VARIANCES) @ basis.T, atol=SINGLE * 900.0)
    np.testing.assert_allclose(model.variances, VARIANCES / 8.0, rtol=SINGLE)
    np.testing.assert_allclose(model.residual_variance, 3.0 * NOISE, rtol=SINGLE)


@pytest.mark.parametrize("version", [None, (0, 8), (0, 9), (1, 0), (1, 2)])
def test_every_published_version_gives_the_same_variances(tmp_path, version):
    with h5py.File(tmp_path / "model.h5", "w") as file:
        foreign(file, version)
    assert_is_the_distribution(read_statismo(tmp_path / "model.h5"))


def test_the_oldest_layout_keeps_its_reference_as_a_vtk_file(tmp_path):
    mean, _ = distribution()
    points = "\n".join(" ".join(map(str, point)) for point in mean.reshape(-1, 3))
    content = LEGACY + f"{points}\nPOLYGONS 2 8\n3 0 1 2\n3 2 3 4\n".encode()
    with h5py.File(tmp_path / "model.h5", "w") as file:
        foreign(file, None)
        del file["representer/cells"], file["representer/points"]
        file["representer"].attrs["name"] = "vtkPolyDataRepresenter"
        file["representer/reference"] = np.frombuffer(content, dtype=np.int8)
    model = read_statismo(tmp_path / "model.h5")
    assert_is_the_distribution(model)
    np.testing.assert_array_equal(model.mesh.faces, [[0, 1, 2], [2, 3, 4]])


def test_a_model_of_points_has_no_triangles_and_is_written_as_points(tmp_path):
    with h5py.File(tmp_path / "model.h5", "w") as file:
        foreign(file, (0, 9), "POINT_SET")
    model = read_statismo(tmp_path / "model.h5")
    assert_is_the_distribution(model)
    assert len(model.mesh.faces) == 0
    write_model(tmp_path / "again.h5", StoredModel(model, np.empty((0, 3)), (), None))
    with h5py.File(tmp_path / "again.h5") as file:
        assert file["representer"].attrs["datasetType"] == b"POINT_SET"
        assert "cells" not in file["representer"]
    assert_is_the_distribution(read_statismo(tmp_path / "again.h5"))


def test_a_catalog_says_where_the_model_is(tmp_path):
    with h5py.File(tmp_path / "model.h5", "w") as file:
        foreign(file, (0, 9), root="/hearts")
        file["catalog/heart/modelPath"] = "/hearts"
        file["catalog/heart/modelType"] = "POLYGON_MESH_MODEL"
    assert_is_the_distribution(read_statismo(tmp_path / "model.h5"))
    assert_is_the_distribution(read_statismo(tmp_path / "model.h5", "heart"))
    with h5py.File(tmp_path / "model.h5", "a") as file:
        file["catalog/liver/modelPath"] = "/livers"
    with pytest.raises(ArtifactError, match="heart, liver, of which one is needed"):
        read_model(tmp_path / "model.h5")
    with pytest.raises(ArtifactError, match="kidney was asked for"):
        read_statismo(tmp_path / "model.h5", "kidney")


def json_form(path):
    """The JSON form of an HDF5 file, after the hdf5-json specification."""
    groups, datasets = {}, {}

    def visit(group):
        identifier = str(uuid.uuid4())
        links = []
        for name, item in group.items():
            if isinstance(item, h5py.Group):
                target, collection = visit(item), "groups"
            else:
                target, collection = str(uuid.uuid4()), "datasets"
                value = item[()]
                datasets[target] = {
                    "alias": [item.name],
                    "shape": {"class": "H5S_SIMPLE", "dims": list(item.shape)}
                    if item.shape
                    else {"class": "H5S_SCALAR"},
                    "value": value.decode() if isinstance(value, bytes) else value.tolist(),
                }
            links.append(
                {"class": "H5L_TYPE_HARD", "collection": collection, "id": target, "title": name}
            )
        attributes = [{"name": k, "value": str(v)} for k, v in group.attrs.items()]
        groups[identifier] = {"alias": [group.name], "attributes": attributes, "links": links}
        return identifier

    with h5py.File(path) as file:
        root = visit(file)
    return {"apiVersion": "1.1.1", "root": root, "groups": groups, "datasets": datasets}


def test_the_json_form_that_newer_scalismo_writes_is_read(tmp_path):
    with h5py.File(tmp_path / "model.h5", "w") as file:
        foreign(file, (0, 9))
    (tmp_path / "model.h5.json").write_text(json.dumps(json_form(tmp_path / "model.h5")))
    stored = read_model(tmp_path / "model.h5.json")
    assert_is_the_distribution(stored.model)
    np.testing.assert_array_equal(stored.model.mesh.faces, [[0, 1, 2], [2, 3, 4]])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "missing, foreign or damaged"),
        ("{", "missing, foreign or damaged"),
        ("[]", "missing, foreign or damaged"),
        ('{"root": "a", "groups": {}}', "missing, foreign or damaged"),
        (
            '{"root": "a", "groups": {"a": {"links": '
            '[{"title": "b", "collection": "groups", "id": "a"}]}}}',
            "listed twice",
        ),
    ],
)
def test_json_that_is_no_model_is_refused(tmp_path, content, message):
    path = tmp_path / "model.json"
    if content is not None:
        path.write_text(content)
    with pytest.raises(ArtifactError, match=message):
        read_model(path)


def test_a_model_of_volumes_is_refused(tmp_path):
    with h5py.File(tmp_path / "model.h5", "w") as file:
        foreign(file, (0, 9), "VOLUME_MESH")
    with pytest.raises(ArtifactError, match="VOLUME_MESH where POLYGON_MESH"):
        read_statismo(tmp_path / "model.h5")
