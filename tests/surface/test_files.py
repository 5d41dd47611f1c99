import numpy as np
import pytest
import pyvista as pv
from vtkmodules.vtkIOLegacy import vtkPolyDataWriter, vtkUnstructuredGridWriter
from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter, vtkXMLUnstructuredGridWriter

from ostiform.errors import ArtifactError, InputError
from ostiform.surface import RawMesh, read_mesh, write_surface
from ostiform.surface.files import without_duplicate_vertices
from tests.oracles.holed_spheres import holed_sphere

PLY = b"""ply
format ascii 1.0
comment by hand
element vertex 4
property float x
property float y
property double z
property uchar red
element face 2
property list uchar int vertex_indices
property int label
end_header
0 0 0 1
1 0 0 2
0 1 0 3
0 0 1.5 4
3 0 1 2 7
3 0 3 1 8
"""
OBJ = b"""# by hand
v 0 0 0
v 1 0 0
v 0 1 0
vt 0 0
vn 0 0 1
f 1/1/1 2/1/1 3/1/1
v 0 0 1
f -4//1 -1//1 -3//1
"""
STL = b"""solid by hand
facet normal 0 0 1
 outer loop
  vertex 0 0 0
  vertex 1 0 0
  vertex 0 1 0
 endloop
endfacet
facet normal 0 0 1
 outer loop
  vertex 1 0 0
  vertex 1 1e0 0
  vertex 0 1 0
 endloop
endfacet
endsolid by hand
"""
LEGACY = b"""# vtk DataFile Version 3.0
by hand SPACE=RAS
ASCII
DATASET POLYDATA
FIELD FieldData 1
note 1 1 string
hello%20there
POINTS 4 float
0 0 0 1 0 0 0 1 0 0 0 1
VERTICES 1 2
1 0
POLYGONS 2 8
3 0 1 2
3 0 3 1
CELL_DATA 3
SCALARS label int 1
LOOKUP_TABLE default
9 7 8
POINT_DATA 4
NORMALS n float
0 0 1 0 0 1 0 0 1 0 0 1
COLOR_SCALARS c 2
0 1 0 1 0 1 0 1
LOOKUP_TABLE t 1
0 0 0 1
FIELD more 1
a%20b 1 4 double
1 2 3 4
METADATA
INFORMATION 0

"""


@pytest.fixture(scope="module")
def surface():
    """A sphere with two holes and arrays; positions are float32 numbers, so every format fits."""
    vertices, faces = holed_sphere(150, [((0, 0, 1), 0.5, 20), ((1, 0, 0), 0.3, 14)])
    data = pv.PolyData.from_regular_faces(vertices.astype(np.float32).astype(float), faces)
    data.cell_data["label"] = np.arange(len(faces), dtype=np.int32)
    data.point_data["normal"] = vertices
    data.point_data["count"] = np.arange(len(vertices), dtype=np.int64)
    return data


def check(mesh, surface):
    # VTK prints eleven digits in ASCII.
    np.testing.assert_allclose(mesh.vertices, surface.points, rtol=0, atol=1e-11)
    np.testing.assert_array_equal(mesh.faces, surface.regular_faces)
    np.testing.assert_array_equal(mesh.cell_data["label"], surface.cell_data["label"])
    np.testing.assert_array_equal(mesh.point_data["count"], surface.point_data["count"])
    np.testing.assert_allclose(mesh.point_data["normal"], surface.point_data["normal"], atol=1e-7)


def parsed(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content)
    return read_mesh(path)


@pytest.mark.parametrize("mode", ["Ascii", "Binary", "Appended", "Base64"])
@pytest.mark.parametrize("compressor", ["None", "ZLib", "LZMA"])
@pytest.mark.parametrize("header", ["UInt32", "UInt64"])
@pytest.mark.parametrize("grid", [False, True])
def test_xml_files_are_read_in_every_encoding(tmp_path, surface, mode, compressor, header, grid):
    writer = vtkXMLUnstructuredGridWriter() if grid else vtkXMLPolyDataWriter()
    path = tmp_path / ("a.vtu" if grid else "a.vtp")
    writer.SetFileName(str(path))
    writer.SetInputData(surface.cast_to_unstructured_grid() if grid else surface)
    getattr(writer, f"SetDataModeTo{'Appended' if mode == 'Base64' else mode}")()
    writer.SetEncodeAppendedData(mode == "Base64")
    getattr(writer, f"SetCompressorTypeTo{compressor}")()
    getattr(writer, f"SetHeaderTypeTo{header}")()
    writer.SetBlockSize(1024)  # several blocks and a partial one
    if header == "UInt64":
        writer.SetByteOrderToBigEndian()
    assert writer.Write()
    check(read_mesh(path), surface)


@pytest.mark.parametrize("version", [42, 51])
@pytest.mark.parametrize("kind", ["ASCII", "Binary"])
@pytest.mark.parametrize("grid", [False, True])
def test_legacy_files_are_read_in_every_version(tmp_path, surface, version, kind, grid):
    writer = vtkUnstructuredGridWriter() if grid else vtkPolyDataWriter()
    path = tmp_path / "a.vtk"
    writer.SetFileName(str(path))
    writer.SetInputData(surface.cast_to_unstructured_grid() if grid else surface)
    getattr(writer, f"SetFileTypeTo{kind}")()
    writer.SetFileVersion(version)
    assert writer.Write()
    check(read_mesh(path), surface)


@pytest.mark.parametrize("ending", ["vtp", "vtk"])
@pytest.mark.parametrize("binary", [True, False])
def test_points_and_lines_are_ignored_and_strips_become_triangles(tmp_path, ending, binary):
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 2, 0], [5, 5, 5]])
    data = pv.PolyData(
        points, faces=[3, 0, 2, 1], lines=[2, 0, 5], verts=[1, 5], strips=[4, 1, 2, 3, 4]
    )
    data.cell_data["label"] = np.array([1, 2, 3, 4])
    path = tmp_path / f"a.{ending}"
    data.save(path, binary=binary)
    mesh = read_mesh(path)
    np.testing.assert_array_equal(mesh.faces, [[0, 2, 1], [1, 2, 3], [3, 2, 4]])
    np.testing.assert_array_equal(mesh.cell_data["label"], [3, 4, 4])
    np.testing.assert_array_equal(mesh.faces, data.triangulate().regular_faces)


@pytest.mark.parametrize("ending", ["ply", "stl", "obj"])
@pytest.mark.parametrize("binary", [True, False])
def test_plain_formats_agree_with_another_reader(tmp_path, surface, ending, binary):
    surface.save(tmp_path / f"a.{ending}", **({} if ending == "obj" else {"binary": binary}))
    mesh = read_mesh((tmp_path / f"a.{ending}").rename(tmp_path / f"a b ü.{ending.upper()}"))
    assert len(mesh.vertices) == surface.n_points
    np.testing.assert_allclose(
        mesh.vertices[mesh.faces], surface.points[surface.regular_faces], atol=1e-6
    )


def test_a_ply_file_keeps_its_properties(tmp_path):
    mesh = parsed(tmp_path, "a.ply", PLY)
    np.testing.assert_array_equal(mesh.faces, [[0, 1, 2], [0, 3, 1]])
    np.testing.assert_array_equal(mesh.vertices[3], [0, 0, 1.5])
    np.testing.assert_array_equal(mesh.point_data["red"], [1, 2, 3, 4])
    np.testing.assert_array_equal(mesh.cell_data["label"], [7, 8])


def test_a_big_endian_ply_file_is_read(tmp_path):
    header = PLY.partition(b"0 0 0 1\n")[0].replace(b"ascii", b"binary_big_endian")
    vertex = np.dtype([("x", ">f4"), ("y", ">f4"), ("z", ">f8"), ("r", "u1")])
    face = np.dtype([("n", "u1"), ("v", ">i4", (3,)), ("l", ">i4")])
    body = np.array([(0, 0, 0, 1), (1, 0, 0, 2), (0, 1, 0, 3), (0, 0, 1.5, 4)], vertex).tobytes()
    body += np.array([(3, (0, 1, 2), 7), (3, (0, 3, 1), 8)], face).tobytes()
    one, two = parsed(tmp_path, "a.ply", header + body), parsed(tmp_path, "b.ply", PLY)
    np.testing.assert_array_equal(one.vertices, two.vertices)
    np.testing.assert_array_equal(one.faces, two.faces)
    np.testing.assert_array_equal(one.cell_data["label"], two.cell_data["label"])


def test_an_obj_file_counts_from_one_and_from_the_end(tmp_path):
    mesh = parsed(tmp_path, "a.obj", OBJ)
    np.testing.assert_array_equal(mesh.faces, [[0, 1, 2], [0, 3, 1]])
    assert len(mesh.vertices) == 4


def test_vertices_of_an_stl_file_are_merged_where_they_are_equal(tmp_path):
    mesh = parsed(tmp_path, "a.stl", STL)
    np.testing.assert_array_equal(mesh.vertices, [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    np.testing.assert_array_equal(mesh.faces, [[0, 1, 2], [1, 3, 2]])


def test_merging_keeps_arrays_and_the_sign_of_zero_does_not_matter():
    mesh = RawMesh(
        np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [-0.0, 0, 0]]),
        np.array([[0, 1, 2], [3, 2, 1]]),
        {"a": np.arange(4)},
    )
    merged = without_duplicate_vertices(mesh)
    np.testing.assert_array_equal(merged.faces, [[0, 1, 2], [0, 2, 1]])
    np.testing.assert_array_equal(merged.point_data["a"], [0, 1, 2])


@pytest.mark.parametrize("ending", [b"\n", b"\r\n"])
def test_a_legacy_file_by_hand_is_read(tmp_path, ending):
    mesh = parsed(tmp_path, "a.vtk", LEGACY.replace(b"\n", ending))
    assert mesh.space == "RAS"
    np.testing.assert_array_equal(mesh.faces, [[0, 1, 2], [0, 3, 1]])
    np.testing.assert_array_equal(mesh.cell_data["label"], [7, 8])
    np.testing.assert_array_equal(mesh.point_data["a b"], [1, 2, 3, 4])
    assert sorted(mesh.point_data) == ["a b", "c", "n"]


def test_pieces_of_one_file_become_one_mesh(tmp_path, surface):
    path = tmp_path / "a.vtp"
    surface.save(path, binary=False)
    text = path.read_text()
    piece = text[text.index("<Piece") : text.index("</Piece>") + len("</Piece>")]
    mesh = parsed(tmp_path, "b.vtp", text.replace(piece, piece + piece).encode())
    assert len(mesh.vertices) == 2 * surface.n_points
    np.testing.assert_array_equal(
        mesh.faces[surface.n_cells :], surface.regular_faces + surface.n_points
    )
    assert len(mesh.cell_data["label"]) == 2 * surface.n_cells


def test_what_is_written_is_read_back_bit_for_bit_here_and_by_vtk(tmp_path, surface, rng):
    vertices = rng.normal(size=surface.points.shape)
    faces = surface.regular_faces.astype(np.int64)
    path = tmp_path / "new" / "folder é" / "a.vtp"
    point_data = {"v": vertices, "flag <&>": vertices[:, 0] > 0}
    write_surface(path, vertices, faces, point_data, {"part": np.ones(len(faces), np.int64)})
    mesh, other = read_mesh(path), pv.read(path)
    for found in (mesh.vertices, other.points):
        np.testing.assert_array_equal(found, vertices)
    for found in (mesh.faces, other.regular_faces):  # type: ignore[assignment]
        np.testing.assert_array_equal(found, faces)
    assert mesh.space == "LPS"
    assert other.field_data["SPACE"][0] == "LPS"
    np.testing.assert_array_equal(mesh.point_data["v"], other.point_data["v"])
    np.testing.assert_array_equal(mesh.point_data["flag <&>"], vertices[:, 0] > 0)
    before = path.read_bytes()
    write_surface(path, vertices, faces, point_data, {"part": np.ones(len(faces), np.int64)})
    assert path.read_bytes() == before
    assert [file.name for file in path.parent.iterdir()] == ["a.vtp"]


def test_what_cannot_be_written_is_refused(tmp_path, surface):
    vertices, faces = surface.points, surface.regular_faces
    with pytest.raises(InputError, match=r"a name ending in .vtp, found .stl"):
        write_surface(tmp_path / "a.stl", vertices, faces)
    with pytest.raises(InputError, match="expected 152 values in the array a, found 3|values in"):
        write_surface(tmp_path / "a.vtp", vertices, faces, {"a": np.arange(3)})
    with pytest.raises(InputError, match="expected numbers in the array a, found <U1"):
        write_surface(tmp_path / "a.vtp", vertices, faces, {"a": np.full(len(vertices), "x")})
    (tmp_path / "file").touch()
    with pytest.raises(ArtifactError):
        write_surface(tmp_path / "file" / "a.vtp", vertices, faces)


BINARY_STL = bytes(80) + (1000).to_bytes(4, "little") + bytes(100)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        (
            "a.xyz",
            b"1",
            ".vtk, .vtu, .ply, .stl, .obj, .off, .gii, .elem, found .xyz",
        ),
        ("a", b"1", "found no ending"),
        ("a.vtp", b"", "found an empty file"),
        ("a.vtp", b"solid x", "expected an XML VTK file, found a mistake"),
        ("a.vtp", b"<html/>", "expected an XML VTK file, found <html>"),
        ("a.vtp", b'<!DOCTYPE x [<!ENTITY a "b">]><VTKFile/>', "document type declaration"),
        ("a.vtp", b'<VTKFile type="ImageData"/>', "found ImageData: extract the surface"),
        ("a.vtp", b'<VTKFile type="PolyData"><PolyData/></VTKFile>', "found no points"),
        ("a.vtp", b'<VTKFile type="PolyData" compressor="vtkZstdDataCompressor"/>', "found Zstd"),
        ("a.vtp", b'<VTKFile type="PolyData" header_type="Int8"/>', "found Int8"),
        ("a.vtp", b"<VTKFile><AppendedData>_abc", "appended data without an end"),
        ("a.vtk", b"# vtk", "expected the header of a legacy VTK file"),
        ("a.vtk", LEGACY.replace(b"POLYDATA", b"RECTILINEAR_GRID"), "found DATASET RECTILINEAR"),
        ("a.vtk", LEGACY.replace(b"3 0 3 1", b"3 0 4 1"), "indices from 0 to 3 .* found 0 to 4"),
        ("a.vtk", LEGACY.replace(b"3 0 3 1", b"2 0 3 1"), "found a damaged list"),
        (
            "a.vtk",
            LEGACY.replace(b"POINTS 4", b"POINTS 99999999999999"),
            "more bytes as the header",
        ),
        ("a.vtk", LEGACY.replace(b"POINTS 4 float", b"POINTS 4 quad"), "number type, found quad"),
        ("a.vtk", LEGACY.replace(b"POINTS 4", b"POINTS -4"), 'a count after POINTS, found "-4"'),
        (
            "a.vtk",
            LEGACY.replace(b"CELL_DATA 3", b"CELL_DATA 2"),
            "expected more words after 8, found the line",
        ),
        ("a.vtk", LEGACY.replace(b"0 0 0 1 0", b"0 0 0 nan 0"), "1 that are NaN or infinite"),
        ("a.vtk", LEGACY.replace(b"DATA 3", b"DATA 4").replace(b"9 7", b"9 7 7"), "label, found 4"),
        ("a.vtk", LEGACY.replace(b"1 0 0", b"one 0 0"), "expected numbers where the VTK format"),
        ("a.vtk", LEGACY[: LEGACY.index(b"POLYGONS")], "found 4 points and no triangle"),
        ("a.ply", b"ply\nformat ascii 1.0\n", "complete header, found none"),
        ("a.ply", PLY.replace(b"ascii", b"text"), 'ascii or binary of PLY, found "text"'),
        ("a.ply", PLY.replace(b"vertex 4", b"vertex 400"), "found the end of the file"),
        ("a.ply", PLY.replace(b"vertex 4", b"vertex four"), 'found "element vertex four"'),
        ("a.ply", PLY.replace(b"uchar red", b"byte red"), "number type, found byte"),
        ("a.ply", PLY.replace(b"uchar red", b"uchar"), 'a PLY property, found "property uchar"'),
        ("a.ply", PLY.replace(b"element face", b"element edge"), "4 points and no triangle"),
        ("a.ply", PLY.replace(b"float y", b"float t"), "x, y and z of every vertex, found x, t"),
        ("a.ply", PLY.replace(b"element vertex", b"element point"), "found no vertex"),
        ("a.ply", PLY.replace(b"vertex_indices", b"corners"), "vertex indices of every face"),
        ("a.ply", PLY.replace(b"3 0 3 1 8", b"4 0 3 1 8"), "2 of the element face as the header"),
        ("a.ply", PLY.replace(b"1 0 0 2", b"1 0 0 300"), 'numbers of type uint8, found "300"'),
        ("a.ply", PLY.replace(b"3 0 1 2 7", b"3 0 1 1.5 7"), 'type int32, found "1.5"'),
        ("a.ply", PLY.replace(b"by hand", b"SPACE=XYZ"), "found SPACE=XYZ"),
        ("a.stl", b"abc", "found 3 bytes"),
        ("a.stl", BINARY_STL, "expected 1000 triangles .* found room for 2"),
        ("a.stl", STL[:150], "ends with endsolid"),
        (
            "a.stl",
            STL.replace(b"vertex 0 0 0", b"vertx 0 0 0"),
            "three vertices per facet, found 5",
        ),
        ("a.obj", OBJ.replace(b"v 0 1 0", b"v 0 1"), "line 4: expected three values, found 2"),
        ("a.obj", OBJ.replace(b"f -4", b"f 0"), "line 9: expected vertex numbers from 1, found 0"),
        ("a.obj", b"v 0 0 0\n", "found 1 points and no triangle"),
        ("a.obj", b"# nothing\n", "found no points"),
    ],
)
def test_a_file_that_cannot_be_used_is_refused_in_one_sentence(tmp_path, name, content, message):
    with pytest.raises(InputError, match=message) as error:
        parsed(tmp_path, name, content)
    assert str(error.value).startswith(str(tmp_path / name))


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    with pytest.raises(InputError, match="found none: check the path"):
        read_mesh(tmp_path / "a.vtp")
    (tmp_path / "b.vtp").mkdir()
    with pytest.raises(InputError, match="cannot be read"):
        read_mesh(tmp_path / "b.vtp")


def test_cells_of_other_kinds_are_refused(tmp_path, surface):
    pv.Sphere().delaunay_3d().save(tmp_path / "a.vtu")
    with pytest.raises(InputError, match=r"cells of other kinds \(VTK cell type 10\)"):
        read_mesh(tmp_path / "a.vtu")


@pytest.mark.parametrize("ending", ["vtp", "vtk", "vtu", "ply", "obj"])
def test_quadrilaterals_become_triangles_and_this_is_noted(tmp_path, ending):
    quads = pv.Plane(i_resolution=2, j_resolution=2)
    quads.cell_data["label"] = np.array([5, 6, 7, 8])
    path = tmp_path / f"a.{ending}"
    if ending == "vtu":
        quads.cast_to_unstructured_grid().save(path)
    elif ending == "obj":
        rows = [f"v {x} {y} {z}" for x, y, z in quads.points]
        rows += [
            f"f {a + 1} {b + 1} {c + 1} {d + 1}" for _, a, b, c, d in quads.faces.reshape(4, 5)
        ]
        path.write_text("\n".join(rows), encoding="utf-8")
    elif ending == "ply":
        rows = ["ply", "format ascii 1.0", "element vertex 9", "property float x"]
        rows += ["property float y", "property float z", "element face 4"]
        rows += ["property list uchar int vertex_indices", "property int label", "end_header"]
        rows += [f"{x} {y} {z}" for x, y, z in quads.points]
        rows += [
            f"4 {a} {b} {c} {d} {label}"
            for label, (_, a, b, c, d) in enumerate(quads.faces.reshape(4, 5), start=5)
        ]
        path.write_text("\n".join(rows), encoding="utf-8")
    else:
        quads.save(path)
    found = read_mesh(path)
    assert found.notes == ("split 4 polygons into triangles",)
    corners = found.vertices[found.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    np.testing.assert_allclose(normals, np.tile([[0.0, 0.0, 0.25]], (8, 1)), atol=1e-7)
    if ending != "obj":
        np.testing.assert_array_equal(found.cell_data["label"], [5, 5, 6, 6, 7, 7, 8, 8])


def test_a_polygon_of_two_corners_is_refused(tmp_path):
    (tmp_path / "a.ply").write_bytes(
        PLY.replace(b"3 0 1 2", b"2 0 1").replace(b"3 0 3 1", b"2 0 3")
    )
    with pytest.raises(InputError, match="polygons of three or more corners, found 2 with fewer"):
        read_mesh(tmp_path / "a.ply")


@pytest.mark.parametrize("ending", ["vtp", "vtk", "vtu", "ply", "stl", "obj"])
def test_damaged_files_end_in_a_sentence_or_a_mesh(tmp_path, surface, ending, rng):
    path = tmp_path / f"a.{ending}"
    data = surface.cast_to_unstructured_grid() if ending == "vtu" else surface
    data.save(path)
    whole = path.read_bytes()
    refused = 0
    for k in range(60):
        damaged = bytearray(whole)
        if k % 2:
            del damaged[rng.integers(len(whole)) :]
        else:
            for place in rng.integers(0, min(len(whole), 600), 4):
                damaged[place] ^= 1 << rng.integers(8)
        try:
            parsed(tmp_path, f"b.{ending}", bytes(damaged))
        except InputError:
            refused += 1
    assert refused >= 20
