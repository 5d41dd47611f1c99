"""Reader of legacy VTK files: POLYDATA, and UNSTRUCTURED_GRID that holds only triangles.

VTK's own reader ends the process on some damaged files, so this one takes the bytes of a file
and trusts no count in it further than the bytes reach.
"""

import re
from dataclasses import dataclass, field
from urllib.parse import unquote

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.errors import InputError
from ostiform.surface.raw_mesh import (
    Array,
    RawMesh,
    numbers_of_words,
    polygon_notes,
    stated_space,
    triangles_of_polygons,
    triangles_of_strips,
)

VTK_FLAT = (5, 7, 9)
"""Cell types of triangles, polygons and quadrilaterals."""
VTK_WITHOUT_AREA = (1, 2, 3, 4)
"""Cell types of points and lines."""

_TYPES = {
    "bit": "u1", "char": "i1", "signed_char": "i1", "unsigned_char": "u1", "short": "i2",
    "unsigned_short": "u2", "int": "i4", "unsigned_int": "u4", "long": "i8",
    "unsigned_long": "u8", "float": "f4", "double": "f8", "vtktypeint64": "i8",
    "vtktypeuint64": "u8", "vtkidtype": "i4",
}  # fmt: skip
_WIDTHS = {"VECTORS": 3, "NORMALS": 3, "TENSORS": 9, "TENSORS6": 6, "GLOBAL_IDS": 1,
           "PEDIGREE_IDS": 1, "EDGE_FLAGS": 1}  # fmt: skip


@dataclass(slots=True)
class _Cursor:
    """The bytes of a file, and how far they were read."""

    content: bytes
    is_binary: bool
    position: int
    offset_version: bool  # cells as offsets and connectivity (version 5)

    def line(self) -> list[str]:
        """Return the words of the next line that is not empty; none at the end."""
        while self.position < len(self.content):
            end = self.content.find(b"\n", self.position)
            end = len(self.content) if end < 0 else end
            words = self.content[self.position : end].decode("latin-1").split()
            self.position = end + 1
            if words:
                return words
        return []

    def values(self, count: int, kind: str) -> Array:
        """Return the next `count` numbers of a VTK type."""
        if kind.lower() not in _TYPES:
            raise InputError(f"expected a VTK number type, found {kind}")
        dtype = np.dtype(_TYPES[kind.lower()])
        if self.is_binary:
            n_bytes = -(-count // 8) if kind.lower() == "bit" else count * dtype.itemsize
            self.require(n_bytes)
            raw = np.frombuffer(
                self.content, dtype.newbyteorder(">"), n_bytes // dtype.itemsize, self.position
            )
            self.position += n_bytes
            if self.content[self.position : self.position + 1] == b"\n":
                self.position += 1
            if kind.lower() == "bit":
                return np.unpackbits(raw)[:count]
            return raw.astype(np.int64 if kind.lower() == "vtkidtype" else dtype)
        self.require(2 * count - 1 if count else 0)
        words: list[bytes] = []
        position = self.position
        # Each pass reads as many words as are missing, so a few passes reach the last one.
        while len(words) < count:
            chunk = re.compile(rb"(?:\s*\S+){1,%d}" % min(count - len(words), 65535)).match(
                self.content, position
            )
            if chunk is None:
                raise InputError(
                    f"expected {count} numbers, found {len(words)} before the end of the file: "
                    "export the file again"
                )
            words += chunk.group().split()
            position = chunk.end()
        self.position = position
        return numbers_of_words(words, "i8" if kind.lower() == "vtkidtype" else dtype.str)

    def require(self, n_bytes: int) -> None:
        """Refuse to read past the end."""
        if n_bytes > len(self.content) - self.position:
            raise InputError(
                f"expected {n_bytes} more bytes as the header says, found "
                f"{max(len(self.content) - self.position, 0)}: export the file again"
            )


@dataclass(slots=True)
class _Sections:
    """What was read so far."""

    points: Array | None = None
    cells: dict[str, tuple[IntArray, IntArray]] = field(default_factory=dict)
    types: Array | None = None
    data: dict[str, dict[str, Array]] = field(default_factory=lambda: {"POINT": {}, "CELL": {}})
    texts: dict[str, str] = field(default_factory=dict)


def read_legacy_vtk(content: bytes) -> RawMesh:
    """Return the triangles of a legacy VTK file, ASCII or binary, of any version.

    Points and lines are ignored, triangle strips become triangles.

    Raises
    ------
    InputError
        If the file is damaged, of another kind, or holds cells that are not triangles.
    """
    return _mesh(*_read_file(content))


def legacy_vtk_lines(content: bytes) -> tuple[FloatArray, IntArray, IntArray, str | None]:
    """Return the points (n, 3) of a legacy VTK file, its lines, and the frame that it states.

    Lines are offsets (m + 1,) into a list of vertex indices.
    """
    sections, space = _read_file(content)
    points = np.zeros((0, 3)) if sections.points is None else sections.points.astype(np.float64)
    none = np.zeros(1, dtype=np.int64), np.zeros(0, dtype=np.int64)
    return points, *sections.cells.get("LINES", none), space


def _read_file(content: bytes) -> tuple[_Sections, str | None]:
    head = re.match(
        rb"# vtk DataFile Version (\d+)\.\d+[^\n]*\n([^\n]*)\n\s*(ASCII|BINARY)[ \t]*\r?\n",
        content,
        re.IGNORECASE,
    )
    if head is None:
        raise InputError("expected the header of a legacy VTK file, found another one")
    cursor = _Cursor(content, head[3].upper() == b"BINARY", head.end(), int(head[1]) >= 5)
    dataset = [word.upper() for word in cursor.line()]
    if dataset not in (["DATASET", "POLYDATA"], ["DATASET", "UNSTRUCTURED_GRID"]):
        raise InputError(
            "expected DATASET POLYDATA or UNSTRUCTURED_GRID, found "
            f"{' '.join(dataset[:2]) or 'the end of the file'}: extract the surface"
        )
    sections = _read_sections(cursor)
    title, listed = head[2].decode("latin-1"), sections.texts.get("SPACE", "").strip().upper()
    return sections, stated_space(f"{title} SPACE={listed}" if listed else title)


def _read_sections(cursor: _Cursor) -> _Sections:
    sections = _Sections()
    current = sections.data.setdefault("FIELD", {})
    count = 0
    while words := cursor.line():
        keyword = words[0].upper()
        if keyword == "POINTS":
            count, kind = _count(words, 1), _word(words, 2)
            sections.points = cursor.values(3 * count, kind).reshape(-1, 3)
        elif keyword in ("VERTICES", "LINES", "POLYGONS", "TRIANGLE_STRIPS", "CELLS"):
            sections.cells[keyword] = _cells(cursor, words)
        elif keyword == "CELL_TYPES":
            sections.types = cursor.values(_count(words, 1), "int")
        elif keyword in ("POINT_DATA", "CELL_DATA"):
            count = _count(words, 1)
            current = sections.data[keyword.removesuffix("_DATA")]
        elif keyword == "FIELD":
            _read_field(cursor, _count(words, 2), current, sections.texts)
        elif keyword == "METADATA":
            _skip_metadata(cursor)
        else:
            _read_attribute(cursor, words, count, current)
    return sections


def _cells(cursor: _Cursor, words: list[str]) -> tuple[IntArray, IntArray]:
    """Return offsets (n + 1,) and connectivity."""
    first, second = _count(words, 1), _count(words, 2)
    if cursor.offset_version:
        offset_line = cursor.line()
        if offset_line[:1] != ["OFFSETS"]:
            raise InputError(f"expected OFFSETS of {words[0]}, found {' '.join(offset_line[:1])}")
        offsets = cursor.values(first, _word(offset_line, 1)).astype(np.int64)
        corner_line = cursor.line()
        if corner_line[:1] != ["CONNECTIVITY"]:
            raise InputError(
                f"expected CONNECTIVITY of {words[0]}, found {' '.join(corner_line[:1])}"
            )
        return offsets, cursor.values(second, _word(corner_line, 1)).astype(np.int64)
    mixed = cursor.values(second, "int").astype(np.int64)  # n, corner, corner, ..., n, ...
    if second == 4 * first and (mixed[::4] == 3).all():
        return np.arange(0, 3 * first + 1, 3), mixed.reshape(-1, 4)[:, 1:].reshape(-1)
    starts: list[int] = []
    start = 0
    while start < second and len(starts) < first:
        starts.append(start)
        start += 1 + max(int(mixed[start]), 0)
    if len(starts) != first or start != second:
        raise InputError(f"expected {first} cells in {words[0]}, found a damaged list")
    is_corner = np.ones(second, dtype=np.bool_)
    is_corner[starts] = False
    return np.concatenate([[0], np.cumsum(mixed[starts])]).astype(np.int64), mixed[is_corner]


def _read_field(
    cursor: _Cursor, n_arrays: int, current: dict[str, Array], texts: dict[str, str]
) -> None:
    for _ in range(n_arrays):
        words = cursor.line()
        while words and words[0].upper() == "METADATA":
            _skip_metadata(cursor)
            words = cursor.line()
        if not words:
            raise InputError("expected more arrays in FIELD, found the end of the file")
        name, width, length = unquote(words[0]), _count(words, 1), _count(words, 2)
        if _word(words, 3) == "string":
            texts[name] = _strings(cursor, width * length)
        else:
            values = cursor.values(width * length, words[3])
            current[name] = values if width == 1 else values.reshape(length, width)


def _strings(cursor: _Cursor, count: int) -> str:
    """Skip strings and return the first one."""
    found = ""
    for k in range(count):
        if cursor.is_binary:
            cursor.require(1)
            lead = cursor.content[cursor.position]
            # The two highest bits tell how many bytes hold the length.
            size = {3: 1, 2: 2, 1: 4, 0: 8}[lead >> 6]
            cursor.require(size)
            raw = cursor.content[cursor.position : cursor.position + size]
            length = int.from_bytes(raw, "big") & ((1 << (8 * size - 2)) - 1)
            cursor.require(size + length)
            start = cursor.position + size
            text = cursor.content[start : start + length].decode("latin-1")
            cursor.position = start + length
        else:
            text = unquote(" ".join(cursor.line()))
        found = text if k == 0 else found
    return found


def _skip_metadata(cursor: _Cursor) -> None:
    """Metadata end with an empty line."""
    while cursor.position < len(cursor.content):
        end = cursor.content.find(b"\n", cursor.position)
        end = len(cursor.content) if end < 0 else end
        line = cursor.content[cursor.position : end]
        cursor.position = end + 1
        if not line.strip():
            return


def _read_attribute(
    cursor: _Cursor, words: list[str], count: int, current: dict[str, Array]
) -> None:
    keyword, name = words[0].upper(), unquote(_word(words, 1))
    if keyword == "SCALARS":
        width = _count(words, 3) if len(words) > 3 else 1
        kind = _word(words, 2)
        before = cursor.position
        if (table := cursor.line())[:1] != ["LOOKUP_TABLE"] or len(table) > 2:
            cursor.position = before
    elif keyword == "COLOR_SCALARS":
        width, kind = _count(words, 2), "unsigned_char" if cursor.is_binary else "float"
    elif keyword == "LOOKUP_TABLE":
        cursor.values(4 * _count(words, 2), "unsigned_char" if cursor.is_binary else "float")
        return
    elif keyword == "TEXTURE_COORDINATES":
        width, kind = _count(words, 2), _word(words, 3)
    elif keyword in _WIDTHS:
        width, kind = _WIDTHS[keyword], _word(words, 2)
    else:
        raise InputError(f'expected a section of a legacy VTK file, found "{words[0][:40]}"')
    values = cursor.values(width * count, kind)
    if keyword == "COLOR_SCALARS" and not cursor.is_binary:
        values = np.rint(255.0 * values.clip(0.0, 1.0)).astype(np.uint8)  # as VTK reads them
    current[name] = values if width == 1 else values.reshape(count, width)


def _mesh(sections: _Sections, space: str | None) -> RawMesh:
    if sections.points is None:
        raise InputError("expected a surface of triangles, found no points")
    if "CELLS" in sections.cells:
        offsets, corners = sections.cells["CELLS"]
        faces, chosen = grid_triangles(offsets, corners, sections.types)
        notes = polygon_notes(chosen)
    else:
        n_before = sum(
            max(len(sections.cells[kind][0]) - 1, 0)
            for kind in ("VERTICES", "LINES")
            if kind in sections.cells
        )
        none = np.zeros(1, dtype=np.int64), np.zeros(0, dtype=np.int64)
        listed = sections.cells.get("POLYGONS", none)
        triangles, polygon = triangles_of_polygons(*listed)
        strips, strip = triangles_of_strips(*sections.cells.get("TRIANGLE_STRIPS", none))
        faces = np.concatenate([triangles, strips])
        chosen = n_before + np.concatenate([polygon, len(listed[0]) - 1 + strip])
        notes = polygon_notes(polygon)
    n_cells = sum(max(len(offsets) - 1, 0) for offsets, _ in sections.cells.values())
    for name, values in sections.data["CELL"].items():
        if len(values) != n_cells:
            raise InputError(
                f"expected {n_cells} values in the cell array {name}, found {len(values)}"
            )
    return RawMesh(
        sections.points.astype(np.float64),
        faces,
        sections.data["POINT"],
        {name: values[chosen] for name, values in sections.data["CELL"].items()},
        space,
        notes,
    )


def grid_triangles(
    offsets: IntArray, corners: IntArray, types: Array | None
) -> tuple[IntArray, IntArray]:
    """Return the triangles (F, 3) of an unstructured grid, and the cell (F,) each comes from.

    Quadrilaterals and polygons become fans of triangles; points and lines are ignored.

    Raises
    ------
    InputError
        If the lists do not fit each other, or the grid holds cells of other types.
    """
    if types is None or len(types) != len(offsets) - 1:
        raise InputError("expected one type per cell, found another number")
    is_flat = np.isin(types, VTK_FLAT)
    others = ~is_flat & ~np.isin(types, VTK_WITHOUT_AREA)
    if others.any():
        raise InputError(
            f"expected triangles only, found {int(others.sum())} cells of other kinds (VTK cell "
            f"type {int(types[others][0])}): extract the surface and triangulate it"
        )
    chosen = np.flatnonzero(is_flat)
    starts, sizes = offsets[:-1][chosen], np.diff(offsets)[chosen]
    if len(chosen) and (
        starts.min() < 0 or sizes.min() < 3 or (starts + sizes).max() > len(corners)
    ):
        raise InputError("expected three or more corners per cell, found a damaged list of cells")
    listed = np.repeat(starts - (np.cumsum(sizes) - sizes), sizes) + np.arange(int(sizes.sum()))
    ends = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    triangles, owner = triangles_of_polygons(ends, corners[listed])
    return triangles, chosen[owner]


def _count(words: list[str], place: int) -> int:
    word = _word(words, place)
    if not word.isdecimal():
        raise InputError(f'expected a count after {words[0][:40]}, found "{word[:40]}"')
    return int(word)


def _word(words: list[str], place: int) -> str:
    if place >= len(words):
        raise InputError(f"expected more words after {' '.join(words)[:60]}, found the line's end")
    return words[place]
