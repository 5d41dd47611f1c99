"""Damage to files: of bytes, of words, and of what lies within a container."""

import gzip
import io
import json
import struct
import tempfile
import tomllib
import zipfile
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

__all__ = ["damaged"]

Rng = np.random.Generator

EXTREME_INTEGERS = (0, 1, -1, 127, 255, 2**15, 2**31 - 1, -(2**31), 2**32 - 1, 2**62, -(2**63))
EXTREME_WORDS = (
    b"nan", b"-inf", b"1e999", b"-1", b"0", b"99999999999999999999", b"1.5", b"", b"x", b"\xff\xfe",
    b'"', b"'", b"{", b"]", b"<", b"&#0;", b"../../etc/passwd", b"null", b"true", b"3 3", b"\x00",
)  # fmt: skip
EXTREME_VALUES: tuple[Any, ...] = (
    None, True, -1, 0, 1e308, 2**70, "", "x", "../../x", [], {}, [[]], [1, 2], {"a": 1}, ["x"], 0.5,
    float("nan"), float("inf"), "<script>", -1e308, "\0", [None],
)  # fmt: skip


def damaged(content: bytes, others: Sequence[bytes], rng: Rng) -> bytes:
    """Return a file's content after one to three mishaps.

    Parameters
    ----------
    content : bytes
    others : sequence of bytes
        Further files of the same kind, to splice with.
    rng : numpy.random.Generator
    """
    inner = _inner_mutation(content)
    with np.errstate(all="ignore"):
        for _ in range(1 + int(rng.integers(3) == 0) + int(rng.integers(6) == 0)):
            if inner is not None and rng.random() < 0.6:
                content = inner(content, others, rng)
                continue
            mutation = MUTATIONS[int(rng.integers(len(MUTATIONS)))]
            content = mutation(content, others, rng)
    return content


def _place(content: bytes, rng: Rng) -> int:
    """Return a place in a file; headers are likelier than their length says."""
    end = min(len(content), 512) if rng.random() < 0.5 else len(content)
    return int(rng.integers(end + 1))


def _truncated(content: bytes, _: Sequence[bytes], rng: Rng) -> bytes:
    return content[: _place(content, rng)]


def _flipped(content: bytes, _: Sequence[bytes], rng: Rng) -> bytes:
    changed = bytearray(content)
    for _bit in range(int(rng.integers(1, 9)) if changed else 0):
        changed[min(_place(content, rng), len(changed) - 1)] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def _overwritten(content: bytes, _: Sequence[bytes], rng: Rng) -> bytes:
    start, size = _place(content, rng), int(rng.integers(1, 65))
    fill = (rng.bytes(size), b"\0" * size, b"\xff" * size, b" " * size)[int(rng.integers(4))]
    return content[:start] + fill + content[start + size :]


def _random_header(content: bytes, _: Sequence[bytes], rng: Rng) -> bytes:
    size = int(rng.integers(1, 129))
    return rng.bytes(size) + content[size:]


def _integer(content: bytes, _: Sequence[bytes], rng: Rng) -> bytes:
    start = _place(content, rng)
    value = EXTREME_INTEGERS[int(rng.integers(len(EXTREME_INTEGERS)))]
    kind = "<>"[int(rng.integers(2))] + "bhiq"[int(rng.integers(4))]
    size = struct.calcsize(kind)
    packed = (value & (2 ** (8 * size) - 1)).to_bytes(size, "little" if kind[0] == "<" else "big")
    return content[:start] + packed + content[start + size :]


def _cut_out(content: bytes, _: Sequence[bytes], rng: Rng) -> bytes:
    start, size = _place(content, rng), int(rng.integers(1, 257))
    return content[:start] + content[start + size :]


def _doubled(content: bytes, _: Sequence[bytes], rng: Rng) -> bytes:
    start, size = _place(content, rng), int(rng.integers(1, 257))
    return content[: start + size] + content[start:]


def _inserted(content: bytes, _: Sequence[bytes], rng: Rng) -> bytes:
    start = _place(content, rng)
    return content[:start] + rng.bytes(int(rng.integers(1, 33))) + content[start:]


def _spliced(content: bytes, others: Sequence[bytes], rng: Rng) -> bytes:
    if not others:
        return _truncated(content, others, rng)
    other = others[int(rng.integers(len(others)))]
    return content[: _place(content, rng)] + other[_place(other, rng) :]


def _word(content: bytes, _: Sequence[bytes], rng: Rng) -> bytes:
    """Replace a word, as text formats have them, by one that asks for trouble."""
    start = _place(content, rng)
    separators = b" \t\r\n,;:=\"'<>[]{}()/"
    while 0 < start < len(content) and content[start - 1] not in separators:
        start -= 1
    end = start
    while end < len(content) and end - start < 64 and content[end] not in separators:
        end += 1
    word = EXTREME_WORDS[int(rng.integers(len(EXTREME_WORDS)))]
    return content[:start] + word + content[end:]


def _lines_shuffled(content: bytes, _: Sequence[bytes], rng: Rng) -> bytes:
    lines = content.split(b"\n")
    one, two = rng.integers(len(lines), size=2)
    lines[one], lines[two] = lines[two], lines[one]
    return b"\n".join(lines)


MUTATIONS: tuple[Callable[[bytes, Sequence[bytes], Rng], bytes], ...] = (
    _truncated, _flipped, _overwritten, _random_header, _integer, _cut_out, _doubled, _inserted,
    _spliced, _word, _word, _lines_shuffled,
)  # fmt: skip


def _inner_mutation(content: bytes) -> Callable[[bytes, Sequence[bytes], Rng], bytes] | None:
    """Return the mutation that keeps a file's container whole, if it has one."""
    if content[:2] == b"\x1f\x8b":
        return _in_gzip
    if content[:4] == b"PK\x03\x04":
        return _in_zip
    if content[:8] == b"\x89HDF\r\n\x1a\n":
        return _in_hdf5
    if content[:1] in (b"{", b"["):
        return _in_json
    if content.startswith(b"schema = "):
        return _in_toml
    return None


def _plainly(content: bytes, rng: Rng) -> bytes:
    if _inner_mutation(content) is _in_json and rng.random() < 0.7:
        return _in_json(content, (), rng)
    return MUTATIONS[int(rng.integers(len(MUTATIONS)))](content, (), rng)


def _in_gzip(content: bytes, _: Sequence[bytes], rng: Rng) -> bytes:
    try:
        return gzip.compress(_plainly(gzip.decompress(content), rng), mtime=0)
    except (OSError, EOFError, zlib.error):
        return _flipped(content, (), rng)


def _in_zip(content: bytes, _: Sequence[bytes], rng: Rng) -> bytes:
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = [(name, archive.read(name)) for name in archive.namelist()]
        chosen = int(rng.integers(len(members)))
        name, inner = members[chosen]
        action = rng.random()
        if action < 0.1:
            members.pop(chosen)
        elif action < 0.2:
            members[chosen] = (name, members[int(rng.integers(len(members)))][1])
        elif action < 0.4 and name.endswith(".npy"):
            members[chosen] = (name, _other_array(inner, rng))
        else:
            members[chosen] = (name, _plainly(inner, rng))
        written = io.BytesIO()
        with zipfile.ZipFile(written, "w") as archive:
            for name, inner in members:
                archive.writestr(name, inner)
        return written.getvalue()
    except (zipfile.BadZipFile, ValueError, OSError, NotImplementedError, RuntimeError, EOFError,
            zlib.error, KeyError):  # fmt: skip
        return _flipped(content, (), rng)


def _changed_array(array: np.ndarray, rng: Rng) -> np.ndarray:
    """Return an array of other type, shape or values."""
    action = int(rng.integers(7))
    if action == 0:
        return array.astype(("f4", "i1", "U8", "c16", "u8", "f8", "?")[int(rng.integers(7))])
    if action == 1:
        return array[..., None]
    if action == 2:
        return array.reshape(-1)[: int(rng.integers(array.size + 1))]
    if action == 3:
        return array.reshape(-1)[:0]
    if action == 4:
        return np.zeros((), array.dtype)
    if array.size and array.dtype.kind in "iuf":
        changed = array.copy()
        values = (np.nan, np.inf, -1e308) if array.dtype.kind == "f" else (-1, 2**30, 0, 127)
        changed.reshape(-1)[int(rng.integers(array.size))] = np.array(
            values[int(rng.integers(len(values)))]
        ).astype(array.dtype)
        return changed
    return np.concatenate([array.reshape(-1)] * 2)


def _other_array(inner: bytes, rng: Rng) -> bytes:
    try:
        array = np.load(io.BytesIO(inner), allow_pickle=False)
        changed = _changed_array(array, rng)
    except (ValueError, OverflowError, EOFError, TypeError):
        return inner[:-1]
    written = io.BytesIO()
    np.save(written, changed, allow_pickle=False)
    return written.getvalue()


def _in_hdf5(content: bytes, _: Sequence[bytes], rng: Rng) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "file.h5")
        path.write_bytes(content)
        try:
            with h5py.File(path, "r+") as file:
                _change_hdf5(file, rng)
        except (OSError, KeyError, ValueError, TypeError, RuntimeError, OverflowError):
            return _flipped(content, (), rng)
        return path.read_bytes()


def _change_hdf5(file: h5py.File, rng: Rng) -> None:
    names: list[str] = []
    file.visit(names.append)
    name = names[int(rng.integers(len(names)))]
    action = rng.random()
    holders = [n for n in ("", *names) if len(file[n or "/"].attrs)]
    if action < 0.25 and holders:
        holder = file[holders[int(rng.integers(len(holders)))] or "/"]
        key = sorted(holder.attrs)[int(rng.integers(len(holder.attrs)))]
        value = EXTREME_VALUES[int(rng.integers(len(EXTREME_VALUES)))]
        del holder.attrs[key]
        if isinstance(value, int | float | str):
            holder.attrs[key] = value
    elif action < 0.45:
        del file[name]
    elif action < 0.6:
        other = names[int(rng.integers(len(names)))]
        held = file[other]
        del file[name]
        file[name] = held
    elif action < 0.65:
        del file[name]
        file[name] = h5py.SoftLink("/" + name)
    elif action < 0.7:
        del file[name]
        file[name] = h5py.ExternalLink("/etc/passwd", "/")
    elif action < 0.75:
        del file[name]
        file.create_dataset(name, (2**40,), "f8", chunks=(2**20,))  # announced, not stored
    elif isinstance(file[name], h5py.Dataset):
        values = np.asarray(file[name][()])
        del file[name]
        if values.dtype == object:
            file[name] = [1, 2, 3]
        else:
            file[name] = _changed_array(values, rng)


def _in_json(content: bytes, _: Sequence[bytes], rng: Rng) -> bytes:
    try:
        document = json.loads(content)
    except (ValueError, RecursionError):
        return _word(content, (), rng)
    if not isinstance(document, dict | list) or not _change_document(document, rng):
        return _word(content, (), rng)
    text = json.dumps(document)
    if rng.random() < 0.03:
        depth = int(rng.integers(1, 3000))
        text = text.replace("null", "[" * depth + "]" * depth, 1)
    return text.encode()


def _in_toml(content: bytes, _: Sequence[bytes], rng: Rng) -> bytes:
    try:
        document = tomllib.loads(content.decode("utf-8"))
    except (ValueError, RecursionError):
        return _word(content, (), rng)
    if not _change_document(document, rng):
        return _word(content, (), rng)
    return "".join(f"{json.dumps(k)} = {_toml(v)}\n" for k, v in document.items()).encode()


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(k)} = {_toml(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    if isinstance(value, float):
        return repr(value)
    return json.dumps("null" if value is None else value)


def _change_document(document: Any, rng: Rng) -> bool:
    """Change one value of nested dictionaries and lists; False if there is none."""
    places: list[tuple[Any, Any]] = []

    def visit(value: Any, depth: int) -> None:
        keys = list(value) if isinstance(value, dict) else range(len(value))
        for key in keys:
            places.append((value, key))
            if isinstance(value[key], dict | list) and depth < 30:
                visit(value[key], depth + 1)

    visit(document, 0)
    if not places:
        return False
    # Names are as likely as the many numbers of the long lists.
    named = [place for place in places if isinstance(place[0], dict)]
    pool = named if named and rng.random() < 0.7 else places
    holder, key = pool[int(rng.integers(len(pool)))]
    action = rng.random()
    if action < 0.2:
        del holder[key]
    elif action < 0.3 and isinstance(holder, dict):
        holder["unknown"] = holder.pop(key)
    else:
        holder[key] = EXTREME_VALUES[int(rng.integers(len(EXTREME_VALUES)))]
    return True
