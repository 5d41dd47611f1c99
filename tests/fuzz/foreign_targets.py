"""Files as people have them: frames, segmentations, sheets, fields, meshes of other programs.

Each reader goes the way of a command: what a study takes from the file, not its parser alone.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import nibabel
import nrrd
import numpy as np
import pyvista as pv
import SimpleITK
from nibabel.gifti.gifti import GiftiDataArray, GiftiImage

from ostiform.fitting import FileRules, read_targets
from ostiform.study import (
    proposed_study,
    read_study,
    stated_fields,
    surface_fields,
    values_at,
    with_fields,
)
from ostiform.study.labelmaps import label_mask, read_frames, read_label_map
from ostiform.study.markups import read_markups
from ostiform.study.sheet import read_sheet
from ostiform.surface import read_mesh, write_surface

Files = list[tuple[str, list[Path], Callable[[Path], Any], str | None]]
"""Name of a reader, sound files, what reads one, and the name that the file must have."""

SHEET = (
    "subject,phase,time,LA,exclude,reflect,heart_rate_bpm,age\n"
    "A,ED,0.0,a.vtp,,yes,60,61\nB,ED,,b.vtp,no,,,\nC,ES,0.4,c.vtp,yes,no,71.5,x\n"
)
STUDY = """schema = 1
units = "um"

[parts.LA]
ostia = ["mitral", "RSPV"]

[shapes]
folder = "."
pattern = "{subject}_{phase}_{{x}}.vtp"
reflect = ["*a"]
times = {ED = 0.0, ES = 0.4}

[ostia]
trust = "geometry"
close = ["LA.spare"]

[cuts]
markups = "{subject}_{ostium}.mrk.json"

[alignment]
frame = "files"

[embedding]
coarsen = false

[fields.voltage]
array = "LAT"
units = "mV"
missing = -1.0

[fields.region]
kind = "label"
required = false

[evaluation]
folds = 0
"""


def foreign_files(folder: Path) -> Files:
    """Write sound files into a folder, and return who reads them."""
    folder.mkdir(exist_ok=True)
    sphere = pv.Sphere(radius=10.0, theta_resolution=6, phi_resolution=6)
    vertices = np.asarray(sphere.points, dtype=np.float64)
    faces = sphere.regular_faces.astype(np.int64)
    return [*_frames(folder), *_tables(folder), *_meshes(folder, vertices, faces)]


def _frames(folder: Path) -> Files:
    labels = np.zeros((6, 5, 4, 3), dtype=np.uint8)
    labels[2:5, 1:4, 1:3] = np.arange(1, 4)
    image = nibabel.Nifti1Image(labels, np.diag([-1.2, -1.2, 7.0, 1.0]))
    image.header.set_xyzt_units("mm", "sec")
    image.header["pixdim"][4] = 0.04
    image.header.set_slope_inter(1.0, 0.0)
    nibabel.save(image, folder / "f.nii")
    nrrds = []
    for axis, kind in ((0, "list"), (3, "time")):
        rows = [[1.2, 0, 0], [0, 1.2, 0], [0, 0, 7]]
        rows.insert(axis, [np.nan] * 3)
        kinds = ["domain"] * 3
        kinds.insert(axis, kind)
        header = {
            "space": "left-posterior-superior", "space directions": np.array(rows), "kinds": kinds,
            "space origin": np.zeros(3), "axis 0 index type": "numeric",
            "axis 0 index values": "0 40 80", "units": ["ms"] * 4,
        }  # fmt: skip
        nrrds.append(folder / f"{kind}.nrrd")
        nrrd.write(str(nrrds[-1]), np.moveaxis(labels, 3, axis), header, index_order="F")
    joined = SimpleITK.JoinSeries(
        [SimpleITK.GetImageFromArray(own) for own in labels.transpose(3, 2, 1, 0)]
    )
    SimpleITK.WriteImage(joined, str(folder / "f.mha"), False)
    segments: dict[str, Any] = {
        "space": "left-posterior-superior",
        "space directions": np.eye(3),
        "space origin": [0, 0, 0],
    }
    for k, name in enumerate(("LA", "LV")):
        facts = {"ID": f"s{k}", "Name": name, "LabelValue": str(k + 1), "Layer": "0"}
        facts["Extent"] = "0 5 0 4 0 3"
        segments |= {f"Segment{k}_{key}": value for key, value in facts.items()}
    nrrd.write(str(folder / "s.seg.nrrd"), labels[..., 0], segments)
    return [
        ("frames nii", [folder / "f.nii"], _all_frames, None),
        ("frames seq.nrrd", nrrds, _all_frames, "fuzzed.seq.nrrd"),
        ("frames nrrd", nrrds[::-1], _all_frames, "fuzzed.nrrd"),
        ("frames mha", [folder / "f.mha"], _all_frames, None),
        ("segments", [folder / "s.seg.nrrd"], _segment, "fuzzed.seg.nrrd"),
    ]


def _all_frames(path: Path) -> Any:
    frames = read_frames(path)
    numbers = [None] if frames is None else range(min(len(frames.times), 5))
    for number in numbers:
        read_label_map(path, number)
    (path.parent / "frames.toml").write_text(
        f'schema = 1\n[parts.LV]\n[shapes]\npattern = "{path.name}"\n', "utf-8"
    )
    read_study(path.parent / "frames.toml")


def _segment(path: Path) -> Any:
    found = read_label_map(path)
    wanted: list[int | str] = [*found.segments, 1]
    return [label_mask(found, [item]) for item in wanted]


def _tables(folder: Path) -> Files:
    sheet, wide, study = folder / "sheet.csv", folder / "wide.csv", folder / "fields.toml"
    sheet.write_text(SHEET, "utf-8")
    wide.write_text(SHEET.replace(",", "\t"), "utf-16")
    study.write_text(STUDY, "utf-8")
    listed = folder / "list.fcsv"
    listed.write_text(
        "# Markups fiducial file version = 4.11\n# CoordinateSystem = LPS\n# columns = "
        "id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID\n"
        "1,1.5,2,3,0,0,0,1,1,1,0,LA.mitral,,\n2,4,5,6,0,0,0,1,1,1,0,LA.RSPV,,\n",
        "utf-8",
    )
    undefined = folder / "undefined.mrk.json"
    points = [
        {"label": f"F-{k}", "position": [k, 1.0, 2.0], "positionStatus": status}
        for k, status in enumerate(("defined", "undefined", "missing", "preview"))
    ]
    control = {"type": "Fiducial", "coordinateSystem": "RAS", "coordinateUnits": "mm",
               "controlPoints": points}  # fmt: skip
    undefined.write_text(json.dumps({"markups": [control]}), "utf-8")
    return [
        ("marked sheet", [sheet, wide], lambda path: read_sheet(path, ("LA",)), None),
        ("study of fields", [study], _study, "study.toml"),
        ("markups fcsv", [listed], read_markups, None),
        ("undefined points", [undefined], read_markups, "cuts.mrk.json"),
    ]


def _study(path: Path) -> Any:
    for name in ("a", "b"):
        (path.parent / f"{name}_ED_{{x}}.vtp").touch()
        (path.parent / f"{name}_mitral.mrk.json").touch()
    return read_study(path)


def _meshes(folder: Path, vertices: np.ndarray, faces: np.ndarray) -> Files:
    off, elements, points = folder / "a.off", folder / "a.elem", folder / "a.pts"
    rows = [" ".join(map(repr, row)) for row in vertices.tolist()]
    corners = faces.tolist()
    triangles = [f"3 {a} {b} {c}" for a, b, c in corners]
    off.write_text("\n".join([f"OFF {len(rows)} {len(faces)} 0", *rows, *triangles]))
    elements.write_text(
        "\n".join([str(len(faces)), *(f"Tr {a} {b} {c} {a % 3}" for a, b, c in corners)]) + "\n"
    )
    points.write_text("\n".join([str(len(rows)), *rows]) + "\n")
    image = GiftiImage()
    for values, intent in (
        (vertices.astype(np.float32), "NIFTI_INTENT_POINTSET"),
        (faces.astype(np.int32), "NIFTI_INTENT_TRIANGLE"),
        (vertices[:, 0].astype(np.float32), "NIFTI_INTENT_SHAPE"),
    ):
        image.add_gifti_data_array(GiftiDataArray(values, intent))
    nibabel.save(image, folder / "a.surf.gii")
    carried = folder / "carried.vtp"
    arrays = {"voltage": vertices[:, 0], "region": np.arange(len(vertices)) % 3}
    write_surface(carried, vertices, faces, arrays, {"scar": faces[:, 0]})
    plain = folder / "carried.vtk"
    pv.read(carried).save(plain, binary=False)

    def elements_of(path: Path) -> Any:
        (path.parent / "fuzzed.pts").write_bytes(points.read_bytes())
        return read_mesh(path)

    def points_of(path: Path) -> Any:
        (path.parent / "fuzzed.elem").write_bytes(elements.read_bytes())
        return read_mesh(path.with_suffix(".elem"))

    return [
        ("mesh off", [off], read_mesh, None),
        ("mesh gii", [folder / "a.surf.gii"], read_mesh, "fuzzed.gii"),
        ("openCARP elements", [elements], elements_of, None),
        ("openCARP points", [points], points_of, None),
        ("fields vtp", [carried], _fields, None),
        ("fields vtk", [plain], _fields, None),
        ("fields of a shape", [carried], _fields_of_shape, "a.vtp"),
        ("target vtk", [plain], _target, None),
    ]


def _fields(path: Path) -> Any:
    fields = stated_fields("voltage,region:label,scar")
    mesh = read_mesh(path)
    return values_at(with_fields(fields, "LA", mesh), fields, mesh.vertices[:20])


def _fields_of_shape(path: Path) -> Any:
    text = 'schema = 1\n[parts.LA]\n[shapes]\npattern = "{subject}.vtp"\n[fields.voltage]\n'
    (path.parent / "study.toml").write_text(text, "utf-8")
    study = read_study(path.parent / "study.toml")
    (path.parent / "proposed.toml").unlink(missing_ok=True)
    proposed_study(path.parent, path.parent / "proposed.toml")
    return surface_fields(study.settings, study.entries[0])


def _target(path: Path) -> Any:
    return read_targets([str(path)], ("LA",), FileRules())
