"""Values as files: what the annotations of a dataclass's fields say is what is written.

A file is one line of text (kind, layout, checksums), one line of JSON, then every array from a
multiple of 64 bytes on, so that it can be mapped into memory as well as read. A path that ends in
``.json`` gets indented JSON instead, arrays as lists. Every bit of a number is kept; no pickle.
"""

import json
import math
import mmap
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, is_dataclass
from enum import Enum
from functools import cache
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin

import numpy as np

from ostiform.errors import ArtifactError
from ostiform.values import dtype_of, is_union, type_hints, unwrapped

T = TypeVar("T")

LAYOUT = 1
ALIGNMENT = 64
MAGIC = "ostiform"
ARRAY_KINDS = "fiub"  # floats, integers, bool
MAKE_AGAIN = "run `ostiform build` to make it again"


@dataclass(frozen=True, slots=True)
class StoredAs:
    """The type that an array has in files only (single precision for what is only drawn)."""

    dtype: Any


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
    fields = _codec(kind).write(value, block.put)
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
    return _codec(wanted).write(value, _listed)


def from_json(facts: Any, kind: type[T]) -> T:
    """Return the value that `to_json` was given.

    Raises
    ------
    ValueError, TypeError, KeyError
        If it is something else.
    """
    wanted: Any = kind
    made: T = _codec(wanted).read(facts, _unlisted)
    return made


def kind_name(kind: Any) -> str:
    """Return what the values of a type are called in files and messages."""
    if get_origin(kind) is tuple:
        return kind_name(get_args(kind)[0]) + "s"
    words = "".join(f" {c.lower()}" if c.isupper() else c for c in kind.__name__)
    return words.strip()


def _loaded(path: Path, kind: Any, remedy: str, read: Callable[[Path], Any]) -> Any:
    try:
        if path.suffix == ".json":
            facts = json.loads(path.read_text(encoding="utf-8"))
            _expect((facts["kind"], facts["layout"]), (kind_name(kind), LAYOUT))
            return from_json(facts["value"], kind)
        block = read(path)
        facts, places, get = _opened(block, kind_name(kind), read is _read_whole)
        arrays = [get(place) for place in places]
        return _codec(kind).read(facts, arrays.__getitem__)
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
        return np.vectorize(_number, otypes=[object])(array).tolist()
    return array.tolist()


def _unlisted(facts: Any) -> np.ndarray:
    return np.empty(facts["shape"]) if isinstance(facts, dict) else np.array(facts)


Put = Callable[[np.ndarray], Any]
Get = Callable[[Any], np.ndarray]


@dataclass(frozen=True, slots=True)
class _Codec:
    """How values of one annotation become JSON (with arrays put elsewhere) and come back."""

    write: Callable[[Any, Put], Any]
    read: Callable[[Any, Get], Any]


@cache
def _codec(hint: Any) -> _Codec:
    hint, added = unwrapped(hint)
    origin = get_origin(hint)
    if origin is np.ndarray:
        stored = next((one.dtype for one in added if isinstance(one, StoredAs)), None)
        return _array_codec(dtype_of(hint), stored)
    if origin is Literal:
        return _choice_codec({choice: choice for choice in get_args(hint)}, _same)
    if origin is tuple:
        return _tuple_codec(get_args(hint))
    if origin in (Mapping, dict):
        return _mapping_codec(*get_args(hint))
    if is_union(hint):
        return _union_codec(get_args(hint))
    if is_dataclass(hint):
        return _fields_codec(hint)
    if isinstance(hint, type) and issubclass(hint, Enum):
        return _choice_codec({member.name: member for member in hint}, lambda member: member.name)
    if hint in _PLAIN:
        return _PLAIN[hint]
    raise TypeError(f"{hint}: expected an annotation of what files can hold")


def _same(value: Any) -> Any:
    return value


def _number(value: Any) -> Any:
    number = float(value)
    return number if math.isfinite(number) else str(number)


def _of(*allowed: type) -> Callable[[Any, Get], Any]:
    def read(facts: Any, get: Get) -> Any:
        if type(facts) not in allowed:
            raise TypeError(f"{str(facts)[:80]} where {allowed[0].__name__} was expected")
        return facts

    return read


def _read_float(facts: Any, get: Get) -> float:
    if type(facts) is str and facts not in ("nan", "inf", "-inf"):
        raise TypeError(f"{facts[:80]} where a number was expected")
    return float(facts)


_PLAIN: dict[Any, _Codec] = {
    str: _Codec(lambda value, put: str(value), _of(str)),
    bool: _Codec(lambda value, put: bool(value), _of(bool)),
    int: _Codec(lambda value, put: int(value), _of(int)),
    float: _Codec(lambda value, put: _number(value), _read_float),
    type(None): _Codec(lambda value, put: None, _of(type(None))),
    Path: _Codec(lambda value, put: str(value), lambda facts, get: Path(facts)),
    Any: _Codec(lambda value, put: value, lambda facts, get: facts),
}


def _array_codec(dtype: Any, stored: Any) -> _Codec:
    def write(value: Any, put: Put) -> Any:
        return put(value if stored is None else value.astype(stored))

    def read(facts: Any, get: Get) -> Any:
        array = get(facts)
        if array.dtype.kind not in ARRAY_KINDS:
            raise TypeError(f"an array of {array.dtype}")
        if dtype is Any or array.dtype == dtype:
            return array
        if array.dtype.kind == "f" and np.dtype(dtype).kind != "f" and array.size:
            raise TypeError(f"an array of {array.dtype} where {np.dtype(dtype)} was expected")
        return array.astype(dtype)

    return _Codec(write, read)


def _choice_codec(choices: Mapping[Any, Any], name: Callable[[Any], Any]) -> _Codec:
    return _Codec(lambda value, put: name(value), lambda facts, get: choices[facts])


def _tuple_codec(hints: tuple[Any, ...]) -> _Codec:
    def codecs(count: int) -> list[_Codec]:
        if hints[1:] == (...,):
            return [_codec(hints[0])] * count
        return [_codec(hint) for hint in hints]

    def write(value: Any, put: Put) -> Any:
        return [
            codec.write(item, put) for codec, item in zip(codecs(len(value)), value, strict=True)
        ]

    def read(facts: Any, get: Get) -> Any:
        if type(facts) is not list:
            raise TypeError(f"{str(facts)[:80]} where a list was expected")
        return tuple(
            codec.read(item, get) for codec, item in zip(codecs(len(facts)), facts, strict=True)
        )

    return _Codec(write, read)


def _mapping_codec(key: Any, item: Any) -> _Codec:
    """Return the codec of a mapping: an object where the keys are text, else a list of pairs."""

    def write(value: Any, put: Put) -> Any:
        keys, items = _codec(key), _codec(item)
        if key is str:
            return {name: items.write(one, put) for name, one in value.items()}
        return [[keys.write(name, put), items.write(one, put)] for name, one in value.items()]

    def read(facts: Any, get: Get) -> Any:
        keys, items = _codec(key), _codec(item)
        if key is str:
            return {name: items.read(one, get) for name, one in facts.items()}
        return {keys.read(name, get): items.read(one, get) for name, one in facts}

    return _Codec(write, read)


def _union_codec(options: tuple[Any, ...]) -> _Codec:
    """Return the codec of one of several types: null for None, its number where more are left."""
    rest = [option for option in options if option is not type(None)]

    def write(value: Any, put: Put) -> Any:
        if value is None:
            return None
        if len(rest) == 1:
            return _codec(rest[0]).write(value, put)
        place = next(n for n, option in enumerate(rest) if _holds(option, value))
        return [place, _codec(rest[place]).write(value, put)]

    def read(facts: Any, get: Get) -> Any:
        if facts is None and len(rest) < len(options):
            return None
        if len(rest) == 1:
            return _codec(rest[0]).read(facts, get)
        place, own = facts
        return _codec(rest[place]).read(own, get)

    return _Codec(write, read)


def _holds(option: Any, value: Any) -> bool:
    option = unwrapped(option)[0]
    origin = get_origin(option)
    if origin is Literal:
        return value in get_args(option)
    return isinstance(value, option if origin is None else origin)


def _fields_codec(cls: Any) -> _Codec:
    def write(value: Any, put: Put) -> Any:
        return {
            name: _codec(hint).write(getattr(value, name), put)
            for name, hint in type_hints(cls).items()
        }

    def read(facts: Any, get: Get) -> Any:
        hints = type_hints(cls)
        if facts.keys() != hints.keys():
            raise ValueError(
                f"{kind_name(cls)} with other fields ({', '.join(hints.keys() ^ facts.keys())})"
            )
        return cls(**{name: _codec(hint).read(facts[name], get) for name, hint in hints.items()})

    return _Codec(write, read)
