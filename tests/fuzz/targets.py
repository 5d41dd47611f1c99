"""Every reader of Ostiform, with sound files to start from."""

import json
import shutil
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import nibabel
import nrrd
import numpy as np
import openpyxl
import pyvista as pv
from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter

from ostiform.artifacts import load, save
from ostiform.correspondence import Checkpoint, CorrespondenceSettings, correspond
from ostiform.correspondence.build import shared_metric_of_template
from ostiform.demo.demonstration import demonstration_truth
from ostiform.demo.truth import read_truth, write_truth
from ostiform.domain import domain_from_json, domain_to_json
from ostiform.embedding import Embeddings
from ostiform.errors import ArtifactError
from ostiform.evaluation import read_evaluation
from ostiform.model import (
    StoredModel,
    fit_model,
    mesh_of_template,
    project,
    read_correspondence,
    read_model,
    read_statismo,
    write_correspondence,
    write_model,
)
from ostiform.pipeline.store import Store
from ostiform.study import Shape, ShapeId, read_study
from ostiform.study.labelmaps import read_label_map
from ostiform.study.markups import read_markups
from ostiform.study.sheet import read_sheet
from ostiform.surface import Surface
from ostiform.surface.files import read_mesh, write_surface
from tests.fuzz.exchange_targets import exchange_files
from tests.fuzz.foreign_targets import foreign_files
from tests.oracles.warped_shapes import (
    embedded,
    one_part_domain,
    triangulated,
    warped_family,
    with_level,
)

__all__ = ["Target", "make_targets"]


@dataclass(frozen=True)
class Target:
    """One reader.

    Attributes
    ----------
    name : str
    file : str
        Name of the file that is given to it.
    seeds : tuple of bytes
        Sound files.
    read : callable
        Takes the path; may raise errors of Ostiform only.
    """

    name: str
    file: str
    seeds: tuple[bytes, ...]
    read: Callable[[Path], Any]


def make_targets(folder: Path) -> Mapping[str, Target]:
    """Write sound files of every kind into a folder and return the targets by name."""
    folder.mkdir(parents=True, exist_ok=True)
    targets = [
        *_meshes(folder),
        *_label_maps(folder),
        *_study_files(folder),
        *_artifacts(folder),
    ]
    for name, paths, read in exchange_files(folder, folder / "correspondence.h5"):
        targets.append(_target(name, paths, read, "run.json" if name == "run json" else None))
    for name, paths, read, file in foreign_files(folder / "foreign"):
        targets.append(_target(name, paths, read, file))
    return {target.name: target for target in targets}


def _target(
    name: str, paths: list[Path], read: Callable[[Path], Any], file: str | None = None
) -> Target:
    return Target(name, file or f"fuzzed{_suffix(paths[0])}", _contents(paths), read)


def _suffix(path: Path) -> str:
    return "".join(path.suffixes)


def _contents(paths: list[Path]) -> tuple[bytes, ...]:
    return tuple(path.read_bytes() for path in paths)


def _meshes(folder: Path) -> list[Target]:
    sphere = pv.Sphere(radius=10.0, theta_resolution=6, phi_resolution=6)
    sphere.point_data["label"] = np.arange(sphere.n_points, dtype=np.int32)
    sphere.cell_data["part"] = np.arange(sphere.n_cells, dtype=np.float32)
    quads = pv.Plane(i_resolution=3, j_resolution=3)
    found: dict[str, list[Path]] = {name: [] for name in ("stl", "ply", "obj", "vtk", "vtp", "vtu")}
    for suffix in ("stl", "ply", "vtk"):
        for binary in (True, False):
            path = folder / f"{suffix}{int(binary)}.{suffix}"
            (quads if suffix == "vtk" and not binary else sphere).save(path, binary=binary)
            found[suffix].append(path)
    big_endian = folder / "big.ply"
    big_endian.write_bytes(_big_endian_ply(sphere))
    found["ply"].append(big_endian)
    found["obj"].append(folder / "mesh.obj")
    found["obj"][0].write_text(_obj(sphere))
    old = folder / "old.vtk"
    old.write_text(_version_4_vtk(sphere))
    found["vtk"].append(old)
    for number, (mode, compressor) in enumerate(
        [("SetDataModeToAscii", 0), ("SetDataModeToBinary", 1), ("SetDataModeToAppended", 3),
         ("SetDataModeToAppended", 0)]
    ):  # fmt: skip
        path = folder / f"mesh{number}.vtp"
        _save_vtp(sphere, path, mode, compressor)
        found["vtp"].append(path)
    own = folder / "own.vtp"
    faces = sphere.regular_faces.astype(np.int64)
    write_surface(own, np.asarray(sphere.points, dtype=np.float64), faces)
    found["vtp"].append(own)
    grid = folder / "mesh.vtu"
    sphere.cast_to_unstructured_grid().save(grid)
    found["vtu"].append(grid)
    return [_target(f"mesh {suffix}", paths, read_mesh) for suffix, paths in found.items()]


def _save_vtp(mesh: pv.PolyData, path: Path, mode: str, compressor: int) -> None:
    writer = vtkXMLPolyDataWriter()
    writer.SetFileName(str(path))
    writer.SetInputData(mesh)
    getattr(writer, mode)()
    writer.SetCompressorType(compressor)
    writer.Write()


def _obj(mesh: pv.PolyData) -> str:
    points = "".join(f"v {x} {y} {z}\n" for x, y, z in mesh.points)
    return points + "".join(f"f {a + 1}/1/1 {b + 1} {c + 1}\n" for a, b, c in mesh.regular_faces)


def _version_4_vtk(mesh: pv.PolyData) -> str:
    points = "\n".join(" ".join(map(str, point)) for point in mesh.points)
    faces = "\n".join(f"3 {a} {b} {c}" for a, b, c in mesh.regular_faces)
    return (
        "# vtk DataFile Version 4.2\nmesh SPACE=RAS\nASCII\nDATASET POLYDATA\n"
        f"POINTS {mesh.n_points} float\n{points}\nPOLYGONS {mesh.n_cells} {4 * mesh.n_cells}\n"
        f"{faces}\nCELL_DATA {mesh.n_cells}\nSCALARS part int 1\nLOOKUP_TABLE default\n"
        + "1\n"
        * mesh.n_cells
    )


def _big_endian_ply(mesh: pv.PolyData) -> bytes:
    header = (
        f"ply\nformat binary_big_endian 1.0\nelement vertex {mesh.n_points}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {mesh.n_cells}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    corners = np.dtype([("n", "u1"), ("corners", ">i4", (3,))])
    faces = np.zeros(mesh.n_cells, corners)
    faces["n"], faces["corners"] = 3, mesh.regular_faces
    return header.encode() + mesh.points.astype(">f4").tobytes() + faces.tobytes()


def _label_maps(folder: Path) -> list[Target]:
    labels = np.zeros((8, 7, 6), dtype=np.uint8)
    labels[2:6, 2:5, 2:5] = 1
    affine = np.diag([1.2, 1.2, 7.0, 1.0])
    nifti = [folder / "a.nii", folder / "b.nii"]
    nibabel.save(nibabel.Nifti1Image(labels, affine), nifti[0])
    nibabel.save(nibabel.Nifti2Image(labels.astype(np.int16), affine), nifti[1])
    packed = [folder / "a.nii.gz"]
    nibabel.save(nibabel.Nifti1Image(labels.astype(np.float32), affine), packed[0])
    nrrds = []
    for encoding in ("raw", "gzip", "ascii", "bzip2"):
        path = folder / f"{encoding}.nrrd"
        header = {
            "space": "left-posterior-superior",
            "space directions": affine[:3, :3],
            "space origin": np.zeros(3),
            "encoding": encoding,
        }
        nrrd.write(str(path), labels, header)
        nrrds.append(path)
    metas = []
    for compressed in (False, True):
        path = folder / f"map{int(compressed)}.mha"
        path.write_bytes(_metaimage(labels, compressed))
        metas.append(path)
    return [
        _target("label map nii", nifti, read_label_map),
        _target("label map nii.gz", packed, read_label_map),
        _target("label map nrrd", nrrds, read_label_map),
        _target("label map mha", metas, read_label_map),
    ]


def _metaimage(labels: np.ndarray, compressed: bool) -> bytes:
    body = labels.tobytes(order="F")
    header = (
        "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\n"
        f"CompressedData = {compressed}\nTransformMatrix = 1 0 0 0 1 0 0 0 1\nOffset = 1 2 3\n"
        f"ElementSpacing = 1.2 1.2 7\nDimSize = {' '.join(map(str, labels.shape))}\n"
        "ElementType = MET_UCHAR\nElementDataFile = LOCAL\n"
    )
    return header.encode() + (zlib.compress(body) if compressed else body)


def _study_files(folder: Path) -> list[Target]:
    inside = folder / "study"
    inside.mkdir(exist_ok=True)
    write_surface(inside / "a_LA.vtp", np.eye(3), np.array([[0, 1, 2]]))
    toml = folder / "study.toml"
    toml.write_text(STUDY)
    csv = folder / "shapes.csv"
    csv.write_text("subject,phase,time,LA,age\nA,0,0.0,a.vtp,61\nÄ,1,0.5,b c.vtp,\n", "utf-8")
    semicolons = folder / "semicolons.csv"
    semicolons.write_text('subject;phase;LA\n"A";0;"a;b.vtp"\n', "utf-8")
    xlsx = folder / "shapes.xlsx"
    book = openpyxl.Workbook()
    for row in (["subject", "phase", "time", "LA"], ["A", 1, 0.0, "a.vtp"], ["B", 2, 0.5, None]):
        book.worksheets[0].append(row)
    book.save(xlsx)
    markups = folder / "cuts.mrk.json"
    markups.write_text(json.dumps(MARKUPS))
    truth = folder / "truth.json"
    write_truth(demonstration_truth(2, 2, 3), truth)
    return [
        _target("study.toml", [toml], lambda path: _read_study(path, inside), "study.toml"),
        _target("sheet csv", [csv, semicolons], lambda path: read_sheet(path, ("LA",))),
        _target("sheet xlsx", [xlsx], lambda path: read_sheet(path, ("LA",))),
        _target("markups json", [markups], read_markups, "cuts.mrk.json"),
        _target("truth json", [truth], read_truth),
    ]


def _read_study(path: Path, inside: Path) -> Any:
    if not (path.parent / "surfaces").exists():
        shutil.copytree(inside, path.parent / "surfaces")
    return read_study(path)


def _artifacts(folder: Path) -> list[Target]:
    domain = one_part_domain()
    family = warped_family(domain, 3, np.random.default_rng(3), n_vertices=300)
    template = with_level(triangulated(domain, 120), domain, 60)
    settings = CorrespondenceSettings(levels=2, n_points=120, n_optimised=50, sweeps=1)
    shared = shared_metric_of_template(family.samplers, family.ids, domain, template, settings)
    states = []
    trained = correspond(family.samplers, family.ids, shared, settings, save=states.append)
    built = trained["optimal"].correspondence
    correspondence = folder / "correspondence.h5"
    write_correspondence(correspondence, built)
    model = fit_model(built.aligned, built.weights, mesh_of_template(built.template))
    scores = project(model, built.aligned)
    with_template, without = folder / "model.h5", folder / "bare.h5"
    write_model(with_template, StoredModel(model, scores, built.ids, built.template))
    write_model(without, StoredModel(model, np.empty((0, len(model.modes))), (), None))
    published = folder / "statismo.h5"
    shutil.copy(with_template, published)
    with h5py.File(published, "r+") as file:
        del file["ostiform"]
    state = folder / "state.bin"
    save(state, states[-1])
    embeddings = folder / "embeddings.bin"
    mesh = triangulated(domain, 100)
    save(embeddings, (embedded(domain, mesh, 10.0 * mesh.points, mesh.points),), Embeddings)
    shape = folder / "shape.bin"
    loops = {name.partition(".")[2]: loop for name, loop in mesh.loops.items()}
    surface = Surface(10.0 * mesh.points, mesh.faces, loops)
    save(shape, Shape(ShapeId("S", "0", 0.0), {"A": surface}, (), ("mended",)))
    return [
        _target("correspondence.h5", [correspondence], read_correspondence),
        _target("model.h5", [with_template, without, published], read_model),
        _target("statismo.h5", [published, with_template], read_statismo),
        _target("checkpoint bin", [state], partial(load, kind=Checkpoint)),
        _target("embeddings bin", [embeddings], partial(load, kind=Embeddings)),
        _target("shape bin", [shape], lambda path: load(path, Shape)),
        *_json_artifacts(folder, domain),
    ]


def _json_artifacts(folder: Path, domain: Any) -> list[Target]:
    paths = {}
    for name, value in (
        ("domain", domain_to_json(domain)),
        ("evaluation", EVALUATION),
        ("record", {"schema": 1, "version": "0", "key": "k", "sha256": "0" * 64}),
    ):
        paths[name] = folder / f"{name}.json"
        paths[name].write_text(json.dumps(value))
    return [
        _target("domain json", [paths["domain"]], lambda path: _stored(path, domain_from_json)),
        _target("evaluation json", [paths["evaluation"]], read_evaluation),
        _target("record json", [paths["record"]], _is_current),
    ]


def _stored(path: Path, decode: Callable[[Any], Any]) -> Any:
    return decode(Store(path.parent).read_json(path.name))


def _is_current(path: Path) -> bool:
    store = Store(path.parent)
    with store.writing("a.bin", "k") as temporary:
        temporary.write_bytes(b"content")
    shutil.copyfile(path, path.parent / ".ostiform" / "a.bin.json")
    if store.is_current("a.bin", "k"):
        raise ArtifactError("a damaged record was believed")
    return False


STUDY = """schema = 1
units = "mm"
frame = "LPS"
repair = true
pole = "LA.mitral"

[parts.LA]
ostia = ["mitral", "RSPV"]

[parts.LV]
ostia = ["mitral"]

[[seams]]
first = "LV.mitral"
second = "LA.mitral"

[shapes]
folder = "surfaces"
pattern = "{subject}_{part}.vtp"
on_error = "skip"

[ostia.points]
"LA.RSPV" = [-38.7, -28.8, 20.7]

[alignment]
mode = "rigid"
per = "subject"

[template]
points = 500

[correspondence]
levels = 3
noise_mm = 0.3
seed = 4

[evaluation]
modes = 2
specificity_samples = 50

[domain.circles."LA.RSPV"]
center = [0.0, 0.0, 1.0]
radius_deg = 12.0
"""

MARKUPS = {
    "@schema": "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/"
    "Resources/Schema/markups-schema-v1.0.3.json#",
    "markups": [
        {
            "type": "Plane",
            "name": "LA.mitral",
            "coordinateSystem": "LPS",
            "center": [1.0, 2.0, 3.0],
            "normal": [0.0, 0.0, 1.0],
            "size": [20.0, 30.0],
            "controlPoints": [{"position": [1.0, 2.0, 3.0], "positionStatus": "defined"}],
        },
        {
            "type": "ClosedCurve",
            "name": "LA.RSPV",
            "coordinateSystem": "RAS",
            "controlPoints": [
                {"position": [0.0, 0.0, 0.0]},
                {"position": [5.0, 0.0, 0.0]},
                {"position": [5.0, 5.0, 1.0]},
                {"position": [0.0, 5.0, 0.0]},
            ],
        },
        {
            "type": "Fiducial",
            "coordinateSystem": "LPS",
            "controlPoints": [{"label": "LA.LSPV", "position": [1.0, 1.0, 1.0]}],
        },
        {
            "type": "Plane",
            "name": "LA.LIPV",
            "coordinateSystem": "LPS",
            "controlPoints": [{"position": [0.0, 0.0, 0.0]}],
            "baseToNode": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1],
            "planeBounds": [-10.0, 10.0, -10.0, 10.0],
        },
    ],
}

EVALUATION = {
    "schema": 1,
    "units": "mm",
    "package_version": "0",
    "kind": "optimal",
    "shapes": [{"subject": "S", "phase": "0", "time": 0.0}],
    "compactness": {"variances_mm2": [2.0, 1.0], "cumulative_mm2": [2.0, 3.0], "total_mm2": 3.0},
    "description_length": {"value": 12.0, "l_cut_mm2": 0.1},
    "specificity": {
        "mode_counts": [0, 1],
        "mean_mm": [1.0, 2.0],
        "standard_error_mm": [0.1, 0.2],
        "n_samples": 50,
    },
    "coverage": [
        {
            "p95_mm": 1.0,
            "maximum_mm": 2.0,
            "diameter_mm": 50.0,
            "smallest_share": 0.1,
            "smallest_share_ratio": 0.5,
        }
    ],
    "generalisation": {
        "division": "subjects",
        "mode_counts": [0, 1],
        "point_mm": {"mean": [1.0, 0.5], "shapes": [[1.0, 0.5]]},
        "surface_mean_mm": {"mean": [1.0, 0.5], "shapes": [[1.0, 0.5]]},
        "surface_p95_mm": {"mean": [1.0, 0.5], "shapes": [[1.0, 0.5]]},
        "surface_max_mm": {"mean": [1.0, 0.5], "shapes": [[1.0, 0.5]]},
    },
    "truth": {"mean_mm": 1.0, "p95_mm": 2.0, "parts": {"LA": {"mean_mm": 1.0, "p95_mm": 2.0}}},
}
