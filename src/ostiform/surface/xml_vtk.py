"""Reader of XML VTK files: VTP, and VTU that holds only triangles.

VTK's own reader ends the process on some damaged files, so this one takes the bytes of a file
and trusts no count in it further than the bytes reach.
"""

import base64
import lzma
import re
import zlib
from dataclasses import dataclass
from xml.etree import ElementTree

import lz4.block
import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.errors import InputError
from ostiform.surface.legacy_vtk import grid_triangles
from ostiform.surface.raw_mesh import (
    Array,
    RawMesh,
    joined_meshes,
    numbers_of_words,
    polygon_notes,
    stated_space,
    triangles_of_polygons,
    triangles_of_strips,
)

_TYPES = {
    "Int8": "i1", "UInt8": "u1", "Int16": "i2", "UInt16": "u2", "Int32": "i4", "UInt32": "u4",
    "Int64": "i8", "UInt64": "u8", "Float32": "f4", "Float64": "f8", "Bit": "u1",
}  # fmt: skip
_LARGEST_COMPRESSION = 1100
"""Deflate does not reach 1:1033; a block that announces more is damaged."""


@dataclass(frozen=True, slots=True)
class _Encoding:
    """How the arrays of one file are stored."""

    byte_order: str
    header: np.dtype[np.unsignedinteger]
    compressor: str
    appended: bytes
    is_appended_raw: bool


def read_xml_vtk(content: bytes) -> RawMesh:
    """Return the triangles of a VTP or VTU file; several pieces become one mesh.

    Arrays may be ASCII, base64 or appended, raw or compressed by zlib, LZMA or LZ4. Points and
    lines are ignored, triangle strips become triangles.

    Raises
    ------
    InputError
        If the file is damaged, of another kind, or holds cells that are not triangles.
    """
    root, encoding = _parsed(content)
    kind = root.get("type")
    if kind not in ("PolyData", "UnstructuredGrid"):
        raise InputError(
            f"expected PolyData or UnstructuredGrid, found {kind}: extract the surface"
        )
    grid = root.find(kind)
    pieces = [] if grid is None else grid.findall("Piece")
    space = _stated_space(grid, encoding)
    read_piece = _poly_piece if kind == "PolyData" else _grid_piece
    meshes = [
        read_piece(piece, encoding, space)
        for piece in pieces
        if _number(piece, "NumberOfPoints") and len(piece)
    ]
    if not meshes:
        raise InputError("expected a surface of triangles, found no points")
    return joined_meshes(meshes)


def xml_vtk_lines(content: bytes) -> tuple[FloatArray, IntArray, IntArray, str | None]:
    """Return the points (n, 3) of a VTP file, its lines, and the frame that it states.

    Lines are offsets (m + 1,) into a list of vertex indices; several pieces are joined.
    """
    root, encoding = _parsed(content)
    grid = root.find("PolyData")
    points, offsets, corners = [np.zeros((0, 3))], [np.zeros(1, np.int64)], [np.zeros(0, np.int64)]
    n_points = n_corners = 0
    for piece in [] if grid is None else grid.findall("Piece"):
        count = _number(piece, "NumberOfPoints")
        listed = piece.find("Points/DataArray")
        if not count or listed is None:
            continue
        points.append(_array(listed, encoding, 3 * count).reshape(count, 3).astype(np.float64))
        ends, vertices = _cells(piece, "Lines", encoding)
        offsets.append(n_corners + ends[1:])
        corners.append(n_points + vertices)
        n_points, n_corners = n_points + count, n_corners + len(vertices)
    return (
        np.concatenate(points),
        np.concatenate(offsets),
        np.concatenate(corners),
        _stated_space(grid, encoding),
    )


def _parsed(content: bytes) -> tuple[ElementTree.Element, _Encoding]:
    if b"<!DOCTYPE" in content[:4096] or b"<!ENTITY" in content[:4096]:
        raise InputError("expected a VTK file, found an XML document type declaration")
    appended, is_raw, text = b"", True, content
    mark = re.search(rb"<AppendedData([^>]*)>\s*_", content)
    if mark:
        end = content.rfind(b"</AppendedData>")
        if end < mark.end():
            raise InputError("expected a complete file, found appended data without an end")
        appended = content[mark.end() : end]
        is_raw = b"base64" not in mark[1]
        # Raw bytes are no XML: they are taken out before the rest is parsed.
        text = content[: mark.start()] + content[end + len(b"</AppendedData>") :]
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, LookupError, ValueError) as error:
        raise InputError(f"expected an XML VTK file, found a mistake: {error}") from None
    if root.tag != "VTKFile":
        raise InputError(f"expected an XML VTK file, found <{root.tag}>")
    header = root.get("header_type", "UInt32")
    if header not in ("UInt32", "UInt64"):
        raise InputError(f"expected header_type UInt32 or UInt64, found {header}")
    order = ">" if root.get("byte_order") == "BigEndian" else "<"
    compressor = root.get("compressor", "").removeprefix("vtk").removesuffix("DataCompressor")
    if compressor not in ("", "ZLib", "LZMA", "LZ4"):
        raise InputError(
            f"expected zlib, LZMA, LZ4 or no compression, found {compressor}: save it with zlib"
        )
    return root, _Encoding(order, np.dtype(order + _TYPES[header]), compressor, appended, is_raw)


@dataclass(frozen=True, slots=True, eq=False)
class _Cells:
    """The triangles of a piece, and the cell of the file that each comes from."""

    faces: IntArray
    chosen: IntArray
    n_in_file: int
    notes: tuple[str, ...]


def _poly_piece(piece: ElementTree.Element, encoding: _Encoding, space: str | None) -> RawMesh:
    offsets, corners = _cells(piece, "Polys", encoding)
    triangles, polygon = triangles_of_polygons(offsets, corners)
    strips, strip = triangles_of_strips(*_cells(piece, "Strips", encoding))
    n_before = _number(piece, "NumberOfVerts") + _number(piece, "NumberOfLines")
    n_polygons = _number(piece, "NumberOfPolys")
    if n_polygons != len(offsets) - 1:
        raise InputError(f"expected {n_polygons} polygons, found {len(offsets) - 1}")
    chosen = n_before + np.concatenate([polygon, n_polygons + strip])
    n_cells = n_before + n_polygons + _number(piece, "NumberOfStrips")
    cells = _Cells(np.concatenate([triangles, strips]), chosen, n_cells, polygon_notes(polygon))
    return _piece_mesh(piece, encoding, cells, space)


def _grid_piece(piece: ElementTree.Element, encoding: _Encoding, space: str | None) -> RawMesh:
    offsets, corners = _cells(piece, "Cells", encoding)
    n_cells = _number(piece, "NumberOfCells")
    listed = piece.find("Cells/DataArray[@Name='types']")
    types = np.zeros(0, np.uint8) if listed is None else _array(listed, encoding, n_cells)
    faces, chosen = grid_triangles(offsets, corners, types)
    cells = _Cells(faces, chosen, n_cells, polygon_notes(chosen))
    return _piece_mesh(piece, encoding, cells, space)


def _piece_mesh(
    piece: ElementTree.Element, encoding: _Encoding, cells: _Cells, space: str | None
) -> RawMesh:
    n_points = _number(piece, "NumberOfPoints")
    listed = piece.find("Points/DataArray")
    if listed is None:
        raise InputError("expected an array of points, found none")
    points = _array(listed, encoding, 3 * n_points).reshape(n_points, 3)
    cell_data = _attributes(piece, "CellData", encoding, cells.n_in_file)
    return RawMesh(
        points.astype(np.float64),
        cells.faces,
        _attributes(piece, "PointData", encoding, n_points),
        {name: values[cells.chosen] for name, values in cell_data.items()},
        space,
        cells.notes,
    )


def _cells(
    piece: ElementTree.Element, group: str, encoding: _Encoding
) -> tuple[IntArray, IntArray]:
    """Return offsets (n + 1,), which the file stores without the leading 0, and connectivity."""
    arrays = {}
    for name in ("offsets", "connectivity"):
        listed = piece.find(f"{group}/DataArray[@Name='{name}']")
        arrays[name] = (
            np.zeros(0, dtype=np.int64)
            if listed is None
            else _array(listed, encoding, None).astype(np.int64)
        )
    return np.concatenate([[0], arrays["offsets"]]).astype(np.int64), arrays["connectivity"]


def _attributes(
    piece: ElementTree.Element, group: str, encoding: _Encoding, count: int
) -> dict[str, Array]:
    arrays = {}
    for listed in piece.findall(f"{group}/DataArray"):
        width = _number(listed, "NumberOfComponents", 1)
        values = _array(listed, encoding, count * width)
        arrays[listed.get("Name", "")] = values if width == 1 else values.reshape(count, width)
    return arrays


def _array(listed: ElementTree.Element, encoding: _Encoding, count: int | None) -> Array:
    """Return the numbers of a DataArray; their number is checked where it is known."""
    kind = listed.get("type", "")
    if kind not in _TYPES:
        raise InputError(f"expected a VTK number type, found {kind or 'none'}")
    layout = listed.get("format", "ascii")
    if layout == "ascii":
        words = (listed.text or "").encode("ascii", "replace").split()
        values: Array = numbers_of_words(words, _TYPES[kind])
    else:
        raw = _decoded(_stored(listed, layout, encoding), encoding, layout)
        dtype = np.dtype(encoding.byte_order + _TYPES[kind])
        if len(raw) % dtype.itemsize:
            raise InputError("expected whole numbers of values, found a damaged array")
        values = np.frombuffer(raw, dtype).astype(_TYPES[kind])
        if kind == "Bit":  # eight to a byte
            values = np.unpackbits(values)[:count]
    if count is not None and len(values) != count:
        name = listed.get("Name", "points")
        raise InputError(f"expected {count} numbers in the array {name}, found {len(values)}")
    return values


def _stored(listed: ElementTree.Element, layout: str, encoding: _Encoding) -> bytes:
    if layout == "binary":
        return "".join((listed.text or "").split()).encode("ascii", "replace")
    if layout == "appended":
        start = _number(listed, "offset")
        if start >= len(encoding.appended):
            raise InputError("expected appended data at the stated offset, found the file's end")
        return encoding.appended[start:]
    raise InputError(f"expected the format ascii, binary or appended, found {layout}")


def _decoded(stored: bytes, encoding: _Encoding, layout: str) -> bytes:
    """Return the bytes of an array from its length header, base64 and compression."""
    is_raw = layout == "appended" and encoding.is_appended_raw
    word = encoding.header.itemsize
    n_words = 1
    if encoding.compressor:
        # Number of blocks, size of a block, size of the last one, then all compressed sizes.
        n_words = 3 + int(np.frombuffer(_taken(stored, 0, word, is_raw), encoding.header)[0])
    header = np.frombuffer(_taken(stored, 0, n_words * word, is_raw), encoding.header)
    sizes = [int(size) for size in header]
    if not encoding.compressor:
        return _taken(stored, 0, word + sizes[0], is_raw)[word:]
    # The compressed blocks are encoded apart from their header.
    start = n_words * word if is_raw else 4 * -(-n_words * word // 3)
    blocks = _taken(stored[start:], 0, sum(sizes[3:]), is_raw)
    plain, position = [], 0
    for k, compressed in enumerate(sizes[3:]):
        is_last = k == n_words - 4 and sizes[2] > 0
        size = sizes[2] if is_last else sizes[1]
        if size > _LARGEST_COMPRESSION * max(compressed, 64):
            raise InputError("expected compressed data, found a damaged block")
        block = blocks[position : position + compressed]
        plain.append(_decompressed(block, size, encoding.compressor))
        position += compressed
    return b"".join(plain)


def _taken(stored: bytes, start: int, count: int, is_raw: bool) -> bytes:
    """Return bytes from raw or base64 text, refusing to read past its end."""
    room = len(stored) if is_raw else 3 * (len(stored) // 4)
    if start + count > room:
        raise InputError(
            f"expected {count} bytes of an array, found {max(room - start, 0)}: export the file "
            "again"
        )
    if is_raw:
        return stored[start : start + count]
    plain = base64.b64decode(stored[: 4 * -(-(start + count) // 3)], validate=True)
    if len(plain) < start + count:
        raise InputError("expected more bytes of an array, found the end of its text")
    return plain[start : start + count]


def _decompressed(block: bytes, size: int, compressor: str) -> bytes:
    try:
        if compressor == "ZLib":
            plain = zlib.decompressobj().decompress(block, size)
        elif compressor == "LZ4":
            plain = lz4.block.decompress(block, uncompressed_size=size)
        else:
            plain = lzma.LZMADecompressor().decompress(block, size)
    except (zlib.error, lzma.LZMAError, lz4.block.LZ4BlockError) as error:
        raise InputError(f"expected compressed data, found a damaged block: {error}") from None
    if len(plain) != size:
        raise InputError(f"expected a block of {size} bytes, found {len(plain)}")
    return plain


def _stated_space(grid: ElementTree.Element | None, encoding: _Encoding) -> str | None:
    listed = None if grid is None else grid.find("FieldData/Array[@Name='SPACE']")
    if listed is None:
        return None
    layout = listed.get("format", "ascii")
    if layout == "ascii":
        codes = bytes(int(word) for word in (listed.text or "").split())
    else:
        codes = _decoded(_stored(listed, layout, encoding), encoding, layout)
    stated = codes.partition(b"\0")[0].decode("latin-1").strip().upper()
    return stated_space(f"SPACE={stated}") if stated else None


def _number(element: ElementTree.Element, key: str, default: int = 0) -> int:
    text = element.get(key)
    if text is None:
        return default
    if not text.strip().isdecimal():
        raise InputError(f'expected a count in {key}, found "{text[:40]}"')
    return int(text)
