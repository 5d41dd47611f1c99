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
from dataclasses import dataclass
from typing import Generic, TypeVar

from ostiform.errors import OstiformError

__all__ = ["Outcome", "each"]

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


def each(
    function: Callable[[Item], Result], items: Sequence[Item], workers: int = 1
) -> Iterator[Outcome[Result]]:
    """Yield the outcome of `function(item)` for every item, in the order in which they finish.

    Parameters
    ----------
    function : callable
        A function of one item; importable by name when `workers` is above one.
    items : sequence
        Picklable when `workers` is above one.
    workers : int
        Processes; 1 runs in this process.

    Raises
    ------
    OstiformError
        If workers keep dying.
    """
    if workers <= 1 or len(items) <= 1:
        for index, item in enumerate(items):
            yield _outcome(function, index, item)
        return
    open_items = dict(enumerate(items))
    for _ in range(1 + POOL_RESTARTS):
        try:
            for outcome in _pooled(function, open_items, min(workers, len(items))):
                del open_items[outcome.index]
                yield outcome
            return
        except BrokenProcessPool:
            continue
    raise OstiformError(
        f"expected worker processes to finish, found that they were killed {POOL_RESTARTS + 1} "
        f"times with {len(open_items)} items open (out of memory?); run again with fewer workers"
    )


def _pooled(
    function: Callable[[Item], Result], items: dict[int, Item], workers: int
) -> Iterator[Outcome[Result]]:
    pool = ProcessPoolExecutor(
        workers, mp_context=multiprocessing.get_context("spawn"), initializer=_start_worker
    )
    threads = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))  # read when a worker imports NumPy
    try:
        pending: set[Future[Outcome[Result]]] = {
            pool.submit(_outcome, function, index, item) for index, item in items.items()
        }
        while pending:
            done, pending = wait(pending, return_when=FIRST_COMPLETED)
            for future in done:
                yield future.result()
    except BaseException:
        _stop(pool)
        raise
    finally:
        for name, value in threads.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
        pool.shutdown(wait=True, cancel_futures=True)


def _outcome(function: Callable[[Item], Result], index: int, item: Item) -> Outcome[Result]:
    try:
        return Outcome(index, function(item), None)
    except OstiformError as error:
        return Outcome(index, None, error)


def _start_worker() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle


def _stop(pool: ProcessPoolExecutor) -> None:
    """End the workers at once: what they had finished is on disk, the rest is done again."""
    for process in list((pool._processes or {}).values()):
        process.terminate()
