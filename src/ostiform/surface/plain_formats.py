"""Readers of STL, OBJ, OFF and openCARP meshes, which have little or no header.

They take the bytes of a file and never trust a count in it further than the bytes reach.
"""

import re
from collections.abc import Sequence

import numpy as np

from ostiform.errors import InputError
from ostiform.surface.raw_mesh import (
    Array,
    RawMesh,
    numbers_of_words,
    polygon_notes,
    stated_space,
    triangles_of_polygons,
)

_STL_HEADER = 84
_STL_TRIANGLE = np.dtype([("vectors", "<f4", (4, 3)), ("attribute", "<u2")])
_CARP_CORNERS = {"Tr": 3, "Qd": 4}
_CARP_WITHOUT_AREA = ("Ln", "cx")


def read_stl(content: bytes) -> RawMesh:
    """Return the triangles of an STL file, three vertices of their own each."""
    announced = int.from_bytes(content[80:84], "little")
    room = (len(content) - _STL_HEADER) // _STL_TRIANGLE.itemsize
    fits = len(content) == _STL_HEADER + announced * _STL_TRIANGLE.itemsize
    head = content[:4096].lower()
    if not fits and head.lstrip().startswith(b"solid") and b"facet" in head:
        if b"endsolid" not in content[-4096:].lower():
            raise InputError("expected an STL file that ends with endsolid, found a shorter one")
        written = re.findall(rb"(?i)\bvertex\s+(\S+)\s+(\S+)\s+(\S+)", content)
        if len(written) % 3:
            raise InputError(f"expected three vertices per facet, found {len(written)} in all")
        words = [word for vertex in written for word in vertex]
        corners = numbers_of_words(words, "f8").reshape(-1, 3, 3)
        title = content.partition(b"\n")[0]
    else:
        if len(content) < _STL_HEADER:
            raise InputError(f"expected an STL file, found {len(content)} bytes")
        if announced > room or (announced == 0 and room):
            raise InputError(
                f"expected {announced} triangles as the header says, found room for {room}: export "
                "the file again"
            )
        records = np.frombuffer(content, _STL_TRIANGLE, announced, _STL_HEADER)
        corners = records["vectors"][:, 1:].astype(np.float64)  # (F, 3, 3)
        title = content[:80]
    return RawMesh(
        corners.reshape(-1, 3),
        np.arange(3 * len(corners)).reshape(-1, 3),
        space=stated_space(title.decode("latin-1")),
    )


def read_obj(content: bytes) -> RawMesh:
    """Return the vertices and faces of an OBJ file; normals and texture are ignored."""
    vertices: list[bytes] = []
    corners: list[int] = []
    ends = [0]
    comments = b" ".join(re.findall(rb"(?m)^\s*#([^\r\n]*)", content))
    joined = re.sub(rb"\\[ \t]*\r?\n", b" ", content) if b"\\" in content else content
    for number, line in enumerate(joined.splitlines(), start=1):
        words = line.split()
        if not words or words[0] not in (b"v", b"f"):
            continue
        if len(words) < 4:
            raise InputError(f"line {number}: expected three values, found {len(words) - 1}")
        if words[0] == b"v":
            vertices += words[1:4]
            continue
        listed = [int(word.partition(b"/")[0]) for word in words[1:]]
        if 0 in listed:
            raise InputError(f"line {number}: expected vertex numbers from 1, found 0")
        corners += [k - 1 if k > 0 else len(vertices) // 3 + k for k in listed]
        ends.append(len(corners))
    faces, owner = triangles_of_polygons(np.array(ends), np.array(corners, dtype=np.int64))
    return RawMesh(
        numbers_of_words(vertices, "f8").reshape(-1, 3),
        faces,
        space=stated_space(comments.decode("latin-1")),
        notes=polygon_notes(owner),
    )


def read_off(content: bytes) -> RawMesh:
    """Return the vertices and faces of an OFF file; normals, colours and texture are ignored."""
    rows = _rows(content)
    kind = rows[0][0].upper() if rows and not rows[0][0].isdigit() else b"OFF"
    if not re.fullmatch(rb"(ST)?C?N?OFF", kind) or b"BINARY" in rows[0][1:]:
        raise InputError(
            "expected an ASCII OFF file of three coordinates, found "
            f"{b' '.join(rows[0]).decode('latin-1')[:40] if rows else 'no header'}"
        )
    if not rows[0][0].isdigit():
        rows = ([rows[0][1:]] if len(rows[0]) > 1 else []) + rows[1:]
    counts = [int(word) for word in rows[0][:2]] if rows else []
    if len(counts) < 2 or min(counts) < 0 or len(rows) < 1 + sum(counts):
        raise InputError(
            "expected as many vertices and faces as the header says, found "
            f"{max(len(rows) - 1, 0)} rows for {counts}: export the file again"
        )
    vertices = _columns(rows[1 : 1 + counts[0]], 0, 3)
    listed = rows[1 + counts[0] : 1 + sum(counts)]
    faces, owner = _polygons([[int(row[0])] for row in listed], listed)
    comments = b" ".join(re.findall(rb"#([^\r\n]*)", content)).decode("latin-1")
    return RawMesh(vertices, faces, space=stated_space(comments), notes=polygon_notes(owner))


def read_carp(content: bytes, points: bytes) -> RawMesh:
    """Return the triangles of an openCARP mesh from its ``.elem`` and ``.pts``, in micrometres.

    Lines are ignored; the region of each element, where given, is the cell array ``region``.
    """
    rows = _counted_rows(content, ".elem")
    vertices = carp_points(points)
    if vertices is None:
        raise InputError("expected a .pts file that begins with its number of points beside it")
    names = [row[0].decode("latin-1") for row in rows]
    others = sorted(set(names) - {*_CARP_CORNERS, *_CARP_WITHOUT_AREA})
    if others:
        raise InputError(
            f"expected elements Tr and Qd, found {', '.join(others)[:60]}: extract the surface of "
            "the volume first (meshtool extract surface)"
        )
    flat = [row for row, name in zip(rows, names, strict=True) if name in _CARP_CORNERS]
    sizes = [[_CARP_CORNERS[row[0].decode()]] for row in flat]
    faces, owner = _polygons(sizes, flat)
    data: dict[str, Array] = {}
    if flat and all(len(row) > 1 + size for row, (size,) in zip(flat, sizes, strict=True)):
        labels = [row[1 + size] for row, (size,) in zip(flat, sizes, strict=True)]
        data["region"] = numbers_of_words(labels, "i8")[owner]
    return RawMesh(vertices, faces, {}, data, notes=polygon_notes(owner), units="um")


def carp_points(content: bytes) -> Array | None:
    """Return the points (n, 3) of an openCARP ``.pts`` file in micrometres.

    None where the first line is not the number of points: other programs' files of that ending.
    """
    rows = _rows(content)
    if not rows or len(rows[0]) != 1 or not rows[0][0].isdigit() or len(rows) < 2:
        return None
    return _columns(_counted_rows(content, ".pts"), 0, 3)


def _rows(content: bytes) -> list[list[bytes]]:
    lines = (line.partition(b"#")[0].split() for line in content.splitlines())
    return [words for words in lines if words]


def _counted_rows(content: bytes, ending: str) -> list[list[bytes]]:
    rows = _rows(content)
    if not rows or not rows[0][0].isdigit() or int(rows[0][0]) != len(rows) - 1:
        raise InputError(
            f"expected the number of its rows in the first line of {ending}, found "
            f"{b' '.join(rows[0]).decode('latin-1')[:20] if rows else 'nothing'} and "
            f"{max(len(rows) - 1, 0)} rows: export the file again"
        )
    return rows[1:]


def _columns(rows: Sequence[Sequence[bytes]], first: int, count: int) -> Array:
    short = next((row for row in rows if len(row) < first + count), None)
    if short is not None:
        raise InputError(f"expected {count} numbers in a row, found {len(short)}")
    words = [word for row in rows for word in row[first : first + count]]
    return numbers_of_words(words, "f8").reshape(-1, count)


def _polygons(
    sizes: Sequence[Sequence[int]], rows: Sequence[Sequence[bytes]]
) -> tuple[Array, Array]:
    """Return the triangles and owners of rows that name something and then their corners."""
    ends = np.cumsum([0, *(size for (size,) in sizes)])
    if any(len(row) < 1 + size for row, (size,) in zip(rows, sizes, strict=True)):
        raise InputError("expected as many corners as each face says, found a shorter row")
    words = [word for row, (size,) in zip(rows, sizes, strict=True) for word in row[1 : 1 + size]]
    return triangles_of_polygons(ends, numbers_of_words(words, "i8"))
