"""Reader of PLY files: triangles, polygons, strips, or a cloud.

No count in the header is trusted further than the bytes reach.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from ostiform.arrays import IntArray
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

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_CORNERS = ("vertex_indices", "vertex_index")


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


@dataclass(frozen=True, slots=True, eq=False)
class _Lists:
    """Lists of numbers one after the other: where each ends (n + 1,), and the numbers."""

    ends: IntArray
    values: Array


_Table: TypeAlias = Mapping[str, Array | _Lists]


def read_ply(content: bytes) -> RawMesh:
    """Return the vertices, faces and further vertex and face properties of a PLY file."""
    header, mark, body = content.partition(b"end_header")
    if not content.startswith(b"ply") or not mark:
        raise InputError("expected a PLY file with a complete header, found none")
    lines = [line.split() for line in header.decode("latin-1").splitlines()]
    layout = next((words[1] for words in lines if words[:1] == ["format"]), "")
    elements = _elements(lines)
    body = body.partition(b"\n" if b"\n" in header else b"\r")[2]
    if layout == "ascii":
        tables = _tables(_Words(body.split()), elements)
    elif layout in ("binary_little_endian", "binary_big_endian"):
        tables = _tables(_Bytes(body, "<" if "little" in layout else ">"), elements)
    else:
        raise InputError(f'expected the format ascii or binary of PLY, found "{layout}"')
    points = tables.get("vertex", {})
    axes = [points.get(axis) for axis in "xyz"]
    if not all(isinstance(axis, np.ndarray) for axis in axes):
        raise InputError(
            f"expected x, y and z of every vertex, found {', '.join(points) or 'no vertex'}"
        )
    comments = " ".join(" ".join(words) for words in lines if words[:1] == ["comment"])
    faces, owner = triangles_of_polygons(*_corners(tables, "face"))
    notes = polygon_notes(owner)
    strips, _ = triangles_of_strips(*_parted(*_corners(tables, "tristrips")))
    cells = tables.get("face", {}) if not len(strips) else {}
    return RawMesh(
        np.stack([np.asarray(axis, dtype=np.float64) for axis in axes], axis=1),
        np.concatenate([faces, strips]),
        {n: v for n, v in points.items() if n not in "xyz" and isinstance(v, np.ndarray)},
        {n: v[owner] for n, v in cells.items() if isinstance(v, np.ndarray)},
        stated_space(comments),
        notes,
    )


def _corners(tables: Mapping[str, _Table], element: str) -> tuple[IntArray, IntArray]:
    """Return the lists of vertex indices of an element; none where there is no such element."""
    table = tables.get(element)
    if table is None:
        return np.zeros(1, dtype=np.int64), np.zeros(0, dtype=np.int64)
    found = next((table[name] for name in _CORNERS if name in table), None)
    if not isinstance(found, _Lists):
        raise InputError(
            f"expected a list of vertex indices of every {element}, found "
            f"{', '.join(table) or 'nothing'}"
        )
    return found.ends, found.values.astype(np.int64)


def _parted(ends: IntArray, corners: IntArray) -> tuple[IntArray, IntArray]:
    """Return strips that -1 parts as lists of their own."""
    parts = [p for row in np.split(corners, ends[1:-1]) for p in np.split(row, *np.where(row < 0))]
    strips = [part[part >= 0] for part in parts]
    sizes = np.array([len(strip) for strip in strips], dtype=np.int64)
    return np.concatenate([[0], np.cumsum(sizes)]), np.concatenate([corners[:0], *strips])


def _elements(lines: Sequence[Sequence[str]]) -> list[_Element]:
    elements: list[_Element] = []
    for words in lines:
        if words[:1] == ["element"] and len(words) == 3 and words[2].isdecimal():
            elements.append(_Element(words[1], int(words[2]), ()))
        elif words[:1] == ["property"]:
            is_list = words[1:2] == ["list"]
            if not elements or len(words) != (5 if is_list else 3):
                raise InputError(f'expected a PLY property, found "{" ".join(words)}"')
            kinds = words[2:4] if is_list else words[1:2]
            unknown = [kind for kind in kinds if kind not in _TYPES]
            if unknown or (is_list and _TYPES[kinds[0]][0] == "f"):
                raise InputError(f"expected a PLY number type, found {(unknown or kinds)[0]}")
            added = _Property(words[-1], _TYPES[kinds[-1]], _TYPES[kinds[0]] if is_list else None)
            last = elements[-1]
            elements[-1] = _Element(last.name, last.count, (*last.properties, added))
        elif words[:1] == ["element"]:
            raise InputError(f'expected a PLY element with its count, found "{" ".join(words)}"')
    return elements


@dataclass(frozen=True, slots=True)
class _Words:
    """The numbers of an ASCII file."""

    content: list[bytes]

    def width(self, kind: str) -> int:
        """Return the places that one number takes."""
        return 1

    def numbers(self, start: int, count: int, kind: str) -> Array:
        """Return numbers that follow each other."""
        return numbers_of_words(self.content[start : start + count], kind)

    def gathered(self, starts: IntArray, counts: IntArray, kind: str) -> Array:
        """Return the numbers of several places."""
        ends = starts + counts
        words = [
            w for a, b in zip(starts.tolist(), ends.tolist(), strict=True)
            for w in self.content[a:b]
        ]  # fmt: skip
        return numbers_of_words(words, kind)


@dataclass(frozen=True, slots=True)
class _Bytes:
    """The numbers of a binary file."""

    content: bytes
    order: str

    def width(self, kind: str) -> int:
        """Return the bytes that one number takes."""
        return np.dtype(kind).itemsize

    def numbers(self, start: int, count: int, kind: str) -> Array:
        """Return numbers that follow each other."""
        return np.frombuffer(self.content, self.order + kind, count, start).astype(kind)

    def gathered(self, starts: IntArray, counts: IntArray, kind: str) -> Array:
        """Return the numbers of several places."""
        ends = starts + counts * self.width(kind)
        pieces = [self.content[a:b] for a, b in zip(starts.tolist(), ends.tolist(), strict=True)]
        return np.frombuffer(b"".join(pieces), self.order + kind).astype(kind)


def _tables(source: _Words | _Bytes, elements: Sequence[_Element]) -> dict[str, _Table]:
    tables, start = {}, 0
    for element in elements:
        lengths, record = _first_record(source, element, start)
        end = start + element.count * record
        table = None
        if end <= len(source.content):
            table = _equal_records(source, element, lengths, start, record)
        if table is None and lengths:
            table, end = _walked(source, element, start)
        if table is None:
            _require(source, end, element)
        tables[element.name] = table or {}
        start = end
    return tables


def _first_record(
    source: _Words | _Bytes, element: _Element, start: int
) -> tuple[dict[str, int], int]:
    """Return the lengths of the lists of an element's first record, and its length in all."""
    lengths, place = {}, start
    for item in element.properties:
        length = 1
        if item.count_kind is not None:
            width = source.width(item.count_kind)
            length = 0
            if element.count:
                _require(source, place + width, element)
                length = int(source.numbers(place, 1, item.count_kind)[0])
            if length < 0:
                raise InputError(f"expected lists in {element.name}, found a length of {length}")
            lengths[item.name] = length
            place += width
        place += length * source.width(item.kind)
    return lengths, place - start


def _equal_records(
    source: _Words | _Bytes,
    element: _Element,
    lengths: Mapping[str, int],
    start: int,
    record: int,
) -> _Table | None:
    """Return the columns of records whose lists have the lengths of the first; else None."""
    n = element.count
    rows = (
        np.array(source.content[start : start + n * record], dtype=object)
        if isinstance(source, _Words)
        else np.frombuffer(source.content, np.uint8, n * record, start)
    ).reshape(n, record)

    def column(place: int, count: int, kind: str) -> Array:
        part = np.ascontiguousarray(rows[:, place : place + count * source.width(kind)])
        if isinstance(source, _Words):
            return numbers_of_words(part.reshape(-1).tolist(), kind)
        return np.frombuffer(part.tobytes(), source.order + kind).astype(kind)

    places: dict[str, int] = {}
    place = 0
    for item in element.properties:
        if item.count_kind is not None:
            width = source.width(item.count_kind)
            # Where lists differ, the words here are other numbers: compared as they stand.
            if (rows[:, place : place + width] != rows[:1, place : place + width]).any():
                return None
            place += width
        places[item.name] = place
        place += lengths.get(item.name, 1) * source.width(item.kind)
    table: dict[str, Array | _Lists] = {}
    for item in element.properties:
        length = lengths.get(item.name, 1)
        values = column(places[item.name], length, item.kind)
        table[item.name] = (
            values if item.count_kind is None else _Lists(length * np.arange(n + 1), values)
        )
    return table


def _walked(
    source: _Words | _Bytes, element: _Element, start: int
) -> tuple[dict[str, Array | _Lists], int]:
    """Return the columns of records of any length, and where the last one ends."""
    places: dict[str, list[int]] = {item.name: [] for item in element.properties}
    counts: dict[str, list[int]] = {item.name: [] for item in element.properties}
    order: Any = "big" if isinstance(source, _Bytes) and source.order == ">" else "little"
    place = start
    widths = [
        (i.name, source.width(i.kind), 0 if i.count_kind is None else source.width(i.count_kind))
        for i in element.properties
    ]
    for _ in range(element.count):
        for name, width, counter in widths:
            count = 1
            if counter:
                _require(source, place + counter, element)
                count = (
                    int.from_bytes(source.content[place : place + counter], order)
                    if isinstance(source, _Bytes)
                    else int(source.content[place])
                )
                if count < 0:
                    raise InputError(f"expected lists in {element.name}, found a length of {count}")
                place += counter
            places[name].append(place)
            counts[name].append(count)
            place += count * width
        _require(source, place, element)
    table: dict[str, Array | _Lists] = {}
    for item in element.properties:
        sizes = np.array(counts[item.name], dtype=np.int64)
        values = source.gathered(np.array(places[item.name], dtype=np.int64), sizes, item.kind)
        ends = np.concatenate([[0], np.cumsum(sizes)])
        table[item.name] = values if item.count_kind is None else _Lists(ends, values)
    return table, place


def _require(source: _Words | _Bytes, end: int, element: _Element) -> None:
    if end > len(source.content):
        raise InputError(
            f"expected {element.count} of the element {element.name} as the header says, found "
            "the end of the file: export it again"
        )
