"""Values on the surface travel: from the arrays of the files to corresponding points and back."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from nibabel.gifti.gifti import GiftiDataArray, GiftiImage

from ostiform.api.results import read_results
from ostiform.demo.demonstration import write_demonstration
from ostiform.demo.truth import material_coordinates, read_truth
from ostiform.errors import InputError
from ostiform.model import read_correspondence
from ostiform.pipeline import Stage, add_shapes, build_study, check_study, export_results
from ostiform.pipeline.carried_fields import read_fields
from ostiform.pipeline.store import Store
from ostiform.study import (
    ShapeEntry,
    ShapeId,
    field_mesh,
    other_arrays,
    parsed_settings,
    read_study,
    surface_fields,
    values_at,
)
from ostiform.surface import RawMesh, edge_lengths, read_mesh, write_surface

pytestmark = pytest.mark.xdist_group("surface_fields")

WAVE = np.array([0.08, 0.04, 0.02])
"""Of the planted voltage, radians per mm: it bends once in 69 mm."""

FIELDS = """
[fields]
voltage = {array = "LAT_mV", units = "mV"}
region = {kind = "label"}
scar = {part = "LA", required = false, missing = -1}
"""


def voltage(material):
    """Return a smooth function of material points."""
    return 5.0 + np.sin(material @ WAVE)


def region(material):
    """Return a label of material points, and how far each is from a border (mm)."""
    level = material[:, 2] / 15.0
    return np.floor(level), 15.0 * np.abs(level - np.rint(level))


def with_arrays(study: Path) -> Path:
    """Give the files of a generated population arrays that follow from material points."""
    truth = read_truth(study.parent / "truth" / "truth.json")
    for number, entry in enumerate(read_study(study).entries):
        for part, path in entry.files.items():
            mesh = read_mesh(path)
            material = material_coordinates(truth, entry.id, part, mesh.vertices)
            points = {"LAT_mV": voltage(material), "noted": material[:, 0]}
            if number and part == "LA":
                points["scar"] = np.where(material[:, 0] > np.median(material[:, 0]), -1.0, 2.0)
            middles = mesh.vertices[mesh.faces].mean(axis=1)
            labels, _ = region(material_coordinates(truth, entry.id, part, middles))
            write_surface(path, mesh.vertices, mesh.faces, points, {"region": labels.astype(int)})
    study.write_text(
        study.read_text("utf-8") + "\n[template]\npoints = 300\n[correspondence]\nlevels = 1\n",
        "utf-8",
    )
    return study


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    return with_arrays(
        write_demonstration(tmp_path_factory.mktemp("hearts"), 3, 3, seed=7, edge_mm=6.0)
    )


@pytest.fixture(scope="module")
def study(plain):
    path = plain.with_name("fields.toml")
    path.write_text(plain.read_text("utf-8") + FIELDS, "utf-8")
    return path


@pytest.fixture(scope="module")
def output(plain, study, tmp_path_factory):
    """Results of the study without fields, then with them: only what shows them is made again."""
    folder = tmp_path_factory.mktemp("fields") / "out"
    build_study(plain, folder, until=Stage.MODEL)
    before = (folder / "correspondence.h5").stat().st_mtime_ns
    assert not (folder / "fields.bin").exists()
    assert build_study(study, folder, until=Stage.MODEL).failures == ()
    assert (folder / "correspondence.h5").stat().st_mtime_ns == before
    return folder


@pytest.fixture(scope="module")
def carried(output):
    return {field.name: field for field in read_fields(Store(output))}


def material_of(study, shapes, index):
    truth = read_truth(study.parent / "truth" / "truth.json")
    material = np.empty_like(shapes.points[index])
    for number, part in enumerate(shapes.template.parts):
        rows = shapes.template.part == number
        material[rows] = material_coordinates(
            truth, shapes.ids[index], part, shapes.points[index, rows]
        )
    return material


def material_edges(study, id):
    """Return the lengths in mm of all edges of a shape, in material coordinates."""
    truth = read_truth(study.parent / "truth" / "truth.json")
    entry = next(entry for entry in read_study(study).entries if entry.id == id)
    lengths = []
    for part, path in entry.files.items():
        mesh = read_mesh(path)
        material = material_coordinates(truth, id, part, mesh.vertices)
        lengths.append(edge_lengths(material, mesh.faces))
    return np.concatenate([each.ravel() for each in lengths])


def bend(length):
    """Return how far a sine of amplitude 1 lies from its linear interpolation over a triangle.

    Half the square of the radius of a circle round it, length / sqrt(3), by the largest slope.
    """
    return (np.linalg.norm(WAVE) * length) ** 2 / 6.0


def test_a_function_of_material_points_is_carried_within_interpolation(study, output, carried):
    shapes = read_correspondence(output / "correspondence.h5")
    assert carried["voltage"].units == "mV"
    assert [field.title for field in read_results(output).fields] == [
        "voltage (mV)", "region", "scar"
    ]  # fmt: skip
    for index, values in enumerate(carried["voltage"].values):
        error = np.abs(values - voltage(material_of(study, shapes, index)))
        lengths = material_edges(study, shapes.ids[index])
        assert np.median(error) < bend(np.median(lengths))
        assert error.max() < bend(lengths.max())


def test_labels_of_cells_are_exact_away_from_borders(study, output, carried):
    shapes = read_correspondence(output / "correspondence.h5")
    assert carried["region"].is_label
    for index, labels in enumerate(carried["region"].values):
        true, away = region(material_of(study, shapes, index))
        inside = away > 4.0
        assert inside.mean() > 0.3
        np.testing.assert_array_equal(labels[inside], true[inside])


def test_what_a_file_lacks_is_missing_and_left_out_of_means(output, carried):
    shapes = read_correspondence(output / "correspondence.h5")
    scar = carried["scar"].values
    own = np.unique(shapes.template.faces[shapes.template.face_part == 1])
    others = np.setdiff1d(np.arange(scar.shape[1]), own)
    assert shapes.template.parts[1] == "LA"
    assert np.isnan(scar[0]).all()  # its file has no such array
    assert np.isnan(scar[:, others]).all()  # nor has any other part
    known = ~np.isnan(scar[1:])
    assert 0.2 < known[:, own].mean() < 0.7  # -1 stands for none
    np.testing.assert_allclose(scar[1:][known], 2.0, rtol=1e-12)
    mean = read_mesh(output / "meshes" / "mean.vtp").point_data
    np.testing.assert_array_equal(mean["scar count"], known.sum(axis=0))
    np.testing.assert_array_equal(np.isnan(mean["scar"]), mean["scar count"] == 0)
    np.testing.assert_array_equal(np.isnan(mean["scar sd"]), mean["scar count"] < 2)
    np.testing.assert_allclose(mean["voltage"], carried["voltage"].values.mean(axis=0))
    np.testing.assert_allclose(mean["voltage sd"], carried["voltage"].values.std(axis=0, ddof=1))
    labels = carried["region"].values
    np.testing.assert_array_equal(mean["region share"], (labels == mean["region"]).mean(axis=0))


def test_fields_are_written_with_the_meshes_and_as_tables(output, carried):
    meshes = sorted((output / "meshes" / "shapes").glob("*.vtp"))
    with (output / "fields" / "voltage.csv").open(encoding="utf-8", newline="") as stream:
        header, *rows = csv.reader(stream)
    assert header[:5] == ["subject", "phase", "time", "0", "1"]
    for path, row, values in zip(meshes, rows, carried["voltage"].values, strict=True):
        np.testing.assert_array_equal(read_mesh(path).point_data["voltage"], values)
        np.testing.assert_allclose(np.array(row[3:], dtype=float), values, rtol=1e-5)
    scar = (output / "fields" / "scar.csv").read_text("utf-8").splitlines()
    assert scar[1].endswith(",,,")
    assert "nan" not in scar[1]


def test_fields_are_exported(output, carried, tmp_path):
    files = export_results(output, tmp_path, ["vtp", "csv"], n_modes=1)
    assert tmp_path / "fields" / "scar.csv" in files
    for path, values in zip(
        sorted((tmp_path / "shapes").iterdir()), carried["region"].values, strict=True
    ):
        np.testing.assert_array_equal(read_mesh(path).point_data["region"], values)
    assert "voltage sd" in read_mesh(tmp_path / "meshes" / "mean.vtp").point_data


def test_added_shapes_bring_their_fields(study, output, carried, tmp_path):
    """The third heart is taken out of the model and added again: its values are what they were."""
    fewer = tmp_path / "out"
    sheet = study.parent / "shapes.csv"
    everything = sheet.read_text("utf-8")
    rows = everything.splitlines(keepends=True)
    try:
        sheet.write_text("".join(rows[:3]), "utf-8")
        build_study(study, fewer, until=Stage.MODEL)
    finally:
        sheet.write_text(everything, "utf-8")
    added = add_shapes(fewer, study, tmp_path / "larger")
    assert added.after == 3
    shapes = read_correspondence(tmp_path / "larger" / "correspondence.h5")
    for field in read_fields(Store(tmp_path / "larger")):
        assert field.values.shape == shapes.points.shape[:2]
    voltages = read_fields(Store(tmp_path / "larger"))[0].values[2]
    error = np.abs(voltages - voltage(material_of(study, shapes, 2)))
    assert error.max() < bend(material_edges(study, shapes.ids[2]).max())
    assert (tmp_path / "larger" / "fields" / "scar.csv").read_text("utf-8").count("\n") == 4


def test_fields_that_are_named_no_longer_go(plain, study, output, tmp_path):
    text = study.read_text("utf-8")
    fewer = study.with_name("fewer.toml")
    fewer.write_text(text.replace('region = {kind = "label"}', ""), "utf-8")
    build_study(fewer, output, until=Stage.MODEL)
    assert not (output / "fields" / "region.csv").exists()
    assert "region" not in read_mesh(output / "meshes" / "mean.vtp").point_data
    build_study(plain, output, until=Stage.MODEL)
    assert not (output / "fields.bin").exists()
    assert set(read_mesh(output / "meshes" / "mean.vtp").point_data) == {"area_share"}
    build_study(study, output, until=Stage.MODEL)
    assert (output / "fields" / "region.csv").exists()


def test_check_says_what_is_missing_and_what_no_field_names(study):
    checks = check_study(study)
    assert [check.problem for check in checks] == [None] * 3
    assert {name for check in checks for name in check.arrays} == {"noted"}
    wrong = study.with_name("wrong.toml")
    wrong.write_text(study.read_text("utf-8").replace("required = false, ", ""), "utf-8")
    problem = check_study(wrong)[0].problem
    assert problem is not None
    for words in (
        "LA: expected the array scar of fields.scar",
        "the point array LAT_mV",
        "required",
    ):
        assert words in problem
    assert [check.problem for check in check_study(wrong)][1:] == [None, None]


@pytest.fixture
def square():
    """Return a square of two triangles, its field in every way that files hold one."""
    mesh = RawMesh(
        np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]),
        np.array([[0, 1, 2], [0, 2, 3]]),
        {"v": np.array([0.0, 1.0, np.nan, 1.0]), "l": np.array([1, 1, 2, 2]), "p": np.eye(4, 3)},
        {"l": np.array([7, 8]), "half": np.array([0.5, 1.0])},
    )
    head = 'schema = 1\n[shapes]\npattern = "{subject}.vtp"\n[parts.P]\n[fields]\n'

    def values(text, points, mesh=mesh, head=head):
        settings = parsed_settings(head + text)
        return values_at(field_mesh(settings, "P", mesh), settings.fields, np.array(points))

    return mesh, values


def test_values_at_points(square):
    mesh, values_of = square
    text = 'v = {}\nl = {kind = "label"}\nn = {array = "l"}'
    found = values_of(text, [[0.5, 0.0, 0], [0.2, 0.7, 0], [0.1, 0.4, 0], [5.0, 5, 0]])
    np.testing.assert_array_equal(found["v"], [0.5, np.nan, np.nan, np.nan])  # a corner has none
    np.testing.assert_array_equal(found["l"], [7, 8, 8, np.nan])  # cells before points
    np.testing.assert_allclose(found["n"][:3], [1.0, 1.7, 1.4])  # points before cells
    assert np.isnan(found["n"][3])  # far from the surface
    without = replace(mesh, cell_data={})
    found = values_of(text, [[0.4, 0.1, 0], [0.1, 0.9, 0], [0.9, 0.6, 0]], without)
    np.testing.assert_array_equal(found["l"], [1, 2, 2])


def test_a_rim_has_the_values_of_the_wall_and_not_of_its_cap(square):
    mesh, values_of = square
    head = (
        'schema = 1\n[shapes]\npattern = "{subject}.vtp"\nopen = {array = "half", "P.o" = VALUE}\n'
        '[parts.P]\nostia = ["o"]\n[fields]\n'
    )
    for cap, label in (("0.5", 8.0), ("1.0", 7.0)):
        own = head.replace("VALUE", cap)
        found = values_of('l = {kind = "label"}', [[0.5, 0.5, 0.0]], mesh, own)
        assert found["l"] == label


def test_a_shape_that_is_reflected_takes_its_values_along(square, tmp_path):
    mesh, _ = square
    write_surface(tmp_path / "a.vtp", mesh.vertices, mesh.faces, cell_data=mesh.cell_data)
    settings = parsed_settings(
        'schema = 1\nunits = "cm"\n[shapes]\npattern = "{subject}.vtp"\n[parts.P]\n'
        '[fields]\nl = {kind = "label"}\n'
    )
    entry = ShapeEntry(ShapeId("a", "0", 0.0), {"P": tmp_path / "a.vtp"}, {}, reflect=True)
    surface = surface_fields(settings, entry)["P"]
    found = values_at(surface, settings.fields, np.array([[-8.0, 2, 0], [-2, 8, 0], [18, 2, 0]]))
    np.testing.assert_array_equal(found["l"], [7, 8, np.nan])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("p = {}", "expected one number per item in the array p, found 3 numbers"),
        ('half = {kind = "label"}', "expected whole numbers in the labels half"),
        ("q = {}", "expected the array q of fields.q, found the point array v"),
        ('v = {part = "Q"}', "fields.v.part: expected a part of"),
        ("area_share = {}", "fields.area_share: expected another name"),
        ('v = {kind = "colour"}', "fields.v.kind: expected 'number' or 'label'"),
    ],
)
def test_what_is_no_field_is_told(square, text, words):
    with pytest.raises(InputError, match=words):
        square[1](text, [[0.5, 0.0, 0.0]])


PLY = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
property float f
element face 2
property list uchar int vertex_indices
end_header
0 0 0 0
1 0 0 1
1 1 0 2
0 1 0 1
3 0 1 2
3 0 2 3
"""
VTK = """# vtk DataFile Version 3.0
square
ASCII
DATASET POLYDATA
POINTS 4 float
0 0 0 1 0 0 1 1 0 0 1 0
POLYGONS 2 8
3 0 1 2
3 0 2 3
POINT_DATA 4
SCALARS f float 1
LOOKUP_TABLE default
0 1 2 1
"""


def written_square(path, mesh):
    """Write the square with x + y as the point array f, or its regions, as a format has it."""
    sums = mesh.vertices[:, 0] + mesh.vertices[:, 1]
    if path.suffix == ".gii":
        arrays = [
            GiftiDataArray(mesh.vertices.astype(np.float32), "NIFTI_INTENT_POINTSET"),
            GiftiDataArray(mesh.faces.astype(np.int32), "NIFTI_INTENT_TRIANGLE"),
            GiftiDataArray(sums.astype(np.float32), "NIFTI_INTENT_SHAPE", meta={"Name": "f"}),
        ]
        path.write_bytes(GiftiImage(darrays=arrays).to_bytes())
    elif path.suffix == ".elem":
        path.write_text("2\nTr 0 1 2 7\nTr 0 2 3 8\n")
        points = "\n".join(" ".join(f"{1000 * x:g}" for x in row) for row in mesh.vertices)
        path.with_suffix(".pts").write_text(f"4\n{points}\n")
    elif path.suffix == ".vtp":
        write_surface(path, mesh.vertices, mesh.faces, {"f": sums})
    else:
        path.write_text(PLY if path.suffix == ".ply" else VTK)


@pytest.mark.parametrize("suffix", [".vtp", ".vtk", ".ply", ".gii", ".elem"])
def test_every_format_that_holds_arrays_gives_fields(square, tmp_path, suffix):
    written_square(tmp_path / f"a{suffix}", square[0])
    region = suffix == ".elem"
    settings = parsed_settings(
        f'schema = 1\nframe = "{"RAS" if suffix == ".gii" else "LPS"}"\n'
        f'[shapes]\npattern = "{{subject}}{suffix}"\n[parts.P]\n[fields]\n'
        + ('f = {kind = "label", array = "region"}' if region else "f = {}")
    )
    entry = ShapeEntry(ShapeId("a", "0", 0.0), {"P": tmp_path / f"a{suffix}"}, {})
    surface = surface_fields(settings, entry)["P"]
    points = np.array([[0.5, 0.25, 0.0], [0.25, 0.5, 0.0]]) * (
        [-1.0, -1.0, 1.0] if suffix == ".gii" else 1.0
    )
    found = values_at(surface, settings.fields, points)["f"]
    np.testing.assert_allclose(found, [7, 8] if region else [0.75, 0.75], rtol=1e-6)
    assert other_arrays(settings, entry) == ()


def test_parts_of_one_joined_mesh_have_its_arrays(square, tmp_path):
    mesh, _ = square
    write_surface(tmp_path / "a.vtp", mesh.vertices, mesh.faces, cell_data=mesh.cell_data)
    settings = parsed_settings(
        'schema = 1\n[shapes]\npattern = "{subject}.vtp"\njoined = true\n'
        '[parts.P]\nostia = ["s"]\n[parts.Q]\nostia = ["s"]\n'
        '[[seams]]\nfirst = "P.s"\nsecond = "Q.s"\n[fields]\nl = {kind = "label", part = "Q"}\n'
    )
    path = tmp_path / "a.vtp"
    entry = ShapeEntry(ShapeId("a", "0", 0.0), {"P": path, "Q": path}, {})
    found = surface_fields(settings, entry)
    point = np.array([[0.8, 0.2, 0.0]])
    assert values_at(found["P"], settings.fields, point) == {}
    assert values_at(found["Q"], settings.fields, point)["l"] == 7
    assert other_arrays(settings, entry) == ("half",)


def test_a_label_map_has_no_arrays(tmp_path):
    settings = parsed_settings(
        'schema = 1\n[shapes]\npattern = "{subject}.nii"\n[parts.P]\n[fields]\nv = {}\n'
    )
    entry = ShapeEntry(ShapeId("a", "0", 0.0), {"P": tmp_path / "a.nii"}, {})
    with pytest.raises(InputError, match="expected meshes with the arrays of .fields."):
        surface_fields(settings, entry)
