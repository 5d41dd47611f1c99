"""Intermediate results as files of their own: embeddings, and where the sweeps stand."""

from collections.abc import Sequence
from pathlib import Path

from ostiform.artifacts import load, save
from ostiform.correspondence import Checkpoint
from ostiform.embedding import Embedding


def write_embeddings(path: Path, embeddings: Sequence[Embedding]) -> None:
    """Write the embeddings of one shape, one per component; states keep single precision."""
    save(path, tuple(embeddings), tuple[Embedding, ...])


def read_embeddings(path: Path) -> tuple[Embedding, ...]:
    """Read what `write_embeddings` wrote; see `ostiform.artifacts.load`."""
    return load(path, tuple[Embedding, ...])


def write_checkpoint(path: Path, state: Checkpoint) -> None:
    """Write where the sweeps of a level stand; every bit is kept."""
    save(path, state)


def read_checkpoint(path: Path) -> Checkpoint:
    """Read what `write_checkpoint` wrote; see `ostiform.artifacts.load`."""
    return load(path, Checkpoint)
