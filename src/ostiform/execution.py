"""One function over many items: in this process or in several, with the failures kept apart.

Workers hand back small values; whatever is large they write to disk themselves. A worker that
is killed costs its own items only: they are done again by a fresh pool.
"""

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Generic, TypeVar

from ostiform.errors import OstiformError

__all__ = ["Outcome", "Workers"]

Item = TypeVar("Item")
Result = TypeVar("Result")

POOL_RESTARTS = 3
"""Fresh pools tried after workers were killed, before the items still open count as failed."""

THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True, slots=True)
class Outcome(Generic[Result]):
    """What became of one item.

    Attributes
    ----------
    index : int
        Position of the item in the sequence given.
    value : Result or None
        What the function returned; None if it failed.
    error : OstiformError or None
        The foreseen failure; anything unforeseen is raised instead.
    """

    index: int
    value: Result | None
    error: OstiformError | None

    @property
    def result(self) -> Result:
        """The value of an item that did not fail; raises its error otherwise."""
        if self.error is not None:
            raise self.error
        return self.value  # type: ignore[return-value]


@dataclass(slots=True)
class Workers:
    """Processes that a run keeps for all its stages; with a count of 1, this process itself.

    A context manager: leaving it ends the processes, at once if an exception is under way.
    """

    count: int
    _pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> "Workers":
        """Return this value; processes are started when first needed."""
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """End the processes."""
        if self._pool is not None and kind is not None:
            _terminate(self._pool)
        self._close()

    def each(
        self, function: Callable[[Item], Result], items: Sequence[Item]
    ) -> Iterator[Outcome[Result]]:
        """Yield the outcome of `function(item)` for every item, in the order they finish.

        Parameters
        ----------
        function : callable
            A function of one item; importable by name when there are several processes.
        items : sequence
            Picklable when there are several processes.

        Raises
        ------
        OstiformError
            If workers keep dying.
        """
        if self.count <= 1 or len(items) <= 1:
            for index, item in enumerate(items):
                yield _outcome(function, index, item)
            return
        open_items = dict(enumerate(items))
        for _ in range(1 + POOL_RESTARTS):
            try:
                for outcome in self._pooled(function, open_items):
                    del open_items[outcome.index]
                    yield outcome
                return
            except BrokenProcessPool:
                self._close()
        raise OstiformError(
            f"expected worker processes to finish, found that they were killed "
            f"{POOL_RESTARTS + 1} times with {len(open_items)} items open (out of memory?); "
            "run again with fewer workers"
        )

    def _pooled(
        self, function: Callable[[Item], Result], items: dict[int, Item]
    ) -> Iterator[Outcome[Result]]:
        pool = self._started()
        pending: set[Future[Outcome[Result]]] = {
            pool.submit(_outcome, function, index, item) for index, item in items.items()
        }
        while pending:
            done, pending = wait(pending, return_when=FIRST_COMPLETED)
            for future in done:
                yield future.result()

    def _started(self) -> ProcessPoolExecutor:
        if self._pool is None:
            self._pool = ProcessPoolExecutor(
                self.count,
                mp_context=multiprocessing.get_context("spawn"),
                initializer=_start_worker,
            )
            with _single_threaded():  # read when a worker imports NumPy
                for _ in range(self.count):
                    self._pool.submit(os.getpid)  # each starts a process, up to the count
        return self._pool

    def _close(self) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)
            self._pool = None


@contextmanager
def _single_threaded() -> Iterator[None]:
    """Give processes started in the block one thread each for linear algebra."""
    before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _outcome(function: Callable[[Item], Result], index: int, item: Item) -> Outcome[Result]:
    try:
        return Outcome(index, function(item), None)
    except OstiformError as error:
        return Outcome(index, None, error)


def _start_worker() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle


def _terminate(pool: ProcessPoolExecutor) -> None:
    """End the workers at once: what they had finished is on disk, the rest is done again."""
    for process in list((pool._processes or {}).values()):
        process.terminate()
