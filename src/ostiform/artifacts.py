"""Values as files: what the annotations of a dataclass's fields say is what is written.

A file is one line of text (kind, layout, checksums), one line of JSON, then every array from a
multiple of 64 bytes on, so that it can be mapped into memory as well as read. A path that ends in
``.json`` gets indented JSON instead, arrays as lists. Every bit of a number is kept; no pickle.
"""

import json
import math
import mmap
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from ostiform.codecs import codec, kind_name, number
from ostiform.errors import ArtifactError

T = TypeVar("T")

LAYOUT = 1
ALIGNMENT = 64
MAGIC = "ostiform"
MAKE_AGAIN = "run `ostiform build` to make it again"


def save(path: Path, value: Any, kind: Any = None) -> None:
    """Write a value.

    Parameters
    ----------
    path : Path
        Written directly; use `ostiform.atomic` where a kill must not leave half a file.
    value : dataclass, or what `kind` says
    kind : type
        Needed where the value is no dataclass: ``tuple[Embedding, ...]``.
    """
    kind = type(value) if kind is None else kind
    if path.suffix == ".json":
        facts = {"kind": kind_name(kind), "layout": LAYOUT, "value": to_json(value, kind)}
        lines = json.dumps(facts, indent=1, ensure_ascii=False, allow_nan=False)
        path.write_text(lines + "\n", encoding="utf-8")
        return
    block = _Block()
    fields = codec(kind).write(value, block.put)
    text = json.dumps([fields, block.places], allow_nan=False).encode()
    check = 0
    for padding, array in block.pieces():
        check = zlib.crc32(array, zlib.crc32(padding, check))
    head = f"{MAGIC}|{kind_name(kind)}|{LAYOUT}|{zlib.crc32(text)}|{check}\n".encode()
    with path.open("wb") as stream:
        stream.write(head + text + b"\n")
        stream.write(b"\0" * (-stream.tell() % ALIGNMENT))
        for padding, array in block.pieces():
            stream.write(padding)
            stream.write(array)


def load(path: Path, kind: type[T], remedy: str = MAKE_AGAIN) -> T:
    """Read what `save` wrote.

    Parameters
    ----------
    path : Path
    kind : type
        That the file must hold.
    remedy : str
        What a reader of the error message should do.

    Raises
    ------
    ArtifactError
        If the file is missing, damaged or of another kind.
    """
    value: T = _loaded(path, kind, remedy, _read_whole)
    return value


def load_mapped(path: Path, kind: type[T], remedy: str = MAKE_AGAIN) -> T:
    """Read what `save` wrote with its arrays mapped from the file: what is not used is not read.

    The operating system keeps in memory what is used, for all processes together. Arrays are not
    compared with their checksum. Parameters and errors are those of `load`.
    """
    value: T = _loaded(path, kind, remedy, _mapped)
    return value


def to_json(value: Any, kind: Any = None) -> Any:
    """Return a value as JSON; arrays are lists, numbers that are not finite are text."""
    wanted: Any = type(value) if kind is None else kind
    return codec(wanted).write(value, _listed)


def from_json(facts: Any, kind: type[T]) -> T:
    """Return the value that `to_json` was given.

    Raises
    ------
    ValueError, TypeError, KeyError
        If it is something else.
    """
    wanted: Any = kind
    made: T = codec(wanted).read(facts, _unlisted)
    return made


def _loaded(path: Path, kind: Any, remedy: str, read: Callable[[Path], Any]) -> Any:
    try:
        if path.suffix == ".json":
            facts = json.loads(path.read_text(encoding="utf-8"))
            _expect((facts["kind"], facts["layout"]), (kind_name(kind), LAYOUT))
            return from_json(facts["value"], kind)
        block = read(path)
        facts, places, get = _opened(block, kind_name(kind), read is _read_whole)
        arrays = [get(place) for place in places]
        return codec(kind).read(facts, arrays.__getitem__)
    except Exception as error:
        # A damaged file makes the constructors of values raise whatever they raise.
        raise ArtifactError(
            f"{path}: expected the {kind_name(kind)} that an earlier stage wrote, found "
            f"{str(error)[:200] or type(error).__name__}; {remedy}"
        ) from error


def _expect(found: tuple[Any, Any], wanted: tuple[str, int]) -> None:
    if found != wanted:
        raise ValueError(f"{str(found[0])[:80]} in layout {str(found[1])[:20]}")


def _opened(
    block: Any, kind: str, is_checked: bool
) -> tuple[Any, list[Any], Callable[[Any], np.ndarray]]:
    """Return the JSON of a file, the places of its arrays, and what gives the array of a place."""
    view = memoryview(block)
    head = bytes(view[:256]).split(b"\n", 1)[0]
    magic, found, layout, text_check, check = head.decode().split("|")
    if magic != MAGIC:
        raise ValueError("a file of another program")
    _expect((found, int(layout)), (kind, LAYOUT))
    start = len(head) + 1
    end = _find_newline(block, start)
    text = bytes(view[start:end])
    if zlib.crc32(text) != int(text_check):
        raise ValueError("damaged facts")
    first = end + 1 + -(end + 1) % ALIGNMENT
    if is_checked and zlib.crc32(view[first:]) != int(check):
        raise ValueError("damaged arrays")
    facts, places = json.loads(text)

    def get(place: Any) -> np.ndarray:
        name, shape, offset, is_writable = place
        array = np.frombuffer(block, np.dtype(name), math.prod(shape), first + offset)
        array = array.reshape(shape)
        array.flags.writeable = is_writable
        return array

    return facts, places, get


def _find_newline(block: Any, start: int) -> int:
    end: int = block.find(b"\n", start)
    if end < 0:
        raise ValueError("only a part of it")
    return end


def _read_whole(path: Path) -> bytearray:
    block = bytearray(path.stat().st_size)
    with path.open("rb") as stream:
        stream.readinto(block)
    return block


def _mapped(path: Path) -> mmap.mmap:
    with path.open("rb") as stream:
        # Private, so that arrays are writable or not as they were: kernels tell them apart.
        return mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_COPY)


@dataclass(slots=True)
class _Block:
    """The arrays of a file that is being written, each with its place."""

    arrays: list[np.ndarray] = field(default_factory=list)
    places: list[Any] = field(default_factory=list)
    length: int = 0

    def put(self, array: np.ndarray) -> int:
        flat = np.ascontiguousarray(array, array.dtype.newbyteorder("<")).reshape(array.shape)
        self.length += -self.length % ALIGNMENT
        self.places.append([flat.dtype.str, flat.shape, self.length, array.flags.writeable])
        self.length += flat.nbytes
        self.arrays.append(flat)
        return len(self.arrays) - 1

    def pieces(self) -> Any:
        """Yield the bytes before each array, and the array's own."""
        done = 0
        for array, (_, _, offset, _) in zip(self.arrays, self.places, strict=True):
            yield b"\0" * (offset - done), array.reshape(-1).view(np.uint8).data
            done = offset + array.nbytes


def _listed(array: np.ndarray) -> Any:
    if not array.size:
        return {"shape": list(array.shape)}
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        return np.vectorize(number, otypes=[object])(array).tolist()
    return array.tolist()


def _unlisted(facts: Any) -> np.ndarray:
    return np.empty(facts["shape"]) if isinstance(facts, dict) else np.array(facts)
