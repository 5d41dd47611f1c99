"""Meshes in the choices that VTK's writers have, and what VTK's own readers find in them.

``python -m tests.oracles.vtk_variants FOLDER`` writes `COUNTS` files and, beside each, an ``.npz``
of points, triangles and arrays. It is a process of its own, as VTK's readers may end theirs.
"""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy
from vtkmodules.vtkCommonCore import (
    VTK_DOUBLE,
    VTK_FLOAT,
    vtkBitArray,
    vtkIdTypeArray,
    vtkObject,
    vtkPoints,
    vtkStringArray,
)
from vtkmodules.vtkCommonDataModel import (
    vtkCellArray,
    vtkDataSetAttributes,
    vtkPolyData,
    vtkUnstructuredGrid,
)
from vtkmodules.vtkIOGeometry import vtkOBJReader, vtkOBJWriter, vtkSTLReader, vtkSTLWriter
from vtkmodules.vtkIOLegacy import (
    vtkPolyDataReader,
    vtkPolyDataWriter,
    vtkUnstructuredGridReader,
    vtkUnstructuredGridWriter,
)
from vtkmodules.vtkIOPLY import vtkPLYReader, vtkPLYWriter
from vtkmodules.vtkIOXML import (
    vtkXMLPolyDataReader,
    vtkXMLPolyDataWriter,
    vtkXMLUnstructuredGridReader,
    vtkXMLUnstructuredGridWriter,
)

COUNTS = {"vtp": 150, "vtu": 80, "vtk": 120, "vtk grid": 60, "ply": 40, "stl": 30, "obj": 20,
          "vtk text": 50, "ply text": 30, "stl text": 20, "obj text": 40}  # fmt: skip
"""640 files; those of text are written by hand, as programs without VTK do."""
KINDS = ("i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8")
NAMES = ("voltage", "wall thickness", "a_b-c", "T\u00e9l\u00e9", "100%", "x")
TRIANGLE, QUAD, POLYGON, STRIP = 5, 9, 7, 6

Rng = np.random.Generator


def grid_of_cells(rng: Rng, strips: bool) -> tuple[np.ndarray, dict[str, list[list[int]]]]:
    """Return points of a bent sheet and its cells: vertices, lines, polygons and strips."""
    n, m = int(rng.integers(2, 5)), int(rng.integers(2, 5))
    rows, columns = np.divmod(np.arange(n * m), m)
    bent = np.sin(rows + 0.3 * columns)
    points = np.stack([columns, rows, bent], axis=1) * rng.uniform(0.1, 40.0)
    cells: dict[str, list[list[int]]] = {"Verts": [], "Lines": [], "Polys": [], "Strips": []}
    flat = rng.random() < 0.5
    for i in range(n - 1):
        if strips and rng.random() < 0.5:
            cells["Strips"].append([k for j in range(m) for k in (i * m + j, (i + 1) * m + j)])
            continue
        for j in range(m - 1):
            a, b, c, d = i * m + j, i * m + j + 1, (i + 1) * m + j + 1, (i + 1) * m + j
            cells["Polys"] += [[a, b, c, d]] if flat else [[a, b, c], [a, c, d]]
    if rng.random() < 0.3:
        cells["Verts"] = [[0], [1]]
    if rng.random() < 0.3:
        cells["Lines"] = [[0, 1, 2], [2, 3]]
    return points, cells


def arrays_of(rng: Rng, count: int, ending: str) -> list[tuple[Any, str]]:
    """Return VTK arrays of `count` items, and the role that each has."""
    found = []
    roles = set()
    for name in rng.permutation(NAMES)[: int(rng.integers(1, 4))]:
        kind = str(rng.choice(KINDS))
        width = int(rng.choice([1, 1, 2, 3, 4, 6, 9]))
        values = np.trunc(100.0 * rng.standard_normal((count, width)))
        if kind[0] == "f":
            values = values / 7.0
            values[rng.random(values.shape) < 0.05] = np.nan
        if kind[0] == "u":
            values = np.abs(values)
        array = numpy_to_vtk(values.astype(kind).reshape((count, width)), deep=True)
        draw = rng.random()
        if width == 1 and draw < 0.1:
            array = vtkIdTypeArray()
            array.SetNumberOfTuples(count)
            for k in range(count):
                array.SetValue(k, int(values[k, 0]) if kind[0] != "f" else k)
        elif width == 1 and draw < 0.2:
            array = vtkBitArray()
            array.SetNumberOfTuples(count)
            for k in range(count):
                array.SetValue(k, int(rng.integers(2)))
        array.SetName(str(name))
        if rng.random() < 0.2 and width == 3:
            for k, word in enumerate("xyz"):
                array.SetComponentName(k, word)
        fits = {1: ("SCALARS", "GLOBALIDS", "PEDIGREEIDS"), 2: ("SCALARS", "TCOORDS"),
                3: ("VECTORS", "NORMALS", "SCALARS", "TCOORDS"), 4: ("SCALARS",), 6: (),
                9: ("TENSORS",)}[width]  # fmt: skip
        free = [role for role in fits if role not in roles]
        role = str(rng.choice(free)) if free and rng.random() < 0.6 else ""
        roles.add(role)
        found.append((array, role))
    if rng.random() < 0.2 and ending in ("vtp", "vtu"):
        words = vtkStringArray()
        words.SetName("note")
        words.SetNumberOfValues(count)
        for k in range(count):
            words.SetValue(k, f"row {k}")
        found.append((words, ""))
    return found


def placed(rng: Rng, data: Any, points: np.ndarray, ending: str) -> None:
    """Give points, arrays and now and then a stated frame to a data set."""
    double = rng.random() < 0.5
    holder = vtkPoints()
    holder.SetDataType(VTK_DOUBLE if double else VTK_FLOAT)
    holder.SetData(numpy_to_vtk(points.astype("f8" if double else "f4"), deep=True))
    data.SetPoints(holder)
    for attributes, count in (
        (data.GetPointData(), data.GetNumberOfPoints()),
        (data.GetCellData(), data.GetNumberOfCells()),
    ):
        for array, role in arrays_of(rng, count, ending):
            attributes.AddArray(array)
            if role and ending not in ("ply", "stl", "obj"):
                attributes.SetActiveAttribute(array.GetName(), getattr(vtkDataSetAttributes, role))
    words = vtkStringArray()
    words.SetName("SPACE")
    words.InsertNextValue(str(rng.choice(["LPS", "RAS"])))
    if rng.random() < 0.5:
        data.GetFieldData().AddArray(words)
    if rng.random() < 0.3:
        extra = numpy_to_vtk(np.arange(3.0), deep=True)
        extra.SetName("TimeValue")
        data.GetFieldData().AddArray(extra)


def poly_data(rng: Rng, ending: str) -> Any:
    points, cells = grid_of_cells(rng, strips=ending in ("vtp", "vtk"))
    data = vtkPolyData()
    if ending not in ("vtp", "vtk"):
        cells = {**cells, "Verts": [], "Lines": []}
    for group, listed in cells.items():
        if listed:
            getattr(data, f"Set{group}")(cell_array(listed))
    placed(rng, data, points, ending)
    return data


def grid(rng: Rng, ending: str) -> Any:
    points, cells = grid_of_cells(rng, strips=False)
    listed = [(cell, {1: 1, 2: 3, 3: TRIANGLE, 4: QUAD}[len(cell)]) for cell in cells["Polys"]]
    listed += [(cell, 1) for cell in cells["Verts"]] + [(cell, 4) for cell in cells["Lines"]]
    listed = [listed[k] for k in rng.permutation(len(listed))]
    data = vtkUnstructuredGrid()
    types = numpy_to_vtk(np.array([kind for _, kind in listed], np.uint8), deep=True)
    data.SetCells(types, cell_array([cell for cell, _ in listed]))
    placed(rng, data, points, ending)
    return data


def cell_array(listed: list[list[int]]) -> Any:
    offsets = np.cumsum([0, *map(len, listed)]).astype(np.int64)
    array = vtkCellArray()
    array.SetData(
        numpy_to_vtkIdTypeArray(offsets, deep=True),
        numpy_to_vtkIdTypeArray(np.concatenate(listed).astype(np.int64), deep=True),
    )
    return array


def write(rng: Rng, kind: str, path: Path) -> None:
    """Write one mesh with choices drawn at random."""
    writer: Any
    if kind.endswith("text"):
        points, cells = grid_of_cells(rng, strips=kind == "vtk text")
        path.write_text("\n".join(TEXTS[kind](rng, points, cells)) + "\n", "utf-8")
        return
    if kind in ("vtp", "vtu"):
        writer = (vtkXMLPolyDataWriter if kind == "vtp" else vtkXMLUnstructuredGridWriter)()
        writer.SetInputData(poly_data(rng, kind) if kind == "vtp" else grid(rng, kind))
        getattr(writer, f"SetDataModeTo{rng.choice(['Ascii', 'Binary', 'Appended'])}")()
        getattr(writer, f"SetCompressorTypeTo{rng.choice(['None', 'ZLib', 'LZMA', 'LZ4'])}")()
        getattr(writer, f"SetHeaderTypeTo{rng.choice(['UInt32', 'UInt64'])}")()
        getattr(writer, f"SetByteOrderTo{rng.choice(['LittleEndian', 'BigEndian'])}")()
        writer.SetEncodeAppendedData(bool(rng.random() < 0.5))
        writer.SetIdTypeToInt32() if rng.random() < 0.5 else writer.SetIdTypeToInt64()
        writer.SetBlockSize(int(rng.choice([32, 256, 32768])) * 8)
        data = writer.GetInput()
        # VTK's own reader mixes the cell arrays of several pieces that have cells of two kinds.
        if kind == "vtp" and data.GetNumberOfPolys() == data.GetNumberOfCells():
            writer.SetNumberOfPieces(int(rng.integers(1, 4)))
    elif kind in ("vtk", "vtk grid"):
        writer = (vtkPolyDataWriter if kind == "vtk" else vtkUnstructuredGridWriter)()
        writer.SetInputData(poly_data(rng, kind) if kind == "vtk" else grid(rng, kind))
        writer.SetFileVersion(int(rng.choice([42, 51])))
        getattr(writer, f"SetFileTypeTo{rng.choice(['ASCII', 'Binary'])}")()
        space = writer.GetInput().GetFieldData().GetAbstractArray("SPACE")
        stated = "" if space is None else f" SPACE={space.GetValue(0)}"
        writer.SetHeader(str(rng.choice(["vtk output", f"3D Slicer output.{stated}", ""])))
    elif kind == "ply":
        writer = vtkPLYWriter()
        data = poly_data(rng, kind)
        writer.SetInputData(data)
        if rng.random() < 0.5:
            colors = rng.integers(0, 255, (data.GetNumberOfPoints(), 3)).astype(np.uint8)
            array = numpy_to_vtk(colors, deep=True)
            array.SetName("paint")
            data.GetPointData().AddArray(array)
            writer.SetArrayName("paint")
        getattr(writer, f"SetFileTypeTo{rng.choice(['ASCII', 'Binary'])}")()
        getattr(writer, f"SetDataByteOrderTo{rng.choice(['LittleEndian', 'BigEndian'])}")()
        writer.AddComment(str(rng.choice(["by hand", "3D Slicer output. SPACE=LPS"])))
    elif kind == "stl":
        writer = vtkSTLWriter()
        writer.SetInputData(poly_data(rng, kind))
        getattr(writer, f"SetFileTypeTo{rng.choice(['ASCII', 'Binary'])}")()
        writer.SetHeader(str(rng.choice(["part", "solid thing", "3D Slicer output. SPACE=RAS"])))
    else:
        writer = vtkOBJWriter()
        writer.SetInputData(poly_data(rng, kind))
    writer.SetFileName(str(path))
    if not writer.Write():
        raise OSError(f"VTK did not write {path}")


def vtk_text(rng: Rng, points: np.ndarray, cells: dict[str, list[list[int]]]) -> list[str]:
    """Return an old file: sections in free order, attributes of every kind, odd line breaks."""
    words = [f"{x:.9g}" for x in points.ravel()]
    width = int(rng.choice([3, 7, 9, 1000]))
    rows = [f"# vtk DataFile Version {rng.choice(['1.0', '2.0', '3.0', '4.1'])}", "by hand"]
    rows += ["ASCII", "DATASET POLYDATA", f"POINTS {len(points)} {rng.choice(['float', 'double'])}"]
    rows += [" ".join(words[k : k + width]) for k in range(0, len(words), width)]
    for group, name in (("Verts", "VERTICES"), ("Lines", "LINES"), ("Polys", "POLYGONS"),
                        ("Strips", "TRIANGLE_STRIPS")):  # fmt: skip
        if cells[group]:
            lists = [[len(cell), *cell] for cell in cells[group]]
            rows += ["", f"{name} {len(lists)} {sum(map(len, lists))}"]
            rows += [" ".join(map(str, row)) for row in lists]
    n_cells = sum(map(len, cells.values()))
    for word, count in (("CELL_DATA", n_cells), ("POINT_DATA", len(points))):
        rows += [f"{word} {count}"]
        values = np.round(rng.uniform(0.0, 1.0, (count, 9)), 6)
        for k in rng.permutation(6)[:3]:
            rows += {
                0: ["SCALARS s float 1", "LOOKUP_TABLE default"],
                1: ["SCALARS t int 2", "LOOKUP_TABLE mine"],
                2: ["VECTORS v double"],
                3: ["NORMALS n float"],
                4: ["TENSORS e float"],
                5: ["FIELD FieldData 2", f"a 1 {count} short", *(["7"] * count),
                    f"b 2 {count} double"],
            }[int(k)]  # fmt: skip
            columns = (1, 2, 3, 3, 9, 2)[int(k)]
            listed = np.rint(9 * values).astype(int) if k == 1 else values
            rows += [" ".join(map(str, row[:columns])) for row in listed.tolist()]
            rows += ["LOOKUP_TABLE mine 2", "0 0 0 1", "1 1 1 1"] if k == 1 else []
    return rows


def ply_text(rng: Rng, points: np.ndarray, cells: dict[str, list[list[int]]]) -> list[str]:
    """Return a file with further properties before and after those that matter."""
    before, after = rng.random() < 0.5, rng.random() < 0.5
    rows = ["ply", "format ascii 1.0", "comment by hand", "obj_info none"]
    rows += [f"element vertex {len(points)}", *(["property float quality"] * before)]
    rows += [f"property float {axis}" for axis in "xyz"]
    rows += ["property uchar alpha"] * after + [f"element face {len(cells['Polys'])}"]
    rows += ["property list uchar int vertex_indices"] + ["property int part"] * after
    rows += ["end_header"]
    for k, point in enumerate(points):
        extra = ([k / 8], [k]) if before and after else ([k / 8] * before, [k] * after)
        rows += [" ".join(f"{x:.9g}" for x in (*extra[0], *point, *extra[1]))]
    for k, cell in enumerate(cells["Polys"]):
        rows += [" ".join(map(str, [len(cell), *cell, *([k - 3] * after)]))]
    return rows


def stl_text(rng: Rng, points: np.ndarray, cells: dict[str, list[list[int]]]) -> list[str]:
    """Return several solids, in capitals now and then."""
    triangles = [[cell[0], cell[k], cell[k + 1]] for cell in cells["Polys"]
                 for k in range(1, len(cell) - 1)]  # fmt: skip
    rows, upper = [], rng.random() < 0.3
    for part in np.array_split(np.array(triangles), int(rng.integers(1, 4))):
        rows += ["solid part one"]
        for corners in part:
            rows += ["facet normal 0 0 1", "outer loop"]
            rows += ["vertex " + " ".join(f"{x:.9e}" for x in points[k]) for k in corners]
            rows += ["endloop", "endfacet"]
        rows += ["endsolid part one"]
    return [rows[0], *(row.upper() for row in rows[1:])] if upper else rows


def obj_text(rng: Rng, points: np.ndarray, cells: dict[str, list[list[int]]]) -> list[str]:
    """Return faces by indices from the start or the end, with texture, normals and groups."""
    form = str(rng.choice(["{0}", "{0}/1", "{0}//1", "{0}/1/1"]))
    backward = rng.random() < 0.5
    rows = ["# by hand", "mtllib a.mtl", "o thing", "vt 0 0", "vn 0 0 1"]
    rows += ["v " + " ".join(f"{x:.9g}" for x in point) for point in points]
    for k, cell in enumerate(cells["Polys"]):
        rows += [f"g part{k}", "s off"] if k % 3 == 0 else []
        listed = [c - len(points) if backward and form == "{0}" else c + 1 for c in cell]
        rows += ["f " + " ".join(form.format(c) for c in listed)]
    return rows


TEXTS = {"vtk text": vtk_text, "ply text": ply_text, "stl text": stl_text, "obj text": obj_text}

READERS = {
    "vtp": vtkXMLPolyDataReader,
    "vtu": vtkXMLUnstructuredGridReader,
    "vtk": vtkPolyDataReader,
    "vtk grid": vtkUnstructuredGridReader,
    "ply": vtkPLYReader,
    "stl": vtkSTLReader,
    "obj": vtkOBJReader,
}


def found_by_vtk(kind: str, path: Path) -> dict[str, np.ndarray]:
    """Return points, triangles, arrays (of the cell of each triangle) as VTK's reader has them."""
    reader: Any = READERS[kind.removesuffix(" text")]()
    reader.SetFileName(str(path))
    for name in ("Scalars", "Vectors", "Normals", "Tensors", "TCoords", "Fields", "ColorScalars"):
        if kind.startswith("vtk"):
            getattr(reader, f"ReadAll{name}On")()
    reader.Update()
    data = reader.GetOutput()
    found = {"points": vtk_to_numpy(data.GetPoints().GetData()).astype(np.float64)}
    triangles, owners = [], []
    n_polygons = 0
    for k in range(data.GetNumberOfCells()):
        cell = data.GetCell(k)
        corners = [cell.GetPointId(i) for i in range(cell.GetNumberOfPoints())]
        if cell.GetCellType() == STRIP:
            added = [
                (corners[i], corners[i + 1 + i % 2], corners[i + 2 - i % 2])
                for i in range(len(corners) - 2)
            ]
        elif cell.GetCellDimension() == 2:
            n_polygons += 1
            added = [(corners[0], corners[i], corners[i + 1]) for i in range(1, len(corners) - 1)]
        else:
            added = []
        triangles += added
        owners += [k] * len(added)
    found["triangles"] = np.array(triangles, dtype=np.int64).reshape(-1, 3)
    for group, attributes, chosen in (
        ("point", data.GetPointData(), slice(None)),
        ("cell", data.GetCellData(), np.array(owners, dtype=np.int64)),
    ):
        for k in range(attributes.GetNumberOfArrays()):
            array = attributes.GetArray(k)
            if array is None:
                continue  # of strings
            values = (
                np.array([array.GetValue(i) for i in range(array.GetNumberOfValues())], np.uint8)
                if isinstance(array, vtkBitArray)
                else vtk_to_numpy(array)
            )
            found[f"{group} {array.GetName()}"] = values[chosen]
    space = data.GetFieldData().GetAbstractArray("SPACE")
    if space is not None:
        found["space"] = np.array(space.GetValue(0))
    return found


def main(folder: Path) -> None:
    vtkObject.GlobalWarningDisplayOff()
    rng = np.random.default_rng(5)
    listed = []
    for kind, count in COUNTS.items():
        for number in range(count):
            path = folder / f"{kind.replace(' ', '_')}_{number}.{kind.split()[0]}"
            write(rng, kind, path)
            np.savez(path.with_suffix(".npz"), allow_pickle=False, **found_by_vtk(kind, path))
            listed.append(path.name)
    (folder / "variants.json").write_text(json.dumps(listed), "utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
