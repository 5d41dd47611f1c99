"""Reading the model layout that statismo and scalismo publish, in all its known variants.

=========  ==================================================================================
version    what differs
=========  ==================================================================================
none, 0.8  ``pcaBasis`` holds columns times standard deviations; the reference may be the bytes
           of a legacy VTK file (``representer/reference``)
0.9, 1.x   ``pcaBasis`` holds unit columns, ``pcaVariance`` the variances
=========  ==================================================================================

In all of them the covariance is ``U diag(pcaVariance) U^T + noiseVariance I``. Files may be HDF5,
or the JSON form of HDF5 (``.json``) that newer versions of scalismo write, and may hold several
models listed in ``catalog``.
"""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.errors import InputError
from ostiform.model.algebra import principal_modes, weighted_size
from ostiform.model.hdf5 import reading
from ostiform.model.mesh import ModelMesh
from ostiform.model.types import ShapeModel
from ostiform.surface import read_legacy_vtk

PART = "surface"
"""Name of the only part of a model that states no parts."""


@contextmanager
def opened_model(path: Path) -> Iterator[h5py.File]:
    """Give a model file to read from, whether it is HDF5 or the JSON form of it.

    Raises
    ------
    ArtifactError
        If the file is missing, of neither form, or lacks something that the block asks for.
    """
    if path.suffix.lower() != ".json":
        with reading(path, "a shape model") as file:
            yield file
        return
    memory = h5py.File(f"{path.name}.memory", "w", driver="core", backing_store=False)
    with memory, reading(path, "a shape model", memory) as file:
        _fill(file, json.loads(path.read_bytes()))
        yield file


def published_model(file: h5py.File, name: str | None = None) -> ShapeModel:
    """Read the published part of a model file.

    The area weights of such a model are not known: all points weigh 1 / P, so variances are the
    file's divided by P.

    Parameters
    ----------
    file : h5py.File
    name : str, optional
        Which of several models, by its name in the catalog; the only one where there is one.

    Raises
    ------
    InputError
        If the version is unknown, arrays do not fit each other, or the model is not named.
    """
    group = _chosen(file, name)
    scaled_columns = _columns_hold_deviations(file)
    mean = np.asarray(group["model/mean"], dtype=np.float64).reshape(-1, 3)
    variances = np.asarray(group["model/pcaVariance"], dtype=np.float64).ravel()
    basis = np.asarray(group["model/pcaBasis"], dtype=np.float64)  # (3P, K)
    if basis.shape != (mean.size, len(variances)):
        raise InputError(
            f"its basis has shape {basis.shape} where the mean and the variances ask for "
            f"{(mean.size, len(variances))}"
        )
    columns = basis if scaled_columns else basis * np.sqrt(variances)
    weights = np.full(len(mean), 1.0 / len(mean))
    modes, spread = principal_modes(
        np.ascontiguousarray(columns.T).reshape(-1, *mean.shape),
        weights,
        weighted_size(mean, weights),
    )
    faces = _faces(group)
    noise = float(np.asarray(group["model/noiseVariance"]).ravel()[0])
    samples = np.asarray(group["modelinfo/scores"]).shape if "modelinfo/scores" in group else (1, 1)
    return ShapeModel(
        mean=mean,
        modes=modes,
        variances=spread,
        weights=weights,
        mesh=ModelMesh(
            faces=faces,
            face_part=np.zeros(len(faces), dtype=np.int64),
            part=np.zeros(len(mean), dtype=np.int64),
            parts=(PART,),
            loops={},
        ),
        residual_variance=3.0 * noise,
        sample_count=0 if samples == (1, 1) else int(samples[1]),
    )


def _chosen(file: h5py.File, name: str | None) -> h5py.Group:
    """Return the group of the model: the file itself unless a catalog says where."""
    catalog = {
        str(entry): _text(group["modelPath"]) for entry, group in file.get("catalog", {}).items()
    }
    if name is not None:
        if name not in catalog:
            raise InputError(
                f"it holds the models {', '.join(catalog) or '(without a catalog)'} where "
                f"{name} was asked for"
            )
        return file[catalog[name]]
    if "model" in file or not catalog:
        return file
    if len(catalog) > 1:
        raise InputError(f"it holds several models, {', '.join(catalog)}, of which one is needed")
    return file[next(iter(catalog.values()))]


def _columns_hold_deviations(file: h5py.File) -> bool:
    if "version" not in file:
        return True
    found = tuple(
        int(np.asarray(file[f"version/{name}"]).ravel()[0])
        for name in ("majorVersion", "minorVersion")
    )
    if found[0] != 1 and found not in {(0, 8), (0, 9)}:
        raise InputError(f"its version is {found[0]}.{found[1]} where 0.8, 0.9 and 1 can be read")
    return found == (0, 8)


def _faces(group: h5py.Group) -> IntArray:
    if "representer/reference" in group:
        packed = np.asarray(group["representer/reference"]).astype(np.uint8).tobytes()
        return read_legacy_vtk(packed).faces
    kind = _text(group["representer"].attrs.get("datasetType", "POLYGON_MESH"))
    if kind == "POINT_SET":
        return np.empty((0, 3), dtype=np.int64)
    if kind != "POLYGON_MESH":
        raise InputError(f"its points are a {kind} where POLYGON_MESH and POINT_SET can be read")
    cells: Any = np.asarray(group["representer/cells"])
    if cells.ndim != 2 or cells.shape[0] != 3:
        raise InputError(f"its cells have shape {cells.shape} where triangles are (3, n)")
    faces: IntArray = np.ascontiguousarray(cells.T, dtype=np.int64)
    return faces


def _text(value: Any) -> str:
    found = value[()] if isinstance(value, h5py.Dataset) else value
    found = np.asarray(found).ravel()[0]
    return found.decode("utf-8") if isinstance(found, bytes) else str(found)


def _fill(file: h5py.File, content: Mapping[str, Any]) -> None:
    """Put the groups and datasets of the JSON form of HDF5 into an open file."""
    pending = [("/", content["root"])]
    seen = set()
    while pending:
        path, identifier = pending.pop()
        if identifier in seen:
            raise InputError(f"its group {path} is listed twice")
        seen.add(identifier)
        stored = content["groups"][identifier]
        group = file.require_group(path)
        for attribute in stored.get("attributes", ()):
            group.attrs[attribute["name"]] = attribute["value"]
        for link in stored.get("links", ()):
            inner = f"{path.rstrip('/')}/{link['title']}"
            if link["collection"] == "groups":
                pending.append((inner, link["id"]))
            else:
                file[inner] = _array(content["datasets"][link["id"]])


def _array(stored: Mapping[str, Any]) -> FloatArray | str:
    if isinstance(stored["value"], str):
        return stored["value"]
    values: FloatArray = np.asarray(stored["value"])
    if values.dtype.kind not in "fiu":
        return json.dumps(stored["value"])
    dims = stored.get("shape", {}).get("dims")
    return values if dims is None else values.reshape(dims)
