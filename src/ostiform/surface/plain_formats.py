"""Readers of the formats without arrays of their own kind: PLY, STL and OBJ.

They take the bytes of a file and never trust a count in its header further than the bytes reach.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ostiform.arrays import IntArray
from ostiform.errors import InputError
from ostiform.surface.raw_mesh import (
    Array,
    RawMesh,
    polygon_notes,
    triangles_of_polygons,
)

_STL_HEADER = 84
_STL_TRIANGLE = np.dtype([("vectors", "<f4", (4, 3)), ("attribute", "<u2")])
_PLY_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_PLY_FACE_LISTS = ("vertex_indices", "vertex_index")


@dataclass(frozen=True, slots=True)
class _Property:
    name: str
    kind: str
    count_kind: str | None  # of a list


@dataclass(frozen=True, slots=True)
class _Element:
    name: str
    count: int
    properties: tuple[_Property, ...]


def read_stl(content: bytes) -> RawMesh:
    """Return the triangles of an STL file, three vertices of their own each."""
    is_text = content[:5].lower() == b"solid" and b"facet" in content[:4096].lower()
    if not is_text:
        if len(content) < _STL_HEADER:
            raise InputError(f"expected an STL file, found {len(content)} bytes")
        announced = int.from_bytes(content[80:84], "little")
        room = (len(content) - _STL_HEADER) // _STL_TRIANGLE.itemsize
        if announced > room:
            raise InputError(
                f"expected {announced} triangles as the header says, found room for {room}: export "
                "the file again"
            )
        records = np.frombuffer(content, _STL_TRIANGLE, announced, _STL_HEADER)
        corners = records["vectors"][:, 1:].astype(np.float64)  # (F, 3, 3)
    else:
        if b"endsolid" not in content[-4096:].lower():
            raise InputError("expected an STL file that ends with endsolid, found a shorter one")
        written = re.findall(rb"(?i)\bvertex\s+(\S+)\s+(\S+)\s+(\S+)", content)
        if len(written) % 3:
            raise InputError(f"expected three vertices per facet, found {len(written)} in all")
        corners = np.array(written, dtype="S32").astype(np.float64).reshape(-1, 3, 3)
    return RawMesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))


def read_obj(content: bytes) -> RawMesh:
    """Return the vertices and faces of an OBJ file; normals and texture are ignored."""
    vertices: list[list[bytes]] = []
    polygons: list[list[int]] = []
    for number, line in enumerate(content.splitlines(), start=1):
        words = line.split()
        if not words or words[0] not in (b"v", b"f"):
            continue
        if len(words) < 4:
            raise InputError(f"line {number}: expected three values, found {len(words) - 1}")
        if words[0] == b"v":
            vertices.append(words[1:4])
            continue
        corners = [int(word.partition(b"/")[0]) for word in words[1:]]
        if 0 in corners:
            raise InputError(f"line {number}: expected vertex numbers from 1, found 0")
        polygons.append([k - 1 if k > 0 else len(vertices) + k for k in corners])
    ends = np.cumsum([0, *(len(corners) for corners in polygons)])
    listed = np.array([k for corners in polygons for k in corners], dtype=np.int64)
    faces, owner = triangles_of_polygons(ends, listed)
    return RawMesh(
        np.array(vertices, dtype="S32").astype(np.float64).reshape(-1, 3),
        faces,
        notes=polygon_notes(owner),
    )


def read_ply(content: bytes) -> RawMesh:
    """Return the vertices, faces and further vertex and face properties of a PLY file."""
    header, mark, body = content.partition(b"end_header")
    if not content.startswith(b"ply") or not mark:
        raise InputError("expected a PLY file with a complete header, found none")
    lines = [line.split() for line in header.decode("latin-1").splitlines()]
    layout = next((words[1] for words in lines if words[:1] == ["format"]), "")
    elements = _ply_elements(lines)
    body = body[body.index(b"\n") + 1 :]
    orders = {"binary_little_endian": "<", "binary_big_endian": ">"}
    if layout in orders:
        tables = _ply_binary(body, elements, orders[layout])
    elif layout == "ascii":
        tables = _ply_ascii(body.split(), elements)
    else:
        raise InputError(f'expected the format ascii or binary of PLY, found "{layout}"')
    for needed in ("vertex", "face"):
        if needed not in tables:
            raise InputError(f"expected an element {needed}, found {', '.join(tables) or 'none'}")
    points, cells = tables["vertex"], tables["face"]
    if not {"x", "y", "z"} <= set(points):
        raise InputError(f"expected x, y and z of every vertex, found {', '.join(points)}")
    corners = next((cells[name] for name in _PLY_FACE_LISTS if name in cells), None)
    if corners is None:
        raise InputError(f"expected vertex indices of every face, found {', '.join(cells)}")
    if corners.ndim != 2:
        raise InputError("expected a list of vertex indices per face, found one number")
    n_faces, size = corners.shape
    faces, owner = triangles_of_polygons(
        size * np.arange(n_faces + 1), corners.astype(np.int64).reshape(-1)
    )
    return RawMesh(
        np.stack([points[axis].astype(np.float64) for axis in "xyz"], axis=1),
        faces,
        {name: values for name, values in points.items() if name not in "xyz"},
        {name: v[owner] for name, v in cells.items() if name not in _PLY_FACE_LISTS},
        notes=polygon_notes(owner),
    )


def _ply_elements(lines: Sequence[Sequence[str]]) -> list[_Element]:
    elements: list[_Element] = []
    for words in lines:
        if words[:1] == ["element"] and len(words) == 3 and words[2].isdecimal():
            elements.append(_Element(words[1], int(words[2]), ()))
        elif words[:1] == ["property"]:
            is_list = words[1:2] == ["list"]
            if not elements or len(words) != (5 if is_list else 3):
                raise InputError(f'expected a PLY property, found "{" ".join(words)}"')
            kinds = words[2:4] if is_list else words[1:2]
            unknown = [kind for kind in kinds if kind not in _PLY_TYPES]
            if unknown:
                raise InputError(f"expected a PLY number type, found {unknown[0]}")
            added = _Property(
                words[-1], _PLY_TYPES[kinds[-1]], _PLY_TYPES[kinds[0]] if is_list else None
            )
            last = elements[-1]
            elements[-1] = _Element(last.name, last.count, (*last.properties, added))
        elif words[:1] == ["element"]:
            raise InputError(f'expected a PLY element with its count, found "{" ".join(words)}"')
    return elements


def _ply_binary(
    body: bytes, elements: Sequence[_Element], order: str
) -> dict[str, dict[str, Array]]:
    """Read elements whose lists all have the length of the first one, as triangles have."""
    tables, start = {}, 0
    for element in elements:
        fields: list[Any] = []
        sizes: dict[str, int] = {}
        reach = start
        for item in element.properties:
            if item.count_kind is None:
                fields.append((item.name, order + item.kind))
                reach += np.dtype(item.kind).itemsize
                continue
            counter = np.dtype(order + item.count_kind)
            size = 0
            if element.count:
                _require(body, reach + counter.itemsize)
                size = int(np.frombuffer(body, counter, 1, reach)[0])
            _require(body, reach + max(size, 0))
            sizes[item.name] = size
            fields += [(f"#{item.name}", counter.str), (item.name, order + item.kind, (size,))]
            reach += counter.itemsize + size * np.dtype(item.kind).itemsize
        record = np.dtype(fields)
        _require(body, start + element.count * record.itemsize)
        values = np.frombuffer(body, record, element.count, start)
        for name, size in sizes.items():
            _require_equal_lists(element, values[f"#{name}"], size)
        tables[element.name] = {item.name: values[item.name] for item in element.properties}
        start += element.count * record.itemsize
    return tables


def _ply_ascii(words: Sequence[bytes], elements: Sequence[_Element]) -> dict[str, dict[str, Array]]:
    tables, start = {}, 0
    for element in elements:
        columns, width, sizes = {}, 0, {}
        for item in element.properties:
            if item.count_kind is not None:
                size = 0
                if element.count:
                    _require(words, start + width + 1)
                    size = int(words[start + width])
                sizes[width] = size
                columns[item.name] = slice(width + 1, width + 1 + size)
                width += 1 + size
            else:
                columns[item.name] = slice(width, width + 1)
                width += 1
        _require(words, start + element.count * width)
        part = np.array(words[start : start + element.count * width], dtype="S32")
        table = part.astype(np.float64).reshape(element.count, width)
        for column, size in sizes.items():
            _require_equal_lists(element, table[:, column], size)
        tables[element.name] = {
            item.name: table[:, columns[item.name]].astype(item.kind)
            if item.count_kind is not None
            else table[:, columns[item.name].start].astype(item.kind)
            for item in element.properties
        }
        start += element.count * width
    return tables


def _require(content: Sequence[object] | bytes, end: int) -> None:
    if end > len(content):
        raise InputError(
            "expected as many items as the header says, found the end of the file: export it again"
        )


def _require_equal_lists(element: _Element, sizes: IntArray | Array, size: int) -> None:
    other = np.flatnonzero(sizes != size)
    if len(other):
        raise InputError(
            f"expected triangles only, found lists of {size} and {int(sizes[other[0]])} items in "
            f"the element {element.name}: triangulate the surface"
        )
