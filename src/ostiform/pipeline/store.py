"""The output folder: artifacts, each with a record of what it was made from.

Beside an artifact ``NAME`` lies ``.ostiform/NAME.json`` with the key of its inputs and the hash
of its content, written after it. An artifact without a record, with another key (its inputs
changed) or with other content than its record says (the program was killed between the two, or
the file was damaged or replaced) is made again.
"""

import hashlib
import json
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import quote

from ostiform import __version__
from ostiform.atomic import atomically
from ostiform.errors import ArtifactError
from ostiform.pipeline.versions import VERSIONS
from ostiform.study import ShapeId

Value = TypeVar("Value")

RECORDS = ".ostiform"
SCHEMA = 1
LONGEST_SLUG = 80


@dataclass(frozen=True, slots=True)
class Store:
    """An output folder."""

    root: Path

    def path(self, name: str) -> Path:
        """Return the path of an artifact."""
        return self.root / name

    def is_current(self, name: str, key: str) -> bool:
        """Whether the artifact exists, was made from inputs of this key, and is undamaged."""
        record = self._record(name)
        try:
            return (
                record is not None
                and record["key"] == key
                and self.path(name).is_file()
                and file_hash(self.path(name)) == record["sha256"]
            )
        except OSError:  # it cannot be read, so it cannot be used
            return False

    def read_current(self, name: str, key: str, read: Callable[[Path], Value]) -> Value | None:
        """Return what an artifact holds; None if it is not current or of another layout."""
        if not self.is_current(name, key):
            return None
        try:
            return read(self.path(name))
        except ArtifactError:
            return None

    @contextmanager
    def writing(self, name: str, key: str) -> Iterator[Path]:
        """Give a temporary path to fill, then put it in place and record its key.

        Whatever fails, the file that was there before stays as it was.

        Raises
        ------
        ArtifactError
            If the file cannot be written, or would lie outside the output folder.
        """
        path, record = self.path(name), self._record_path(name)
        for target in (path, record):
            self._refuse_outside(target)
        with atomically(path) as temporary:
            yield temporary
            sha256 = file_hash(temporary)
        self._write_record(name, key, sha256)

    def remove(self, name: str) -> None:
        """Remove an artifact that is no longer needed, and its record."""
        for path in (self._record_path(name), self.path(name)):
            try:
                path.unlink(missing_ok=True)
            except OSError as error:
                raise ArtifactError(
                    f"{path}: expected to remove this file, found that {error.strerror or error}; "
                    "make the output folder writable"
                ) from error

    def write_json(self, name: str, key: str, value: Any) -> None:
        """Write a JSON artifact."""
        with self.writing(name, key) as temporary:
            text = json.dumps(value, indent=1, ensure_ascii=False, allow_nan=False)
            temporary.write_text(text + "\n", encoding="utf-8")

    def read_json(self, name: str) -> Any:
        """Read a JSON artifact.

        Raises
        ------
        ArtifactError
            If it is missing or not JSON.
        """
        path = self.path(name)
        try:
            return json.loads(path.read_text(encoding="utf-8"))
        except FileNotFoundError as error:
            raise ArtifactError(
                f"{path}: expected the result of an earlier stage, found no such file; "
                "run `ostiform build` on this output folder"
            ) from error
        except (OSError, ValueError, RecursionError) as error:
            raise ArtifactError(
                f"{path}: expected JSON written by this program, found {error}; "
                "delete the file and run `ostiform build` again"
            ) from error

    def _refuse_outside(self, path: Path) -> None:
        root, folder = self.root.resolve(), path.parent.resolve()
        if not folder.is_relative_to(root):
            raise ArtifactError(
                f"{path}: expected to write within {root}, found that its folder leads to "
                f"{folder}; remove the link or choose another output folder"
            )

    def _record_path(self, name: str) -> Path:
        return self.root / RECORDS / f"{name}.json"

    def _record(self, name: str) -> dict[str, Any] | None:
        try:
            record = json.loads(self._record_path(name).read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError):
            return None
        if not isinstance(record, dict) or record.get("schema") != SCHEMA:
            return None
        is_own = record.get("name", name) == name  # not copied from another artifact
        return record if is_own and {"key", "sha256"} <= record.keys() else None

    def _write_record(self, name: str, key: str, sha256: str) -> None:
        record = {
            "schema": SCHEMA,
            "version": __version__,
            "name": name,
            "key": key,
            "sha256": sha256,
        }
        with atomically(self._record_path(name)) as temporary:
            temporary.write_text(json.dumps(record) + "\n", encoding="utf-8")


def key_of(stage: str, *inputs: Any) -> str:
    """Return the hash of a stage's version and inputs, the same for equal ones.

    Parameters
    ----------
    stage : str
        One of `VERSIONS`.
    *inputs
        Values that JSON can hold: settings, and keys of what earlier stages made.
    """
    text = json.dumps([SCHEMA, stage, VERSIONS[stage], *inputs], sort_keys=True, ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()


def file_hash(path: Path) -> str:
    """Return the SHA-256 of a file's content."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def slug(shape: ShapeId) -> str:
    """Return a file name, without folder or suffix, that no other shape of a study has.

    Whatever the names hold (separators, dots, any script), the result is one plain path segment.
    """
    phase = shape.phase or "0"  # so that a file has two names also where there are no phases
    name = f"{quote(shape.subject, safe=' ')}_{quote(phase, safe=' ')}".replace(".", "%2E")
    if (
        len(name) <= LONGEST_SLUG
        and re.fullmatch(r"[\w%-][\w %-]*", name)
        and "_" not in (shape.subject + phase)
    ):
        return name
    digest = hashlib.sha256(json.dumps([shape.subject, phase]).encode()).hexdigest()[:12]
    return f"{name[: LONGEST_SLUG - 13]}-{digest}"
