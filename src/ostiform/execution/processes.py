"""One function over many items in this process or in several, with the failures kept apart.

Workers hand back small values; whatever is large they write to disk themselves. A worker that
is killed, or crashes in compiled code, costs no more than the item it was at: what was under way
is done again, one item at a time, and an item that ends its worker every time counts as failed.

Workers end with the process that started them, however that one ends.
"""

import multiprocessing
import os
import signal
import threading
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from multiprocessing.connection import wait as wait_for_handles
from typing import TypeVar, TypeVarTuple

from ostiform.errors import OstiformError
from ostiform.execution.outcome import Outcome, Packed, outcome_of, packed, single_threaded

Item = TypeVar("Item")
Result = TypeVar("Result")
Shared = TypeVarTuple("Shared")

TRIES_ALONE = 3
"""Workers that an item may end while it is the only one under way, before it counts as failed."""

FRUITLESS_POOLS = 4
"""Pools that may break before the first item is finished; then no single item is to blame."""

THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(slots=True)
class Workers:
    """Processes that a run keeps for all its stages; with a count of 1, this process itself.

    A context manager: leaving it ends the processes, at once if an exception is under way. Inside
    it linear algebra has one thread, here as in the processes.
    """

    count: int
    _pool: ProcessPoolExecutor | None = None
    _limits: ExitStack = field(default_factory=ExitStack)

    def __enter__(self) -> "Workers":
        """Return this value; processes are started when first needed."""
        self._limits.enter_context(single_threaded())
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """End the processes."""
        if self._pool is not None and kind is not None:
            _terminate(self._pool)
        self._close()
        self._limits.close()

    def each(
        self,
        function: Callable[[Item, *Shared], Result],
        items: Sequence[Item],
        *shared: *Shared,
    ) -> Iterator[Outcome[Result]]:
        """Yield the outcome of ``function(item, *shared)`` of every item, as they finish.

        Parameters
        ----------
        function : callable
            Importable by name when there are several processes.
        items : sequence
            Picklable when there are several processes.
        *shared : object
            What all items need alike.

        Raises
        ------
        OstiformError
            If workers keep dying before any item is finished.
        """
        if self.count <= 1 or len(items) <= 1:
            for index, item in enumerate(items):
                yield outcome_of(function, index, item, shared)
            return
        common = packed(shared)
        together = dict(enumerate(items))
        alone: dict[int, Item] = {}
        ended_workers: Counter[int] = Counter()
        n_broken = n_finished = 0
        while together or alone:
            # One by one: what was under way when a worker ended.
            suspect = None if together else next(iter(alone))
            waiting = together if suspect is None else {suspect: alone.pop(suspect)}
            under_way: dict[int, Item] = {}
            try:
                for outcome in self._pooled(function, common, waiting, under_way):
                    n_finished += 1
                    yield outcome
            except BrokenProcessPool:
                self._close()
                n_broken += 1
                if n_finished == 0 and n_broken >= FRUITLESS_POOLS:
                    raise OstiformError(
                        f"expected worker processes to finish, found that they ended {n_broken} "
                        f"times with {len(items)} items open (out of memory, or a script that "
                        'starts them outside of `if __name__ == "__main__":`?); run again with '
                        "fewer workers"
                    ) from None
                if suspect is None:
                    alone.update(under_way)
                    continue
                ended_workers[suspect] += 1
                if ended_workers[suspect] < TRIES_ALONE:
                    alone.update(under_way)
                    continue
                yield Outcome(suspect, None, _killed())

    def _pooled(
        self,
        function: Callable[..., Result],
        common: Packed,
        waiting: dict[int, Item],
        under_way: dict[int, Item],
    ) -> Iterator[Outcome[Result]]:
        """Yield outcomes; items move from `waiting` to `under_way` and, finished, out of it."""
        pool = self._started()
        pending: set[Future[Outcome[Result]]] = set()
        while waiting or pending:
            while waiting and len(pending) < self.count:
                index = next(iter(waiting))
                under_way[index] = waiting.pop(index)
                task = pool.submit(outcome_of, function, index, under_way[index], common)
                pending.add(task)
            done, pending = wait(pending, return_when=FIRST_COMPLETED)
            for future in sorted(done, key=_is_broken):  # what was finished first counts
                outcome = future.result()
                del under_way[outcome.index]
                yield outcome

    def _started(self) -> ProcessPoolExecutor:
        if self._pool is None:
            self._pool = ProcessPoolExecutor(
                self.count,
                mp_context=multiprocessing.get_context("spawn"),
                initializer=_start_worker,
            )
            with _one_thread_each(), _deaf_to_interrupts():
                for _ in range(self.count):
                    self._pool.submit(os.getpid)  # each starts a process, up to the count
        return self._pool

    def _close(self) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)
            self._pool = None


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Give processes started in the block one thread each for linear algebra.

    The variables are read when a worker imports NumPy.
    """
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


def _is_broken(future: Future[Outcome[Result]]) -> bool:
    return isinstance(future.exception(), BrokenProcessPool)


def _killed() -> OstiformError:
    return OstiformError(
        f"expected its worker process to finish, found that it was killed {TRIES_ALONE} times "
        "(out of memory, or a crash in compiled code); look at its files, or run again where "
        "there is more memory"
    )


@contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """Let processes started in the block never see Ctrl-C: it is their parent's to handle."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _start_worker() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()


def _end_with(parent: int) -> None:
    """End this process when its parent has ended: nobody is left to work for."""
    wait_for_handles([parent])
    os._exit(1)


def _terminate(pool: ProcessPoolExecutor) -> None:
    """End the workers at once: what they had finished is on disk, the rest is done again."""
    for process in list((pool._processes or {}).values()):
        process.kill()
