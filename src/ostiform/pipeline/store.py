"""The output folder: artifacts, each with a record of what it was made from.

Beside an artifact ``NAME`` lies ``.ostiform/NAME.json`` with the key of its inputs and the hash
of its content, written after it. An artifact without a record (the program was killed), with
another key (its inputs changed) or with other content (it was damaged or replaced) is made again.
"""

import hashlib
import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

from ostiform import __version__
from ostiform.atomic import atomically
from ostiform.errors import ArtifactError
from ostiform.study import ShapeId

__all__ = ["Store", "file_hash", "key_of", "slug"]

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
        return (
            record is not None
            and record["key"] == key
            and self.path(name).is_file()
            and file_hash(self.path(name)) == record["sha256"]
        )

    def content(self, name: str) -> str:
        """Return the content hash of an artifact that `is_current`, from its record."""
        record = self._record(name)
        if record is None:
            raise ArtifactError(
                f"{self.path(name)}: expected an artifact of this program, found none; "
                "run `ostiform build` on this output folder"
            )
        return str(record["sha256"])

    @contextmanager
    def writing(self, name: str, key: str) -> Iterator[Path]:
        """Give a temporary path to fill, then put it in place and record its key."""
        record = self._record_path(name)
        record.unlink(missing_ok=True)
        with atomically(self.path(name)) as temporary:
            yield temporary
        self._write_record(record, key, file_hash(self.path(name)))

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
        except (OSError, ValueError) as error:
            raise ArtifactError(
                f"{path}: expected JSON written by this program, found {error}; "
                "delete the file and run `ostiform build` again"
            ) from error

    def _record_path(self, name: str) -> Path:
        return self.root / RECORDS / f"{name}.json"

    def _record(self, name: str) -> dict[str, Any] | None:
        try:
            record = json.loads(self._record_path(name).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        if not isinstance(record, dict) or record.get("schema") != SCHEMA:
            return None
        return record if {"key", "sha256"} <= record.keys() else None

    def _write_record(self, path: Path, key: str, sha256: str) -> None:
        record = {"schema": SCHEMA, "version": __version__, "key": key, "sha256": sha256}
        with atomically(path) as temporary:
            temporary.write_text(json.dumps(record) + "\n", encoding="utf-8")


def key_of(*inputs: Any) -> str:
    """Return the hash of values that JSON can hold, the same for equal values."""
    text = json.dumps([__version__, SCHEMA, *inputs], sort_keys=True, ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()


def file_hash(path: Path) -> str:
    """Return the SHA-256 of a file's content."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def slug(shape: ShapeId) -> str:
    """Return a file name, without folder or suffix, that no other shape of a study has.

    Whatever the names hold (separators, dots, any script), the result is one plain path segment.
    """
    name = f"{quote(shape.subject, safe=' ')}_{quote(shape.phase, safe=' ')}".replace(".", "%2E")
    if (
        len(name) <= LONGEST_SLUG
        and re.fullmatch(r"[\w%-][\w %-]*", name)
        and "_" not in (shape.subject + shape.phase)
    ):
        return name
    digest = hashlib.sha256(json.dumps([shape.subject, shape.phase]).encode()).hexdigest()[:12]
    return f"{name[: LONGEST_SLUG - 13]}-{digest}"
