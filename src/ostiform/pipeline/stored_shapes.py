"""The shapes of a run as the correspondence takes them: on disk, worked on in chunks."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TypeVar

from ostiform.artifacts import load_mapped
from ostiform.correspondence import ShapeSampler, SurfaceMarks, sampler
from ostiform.domain import BaseDomain
from ostiform.embedding import Embeddings
from ostiform.execution import Executor
from ostiform.pipeline.embed import embedding_artifact
from ostiform.pipeline.run import Ready, Run

Item = TypeVar("Item")
Shared = TypeVar("Shared")
Result = TypeVar("Result")

LARGEST_CHUNK = 16
"""Shapes that are worked on, and lost with a killed worker, together."""

CHUNKS_PER_WORKER = 3
"""At least so many, where there are few shapes: workers then end at about the same time."""


MOST_OPEN = 128
"""Shapes that a process keeps open: their arrays are mapped from their files."""


@dataclass(frozen=True, slots=True, eq=False)
class StoredShape:
    """Where a shape lies, and what a study says about it.

    Attributes
    ----------
    path : Path
    marks : SurfaceMarks or None
        The user's landmarks.
    """

    path: Path
    marks: SurfaceMarks | None


@dataclass(frozen=True, slots=True, eq=False)
class StoredShapes:
    """Shapes on disk; see `correspondence.shapes.Shapes`.

    Attributes
    ----------
    stored : tuple of StoredShape
    domain : BaseDomain
    workers : Executor
        What works on chunks of shapes. Results do not depend on it.
    """

    stored: tuple[StoredShape, ...]
    domain: BaseDomain
    workers: Executor

    def __len__(self) -> int:
        """Return the number of shapes."""
        return len(self.stored)

    def at(self, index: int) -> ShapeSampler:
        """Return one shape.

        Raises
        ------
        ArtifactError
            If its file is missing or damaged.
        """
        return _opened(self.stored[index], self.domain)

    def chosen(self, indices: Sequence[int]) -> "StoredShapes":
        """Return some of the shapes, in the order given."""
        return replace(self, stored=tuple(self.stored[index] for index in indices))

    def each(
        self,
        function: Callable[[ShapeSampler, Item, Shared], Result],
        items: Sequence[Item],
        shared: Shared,
    ) -> list[Result]:
        """Return ``function(shape, item, shared)`` of every shape, in their order.

        Raises
        ------
        OstiformError
            If the function fails for a shape, or its file is missing or damaged.
        """
        pairs = list(zip(self.stored, items, strict=True))
        size = chunk_size(len(pairs), self.workers.count)
        chunks = [pairs[first : first + size] for first in range(0, len(pairs), size)]
        results: list[list[Result]] = [[] for _ in chunks]
        for outcome in self.workers.each(_chunk, chunks, self.domain, function, shared):
            results[outcome.index] = outcome.result
        return [result for chunk in results for result in chunk]


def stored_shapes(
    run: Run,
    ready: Sequence[Ready],
    domain: BaseDomain,
    marks: Sequence[SurfaceMarks | None],
) -> StoredShapes:
    """Return embedded shapes as the files of their embeddings, opened when they are sampled.

    Parameters
    ----------
    run : Run
    ready : sequence of Ready
        Shapes with embeddings.
    domain : BaseDomain
    marks : sequence of SurfaceMarks or None
        As many.
    """
    stored = tuple(
        StoredShape(run.store.path(embedding_artifact(shape.name)), own)
        for shape, own in zip(ready, marks, strict=True)
    )
    return StoredShapes(stored, domain, run.workers)


def chunk_size(n_shapes: int, n_workers: int) -> int:
    """Return how many shapes to hand to a worker at a time."""
    return max(1, min(LARGEST_CHUNK, -(-n_shapes // (CHUNKS_PER_WORKER * n_workers))))


def _chunk(
    pairs: Sequence[tuple[StoredShape, Item]],
    domain: BaseDomain,
    function: Callable[[ShapeSampler, Item, Shared], Result],
    shared: Shared,
) -> list[Result]:
    return [function(_opened(stored, domain), item, shared) for stored, item in pairs]


def _opened(stored: StoredShape, domain: BaseDomain) -> ShapeSampler:
    found = stored.path.stat() if stored.path.is_file() else None
    stamp = None if found is None else (found.st_ino, found.st_size, found.st_mtime_ns)
    return replace(sampler(_embeddings(stored.path, stamp), domain), marks=stored.marks)


@lru_cache(maxsize=MOST_OPEN)
def _embeddings(path: Path, stamp: tuple[int, int, int] | None) -> Embeddings:
    """Return the embeddings of a file as it is now; a sweep opens every shape some 60 times."""
    return load_mapped(path, Embeddings)
