"""How the values of an annotation become JSON, with arrays put elsewhere, and come back."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, is_dataclass
from enum import Enum
from functools import cache
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import numpy as np

from ostiform.arrays import read_only
from ostiform.values import dtype_of, is_union, type_hints, unwrapped

ARRAY_KINDS = "fiub"  # floats, integers, bool


@dataclass(frozen=True, slots=True)
class StoredAs:
    """The type that an array has in files only (single precision for what is only drawn)."""

    dtype: Any


def kind_name(kind: Any) -> str:
    """Return what the values of a type are called in files and messages."""
    if get_origin(kind) is tuple:
        return kind_name(get_args(kind)[0]) + "s"
    words = "".join(f" {c.lower()}" if c.isupper() else c for c in kind.__name__)
    return words.strip()


Put = Callable[[np.ndarray], Any]
Get = Callable[[Any], np.ndarray]


@dataclass(frozen=True, slots=True)
class Codec:
    """How values of one annotation become JSON (with arrays put elsewhere) and come back."""

    write: Callable[[Any, Put], Any]
    read: Callable[[Any, Get], Any]


@cache
def codec(hint: Any) -> Codec:
    """Return how the values of an annotation are written and read.

    Raises
    ------
    TypeError
        If files cannot hold them.
    """
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


def number(value: Any) -> Any:
    """Return a number as JSON holds it: as text where it is not finite."""
    found = float(value)
    return found if math.isfinite(found) else str(found)


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


_PLAIN: dict[Any, Codec] = {
    str: Codec(lambda value, put: str(value), _of(str)),
    bool: Codec(lambda value, put: bool(value), _of(bool)),
    int: Codec(lambda value, put: int(value), _of(int)),
    float: Codec(lambda value, put: number(value), _read_float),
    type(None): Codec(lambda value, put: None, _of(type(None))),
    Path: Codec(lambda value, put: str(value), lambda facts, get: Path(facts)),
    Any: Codec(lambda value, put: value, lambda facts, get: facts),
}


def _array_codec(dtype: Any, stored: Any) -> Codec:
    def write(value: Any, put: Put) -> Any:
        return put(value if stored is None else read_only(value.astype(stored)))

    def read(facts: Any, get: Get) -> Any:
        array = get(facts)
        if array.dtype.kind not in ARRAY_KINDS:
            raise TypeError(f"an array of {array.dtype}")
        if dtype is Any or array.dtype == dtype:
            return array
        if array.dtype.kind == "f" and np.dtype(dtype).kind != "f" and array.size:
            raise TypeError(f"an array of {array.dtype} where {np.dtype(dtype)} was expected")
        return array.astype(dtype)

    return Codec(write, read)


def _choice_codec(choices: Mapping[Any, Any], name: Callable[[Any], Any]) -> Codec:
    return Codec(lambda value, put: name(value), lambda facts, get: choices[facts])


def _tuple_codec(hints: tuple[Any, ...]) -> Codec:
    own = [codec(hint) for hint in hints if hint is not ...]

    def codecs(count: int) -> list[Codec]:
        return own * count if hints[1:] == (...,) else own

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

    return Codec(write, read)


def _mapping_codec(key: Any, item: Any) -> Codec:
    """Return the codec of a mapping: an object where the keys are text, else a list of pairs."""
    keys, items = codec(key), codec(item)

    def write(value: Any, put: Put) -> Any:
        if key is str:
            return {name: items.write(one, put) for name, one in value.items()}
        return [[keys.write(name, put), items.write(one, put)] for name, one in value.items()]

    def read(facts: Any, get: Get) -> Any:
        if key is str:
            return {name: items.read(one, get) for name, one in facts.items()}
        return {keys.read(name, get): items.read(one, get) for name, one in facts}

    return Codec(write, read)


def _union_codec(options: tuple[Any, ...]) -> Codec:
    """Return the codec of one of several types: null for None, its number where more are left."""
    rest = [option for option in options if option is not type(None)]
    codecs = [codec(option) for option in rest]

    def write(value: Any, put: Put) -> Any:
        if value is None:
            return None
        if len(rest) == 1:
            return codecs[0].write(value, put)
        place = next(n for n, option in enumerate(rest) if _holds(option, value))
        return [place, codecs[place].write(value, put)]

    def read(facts: Any, get: Get) -> Any:
        if facts is None and len(rest) < len(options):
            return None
        if len(rest) == 1:
            return codecs[0].read(facts, get)
        place, own = facts
        return codecs[place].read(own, get)

    return Codec(write, read)


def _holds(option: Any, value: Any) -> bool:
    option = unwrapped(option)[0]
    origin = get_origin(option)
    if origin is Literal:
        return value in get_args(option)
    return isinstance(value, option if origin is None else origin)


def _fields_codec(cls: Any) -> Codec:
    own = {name: codec(hint) for name, hint in type_hints(cls).items()}

    def write(value: Any, put: Put) -> Any:
        return {name: one.write(getattr(value, name), put) for name, one in own.items()}

    def read(facts: Any, get: Get) -> Any:
        if facts.keys() != own.keys():
            raise ValueError(
                f"{kind_name(cls)} with other fields ({', '.join(own.keys() ^ facts.keys())})"
            )
        return cls(**{name: one.read(facts[name], get) for name, one in own.items()})

    return Codec(write, read)
