"""Meshes as other programs write them: whole products of their choices, values compared."""

import itertools
import struct

import numpy as np
import pytest
import pyvista as pv
from nibabel.gifti.gifti import GiftiDataArray, GiftiImage
from nibabel.loadsave import save
from vtkmodules.vtkIOLegacy import vtkPolyDataWriter
from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter

from ostiform.errors import InputError
from ostiform.surface import read_cloud_or_mesh, read_mesh
from tests.oracles.holed_spheres import holed_sphere


@pytest.fixture(scope="module")
def sphere():
    vertices, faces = holed_sphere(60, [((0, 0, 1), 0.5, 12)])
    return 20.0 * vertices, faces


@pytest.fixture(scope="module")
def polygons(sphere):
    """The same surface with some pairs of neighbouring triangles as quadrilaterals."""
    _, faces = sphere
    left, listed = {tuple(face) for face in faces.tolist()}, []
    for face in faces.tolist():
        if tuple(face) not in left:
            continue
        left.discard(tuple(face))
        a, b, c = face
        other = next((f for f in left if {b, c} < set(f)), None) if len(listed) % 3 else None
        if other is not None:
            left.discard(other)
            listed.append([a, b, next(k for k in other if k not in face), c])
        else:
            listed.append(face)
    return listed


def same_surface(mesh, vertices, polygons, tolerance):
    fans = [[p[0], p[k], p[k + 1]] for p in polygons for k in range(1, len(p) - 1)]
    expected = vertices[np.array(fans)]
    np.testing.assert_allclose(mesh.vertices[mesh.faces], expected, rtol=0, atol=tolerance)


PLY_CHOICES = list(
    itertools.product(
        ("ascii", "binary_little_endian", "binary_big_endian"),
        ("float", "double"),
        ("uchar", "int", "ushort"),
        ("int", "uint", "short"),
        ("vertex_indices", "vertex_index"),
        (b"\n", b"\r\n"),
        (None, "LPS", "RAS"),
        ("triangles", "polygons", "uneven"),
    )
)


def ply_bytes(vertices, polygons, choice):
    layout, real, counter, index, name, newline, space, kind = choice
    codes = {"float": "f", "double": "d", "uchar": "B", "int": "i", "ushort": "H", "uint": "I",
             "short": "h"}  # fmt: skip
    rows = ["ply", f"format {layout} 1.0"]
    rows += [f"comment 3D Slicer output. SPACE={space}"] if space else ["comment by hand"]
    rows += [f"element vertex {len(vertices)}", *(f"property {real} {axis}" for axis in "xyz")]
    rows += ["property uchar red", f"element face {len(polygons)}"]
    rows += [f"property list {counter} {index} {name}", "property short label"]
    rows += ["property list uchar float texcoord"] if kind == "uneven" else []
    header = newline.join(row.encode() for row in (*rows, "end_header")) + newline
    items = [(codes[real] * 3 + "B", (*v, k % 200)) for k, v in enumerate(vertices.tolist())]
    for k, p in enumerate(polygons):
        texture = [0.5] * (6 if k % 2 else 0)
        code = codes[counter] + codes[index] * len(p) + "h"
        extra = (
            ("B" + "f" * len(texture), (len(texture), *texture)) if kind == "uneven" else ("", ())
        )
        items.append((code + extra[0], (len(p), *p, k - 5, *extra[1])))
    if layout == "ascii":
        return header + b"".join(" ".join(map(repr, v)).encode() + newline for _, v in items)
    order = "<" if "little" in layout else ">"
    return header + b"".join(struct.pack(order + code, *values) for code, values in items)


@pytest.mark.parametrize("layout", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_ply_files_of_every_choice_hold_the_same_surface(tmp_path, sphere, polygons, layout):
    # 648 files for each layout.
    vertices, faces = sphere
    for choice in (c for c in PLY_CHOICES if c[0] == layout):
        listed = faces.tolist() if choice[-1] == "triangles" else polygons
        path = tmp_path / "a.ply"
        path.write_bytes(ply_bytes(vertices, listed, choice))
        mesh = read_mesh(path)
        same_surface(mesh, vertices, listed, 2e-6 if choice[1] == "float" else 0.0)
        assert mesh.space == choice[-2]
        owner = np.repeat(np.arange(len(listed)), [len(p) - 2 for p in listed])
        np.testing.assert_array_equal(mesh.cell_data["label"], owner - 5)
        np.testing.assert_array_equal(mesh.point_data["red"], np.arange(len(vertices)) % 200)


def test_strips_of_a_ply_file_become_triangles(tmp_path):
    text = (
        "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\n"
        "property float z\nelement tristrips 1\nproperty list int int vertex_indices\nend_header\n"
        "0 0 0\n1 0 0\n0 1 0\n1 1 0\n0 2 0\n8 0 1 2 3 -1 2 3 4\n"
    )
    (tmp_path / "a.ply").write_text(text)
    np.testing.assert_array_equal(
        read_mesh(tmp_path / "a.ply").faces, [[0, 1, 2], [2, 1, 3], [2, 3, 4]]
    )


TEXT_CHOICES = list(
    itertools.product(
        ("%.9e", "%.30e", "%.33f", "%r"),
        ("\n", "\r\n"),
        (None, "LPS", "RAS"),
        ("plain", "joined", "indented"),
    )
)


@pytest.mark.parametrize("ending", ["vtk", "stl", "obj", "off"])
def test_text_of_every_length_and_line_end_is_the_same_surface(tmp_path, sphere, ending):
    # 72 files for each format.
    vertices, faces = sphere
    for number, newline, space, style in TEXT_CHOICES:
        title = "3D Slicer output." + (f" SPACE={space}" if space else "")
        places = [" ".join(number % x for x in v) for v in vertices.tolist()]
        if ending == "vtk":
            rows = ["# vtk DataFile Version 3.0", title, "ASCII", "DATASET POLYDATA"]
            rows += [f"POINTS {len(vertices)} double", *places]
            rows += [f"POLYGONS {len(faces)} {4 * len(faces)}"]
            rows += [f"3 {a} {b} {c}" for a, b, c in faces.tolist()]
        elif ending == "stl":
            rows = [f"solid {title}"]
            for corners in faces.tolist():
                rows += ["facet normal 0 0 0", " outer loop"]
                rows += [f"  vertex {places[k]}" for k in corners] + [" endloop", "endfacet"]
            rows += ["endsolid"]
        elif ending == "obj":
            rows = [f"# {title}", "vn 0 0 1", *(f"v {place}" for place in places)]
            gap = " \\" + newline + " " if style == "joined" else " "
            rows += [f"f {a + 1}//1 {b + 1}//1{gap}{c + 1}//1" for a, b, c in faces.tolist()]
        else:
            counts = f"{len(vertices)} {len(faces)} 0"
            rows = [f"OFF {counts}"] if style == "joined" else ["OFF", f"# {title}", counts]
            rows += places + [f"3 {a} {b} {c} 255 0 0" for a, b, c in faces.tolist()]
            space = None if style == "joined" else space
        text = newline.join(
            (" " if style == "indented" and k > 3 else "") + r for k, r in enumerate(rows)
        )
        path = tmp_path / f"a.{ending}"
        path.write_bytes((text + newline).encode())
        mesh = read_mesh(path)
        same_surface(mesh, vertices, faces.tolist(), 1e-8 if number == "%.9e" else 1e-13)
        assert mesh.space == space


XML_CHOICES = list(
    itertools.product(
        ("Ascii", "Binary", "Appended"),
        ("None", "ZLib", "LZMA", "LZ4"),
        ("UInt32", "UInt64"),
        ("LittleEndian", "BigEndian"),
        (32, 1024),
    )
)


def test_what_vtk_writes_with_any_choice_is_read(tmp_path, sphere):
    # 96 XML and 4 legacy files.
    vertices, faces = sphere
    data = pv.PolyData.from_regular_faces(vertices, faces)
    data.point_data["voltage"] = np.where(np.arange(len(vertices)) % 7, 1.5, np.nan)
    data.cell_data["scar"] = np.arange(len(faces), dtype=np.uint8)
    data.field_data["SPACE"] = ["RAS"]
    path = tmp_path / "a.vtp"
    for mode, compressor, header, order, block in XML_CHOICES:
        writer = vtkXMLPolyDataWriter()
        writer.SetFileName(str(path))
        writer.SetInputData(data)
        getattr(writer, f"SetDataModeTo{mode}")()
        getattr(writer, f"SetCompressorTypeTo{compressor}")()
        getattr(writer, f"SetHeaderTypeTo{header}")()
        getattr(writer, f"SetByteOrderTo{order}")()
        writer.SetBlockSize(block * 8)
        assert writer.Write()
        agrees_with_vtk(path, data)
    path = tmp_path / "a.vtk"
    for version, kind in itertools.product((42, 51), ("ASCII", "Binary")):
        former = vtkPolyDataWriter()
        former.SetFileName(str(path))
        former.SetInputData(data)
        former.SetFileVersion(version)
        getattr(former, f"SetFileTypeTo{kind}")()
        assert former.Write()
        agrees_with_vtk(path, data)


def agrees_with_vtk(path, data):
    mesh, other = read_mesh(path), pv.read(path)
    assert mesh.space == "RAS"
    np.testing.assert_array_equal(mesh.vertices, np.asarray(other.points, dtype=np.float64))
    np.testing.assert_array_equal(mesh.faces, other.regular_faces)
    np.testing.assert_array_equal(mesh.point_data["voltage"], data.point_data["voltage"])
    np.testing.assert_array_equal(mesh.cell_data["scar"], data.cell_data["scar"])


@pytest.mark.parametrize("word", ["-nan(ind)", "1.#QNAN", "-1.#IND", "nan(snan)", "NaN"])
def test_not_a_number_is_read_in_the_spelling_of_any_program(tmp_path, word):
    text = (
        "# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS 3 float\n"
        "0 0 0 1 0 0 0 1 0\nPOLYGONS 1 4\n3 0 1 2\nPOINT_DATA 3\nSCALARS v float 1\n"
        f"LOOKUP_TABLE default\n1 {word} 2\n"
    )
    (tmp_path / "a.vtk").write_text(text)
    np.testing.assert_array_equal(read_mesh(tmp_path / "a.vtk").point_data["v"], [1, np.nan, 2])


@pytest.mark.parametrize("ending", ["vtk", "vtp", "ply", "obj", "off", "gii"])
def test_points_without_triangles_are_a_cloud_and_no_mesh(tmp_path, ending):
    places = np.array([[1.0, 2, 3], [4, 5, 6.5]])
    path = tmp_path / f"a.{ending}"
    if ending in ("vtk", "vtp"):
        pv.PolyData(places).save(path)
    elif ending == "gii":
        save_gifti(path, places, None)
    else:
        rows = [" ".join(map(str, p)) for p in places.tolist()]
        axes = "".join(f"property float {axis}\n" for axis in "xyz")
        ply = f"ply\nformat ascii 1.0\nelement vertex 2\n{axes}end_header\n" + "\n".join(rows)
        obj = "\n".join(f"v {row}" for row in rows)
        path.write_text({"ply": ply, "obj": obj, "off": "OFF 2 0 0\n" + "\n".join(rows)}[ending])
    np.testing.assert_array_equal(read_cloud_or_mesh(path).vertices, places)
    with pytest.raises(InputError, match="found 2 points and no triangle"):
        read_mesh(path)


def save_gifti(path, vertices, faces, xform=None):
    arrays = [(vertices, "NIFTI_INTENT_POINTSET"), (faces, "NIFTI_INTENT_TRIANGLE")]
    image = GiftiImage()
    for values, intent in arrays:
        if values is not None:
            kind = "float32" if values.dtype.kind == "f" else "int32"
            item = GiftiDataArray(
                values.astype(kind), intent, datatype=f"NIFTI_TYPE_{kind.upper()}"
            )
            if xform is not None:
                item.coordsys.xform = xform
            image.add_gifti_data_array(item)
    save(image, path)


def test_a_gifti_surface_is_in_millimetres_and_ras(tmp_path, sphere):
    vertices, faces = sphere
    save_gifti(tmp_path / "a.surf.gii", vertices, faces)
    mesh = read_mesh(tmp_path / "a.surf.gii")
    same_surface(mesh, vertices, faces.tolist(), 2e-6)
    assert (mesh.space, mesh.units, mesh.notes) == ("RAS", "mm", ())
    save_gifti(tmp_path / "b.gii", vertices, faces, np.diag([1.0, 1, 1, 1]) + np.eye(4, k=3))
    assert "without the transform" in read_mesh(tmp_path / "b.gii").notes[0]
    (tmp_path / "c.gii").write_bytes(b"<GIFTI>")
    with pytest.raises(InputError, match="expected a GIfTI file"):
        read_mesh(tmp_path / "c.gii")


def test_an_opencarp_mesh_is_in_micrometres_with_its_regions(tmp_path, sphere):
    vertices, faces = sphere
    rows = [f"Tr {a} {b} {c} {k % 4}" for k, (a, b, c) in enumerate(faces.tolist())]
    (tmp_path / "a.elem").write_text("\n".join([str(len(rows) + 1), "Ln 0 1 9", *rows]))
    points = "\n".join(" ".join(map(repr, p)) for p in (1000.0 * vertices).tolist())
    with pytest.raises(InputError, match="a.pts: expected a mesh file, found none"):
        read_mesh(tmp_path / "a.elem")
    (tmp_path / "a.pts").write_text(f"{len(vertices)}\n{points}\n")
    mesh = read_mesh(tmp_path / "a.elem")
    assert mesh.units == "um"
    same_surface(mesh, 1000.0 * vertices, faces.tolist(), 0.0)
    np.testing.assert_array_equal(mesh.cell_data["region"], np.arange(len(faces)) % 4)
    (tmp_path / "a.elem").write_text("1\nTt 0 1 2 3 1\n")
    with pytest.raises(InputError, match="found Tt: extract the surface"):
        read_mesh(tmp_path / "a.elem")
    (tmp_path / "a.elem").write_text("7\nTr 0 1 2 1\n")
    with pytest.raises(InputError, match="number of its rows .* found 7 and 1 rows"):
        read_mesh(tmp_path / "a.elem")
