"""Model files in the statismo / scalismo HDF5 layout 0.9, with a group of Ostiform's own.

The layout of those tools holds Euclidean-orthonormal columns and variances summed over all
coordinates. The part that they read therefore holds the thin singular value decomposition of
``Phi Lambda^(1/2)``: the same covariance, with its own order, columns and scores. The
area-weighted modes and scores, in double precision, are in the group ``ostiform``; the two sets
of modes differ and must not be mixed.
"""

from pathlib import Path

import h5py
import numpy as np
from scipy.linalg import svd

from ostiform.arrays import FloatArray
from ostiform.domain import Template
from ostiform.model.hdf5 import (
    check_schema,
    put_facts,
    put_ids,
    put_loops,
    put_template,
    take_ids,
    take_loops,
    take_template,
    take_texts,
    writing,
)
from ostiform.model.mesh import ModelMesh
from ostiform.model.published import opened_model, published_model
from ostiform.model.types import ShapeModel, StoredModel

OWN_GROUP = "ostiform"
REPRESENTER = "vtkStandardMeshRepresenter"


def write_model(path: Path, stored: StoredModel, build_time: str = "not recorded") -> None:
    """Write a model that statismo, scalismo and Ostiform read.

    Parameters
    ----------
    path : Path
        Should end in ``.h5``: those tools go by the suffix.
    stored : StoredModel
    build_time : str
        Text for the tools' build time; given by the caller, so that equal input makes equal files.

    Raises
    ------
    ArtifactError
        If the file cannot be written.
    """
    with writing(path) as file:
        put_model(file, stored, build_time)


def put_model(file: h5py.File, stored: StoredModel, build_time: str = "not recorded") -> None:
    """Write a model into an open file; parameters as `write_model`."""
    version = file.create_group("version")
    version.create_dataset("majorVersion", data=np.int32(0))
    version.create_dataset("minorVersion", data=np.int32(9))
    _put_representer(file, stored.model)
    rotation, deviations = _put_euclidean_model(file, stored.model)
    _put_model_info(file, stored, rotation, deviations, build_time)
    _put_own(file.create_group(OWN_GROUP), stored)


def read_model(path: Path) -> StoredModel:
    """Read a model file: Ostiform's own group where there is one, else the published layout.

    Raises
    ------
    ArtifactError
        If the file is missing, damaged or no such model.
    """
    with opened_model(path) as file:
        if OWN_GROUP in file:
            return take_model(file[OWN_GROUP])
        model = published_model(file)
        return StoredModel(model, np.empty((0, len(model.modes))), (), None)


def read_statismo(path: Path, name: str | None = None) -> ShapeModel:
    """Read the part of a model file that statismo and scalismo define, versions 0.8 to 1.

    The area weights of such a model are not known: all points weigh 1 / P, so variances are the
    file's divided by P. A file without a version is of version 0.8, whose columns hold the
    standard deviations.

    Parameters
    ----------
    path : Path
        HDF5, or its JSON form where the name ends in ``.json``.
    name : str, optional
        Which model of a file with a catalog of several.

    Raises
    ------
    ArtifactError
        If the file is missing, damaged, no model of triangles or points, or of another version.
    """
    with opened_model(path) as file:
        return published_model(file, name)


def _put_representer(file: h5py.File, model: ShapeModel) -> None:
    group = file.create_group("representer")
    for name, text in (
        ("name", REPRESENTER),
        ("version", "0.1"),
        ("datasetType", "POLYGON_MESH" if len(model.mesh.faces) else "POINT_SET"),
        ("version/majorVersion", "0"),
        ("version/minorVersion", "9"),
    ):
        group.attrs[name] = np.bytes_(text)
    group.create_dataset("points", data=model.mean.T.astype(np.float32))
    if len(model.mesh.faces):
        group.create_dataset("cells", data=model.mesh.faces.T.astype(np.int32))
    group.create_group("pointData")
    group.create_group("cellData")


def _put_euclidean_model(file: h5py.File, model: ShapeModel) -> tuple[FloatArray, FloatArray]:
    """Write the Euclidean modes; return the rotation (K', K) of standard scores and their sd."""
    spread = np.sqrt(model.variances)[:, None, None]
    factor = (model.modes * spread).reshape(-1, model.mean.size)  # (K, 3P)
    basis, deviations, rotation = svd(factor.T, full_matrices=False)  # (3P, K), (K,), (K, K)
    group = file.create_group("model")
    group.create_dataset("mean", data=model.mean.ravel().astype(np.float32))
    group.create_dataset("pcaBasis", data=basis.astype(np.float32))
    group.create_dataset("pcaVariance", data=(deviations**2).astype(np.float32))
    group.create_dataset("noiseVariance", data=np.float32(model.residual_variance / 3.0))
    return rotation, deviations


def _put_model_info(
    file: h5py.File,
    stored: StoredModel,
    rotation: FloatArray,
    deviations: FloatArray,
    build_time: str,
) -> None:
    spread = np.sqrt(stored.model.variances)
    known = spread > 0.0
    standard = np.where(known, stored.scores / np.where(known, spread, 1.0), 0.0)  # (N, K)
    scores = (standard @ rotation.T).T if len(stored.ids) else np.zeros((1, 1))  # (K, N)
    info = file.create_group("modelinfo")
    info.create_dataset("scores", data=scores.astype(np.float32))
    info.create_dataset("build-time", data=np.bytes_(build_time))
    builder = info.create_group("modelBuilder-0")
    builder.create_dataset("builderName", data=np.bytes_("ostiform"))
    builder.create_dataset("buildTime", data=np.bytes_(build_time))
    data_info = builder.create_group("dataInfo")
    for number, id in enumerate(stored.ids):
        data_info.create_dataset(f"URI_{number}", data=np.bytes_(str(id).encode("utf-8")))
    parameters = builder.create_group("parameters")
    parameters.create_dataset("modes", data=np.bytes_(str(len(deviations))))


def _put_own(group: h5py.Group, stored: StoredModel) -> None:
    model = stored.model
    put_facts(group, model.mesh.parts)
    for name in ("mean", "modes", "variances", "weights"):
        group.create_dataset(name, data=getattr(model, name))
    group.create_dataset("residual_variance", data=model.residual_variance)
    group.create_dataset("sample_count", data=model.sample_count)
    group.create_dataset("scores", data=stored.scores)
    put_ids(group, stored.ids)
    if stored.template is None:
        for name in ("faces", "face_part", "part"):
            group.create_dataset(name, data=getattr(model.mesh, name))
        put_loops(group, model.mesh.loops)
    else:
        put_template(group, stored.template)


def take_model(group: h5py.Group) -> StoredModel:
    """Read the group of this program's own from a model file."""
    check_schema(group)
    model = ShapeModel(
        mean=group["mean"][:],
        modes=group["modes"][:],
        variances=group["variances"][:],
        weights=group["weights"][:],
        mesh=ModelMesh(
            faces=group["faces"][:],
            face_part=group["face_part"][:],
            part=group["part"][:],
            parts=take_texts(group.attrs["parts"]),
            loops=take_loops(group),
        ),
        residual_variance=float(group["residual_variance"][()]),
        sample_count=int(group["sample_count"][()]),
    )
    template: Template | None = take_template(group) if "template_points" in group else None
    return StoredModel(model, group["scores"][:], take_ids(group), template)
