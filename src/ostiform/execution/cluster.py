"""One function over many items on a Dask cluster, whose workers see the same files.

Dask does again what a lost worker was at. What all items share is sent once and passed on between
the workers that need it.
"""

import importlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar, TypeVarTuple

from ostiform import __version__
from ostiform.errors import InputError, OstiformError
from ostiform.execution.outcome import Outcome, Packed, outcome_of, packed, single_threaded

Item = TypeVar("Item")
Result = TypeVar("Result")
Shared = TypeVarTuple("Shared")

ANSWER_SECONDS = 10
WORKER_SECONDS = 60

AHEAD = 3
"""Items handed out per thread of the cluster: the next ones wait where they will run."""

LARGE_GRAPH = "distributed.admin.large-graph-warning-threshold"
LARGEST_SHARED = "1 GiB"
"""Shared values that Dask sends along without warning that they are many."""


@dataclass(slots=True)
class ClusterWorkers:
    """The workers of a Dask scheduler.

    A context manager: entering it connects, leaving it disconnects; the cluster stays.

    Attributes
    ----------
    address : str
        Of the scheduler, ``tcp://HOST:PORT``.
    """

    address: str
    _client: Any = None
    _limits: ExitStack = field(default_factory=ExitStack)

    def __enter__(self) -> "ClusterWorkers":
        """Connect.

        Raises
        ------
        InputError
            If Dask is not installed, the scheduler does not answer or it has no workers.
        """
        self._client = _connected(self.address)
        self._limits.enter_context(single_threaded())
        return self

    def __exit__(self, *_: object) -> None:
        """Disconnect; what is under way is given up."""
        self._limits.close()
        self._client.close()

    @property
    def count(self) -> int:
        """Threads of the cluster at the moment."""
        threads: dict[str, int] = self._client.nthreads()
        return max(sum(threads.values()), 1)

    def check(self, folder: Path) -> None:
        """Make sure that the workers run this program and see the output folder.

        Parameters
        ----------
        folder : Path
            Absolute; it exists here.

        Raises
        ------
        InputError
            If a worker has another version of this program, none at all, or does not see the
            folder.
        """
        try:
            found: dict[str, tuple[str, bool]] = self._client.run(_seen, str(folder))
        except ImportError as error:
            raise InputError(
                f"Dask workers of {self.address}: expected Ostiform {__version__} in their "
                f"environment, found none ({error}); install it there"
            ) from error
        for worker, (version, is_seen) in found.items():
            if version != __version__:
                raise InputError(
                    f"Dask worker {worker}: expected Ostiform {__version__} as here, found "
                    f"{version}; install the same version on all machines"
                )
            if not is_seen:
                raise InputError(
                    f"Dask worker {worker}: expected to find the folder {folder} there too, found "
                    "none; put study and results on a file system that all machines share"
                )

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
            Importable by name on the workers.
        items : sequence
        *shared : object
            What all items need alike; it travels to each worker once.

        Raises
        ------
        OstiformError
            If the connection to the scheduler is lost.
        """
        if not items:
            return
        distributed = _distributed()
        laid_out = self._laid_out(packed(shared))
        waiting = list(range(len(items)))[::-1]
        index_of: dict[str, int] = {}
        under_way = distributed.as_completed()

        def hand_out() -> None:
            while waiting and len(index_of) < AHEAD * self.count:
                index = waiting.pop()
                future = self._client.submit(
                    outcome_of, function, index, items[index], laid_out, pure=False
                )
                index_of[future.key] = index
                under_way.add(future)

        hand_out()
        while index_of:
            future = next(under_way)
            index = index_of.pop(future.key)
            try:
                outcome: Outcome[Result] = future.result()
            except distributed.KilledWorker:
                outcome = Outcome(index, None, _killed())
            except (CancelledError, OSError) as error:
                raise self._lost(error) from error
            future.release()
            hand_out()
            yield outcome

    def _laid_out(self, content: Packed) -> Any:
        """Return the values as the result of a task, which Dask makes again where it is lost."""
        dask = importlib.import_module("dask")
        with dask.config.set({LARGE_GRAPH: LARGEST_SHARED}):
            return self._client.submit(_kept, content, pure=False)

    def _lost(self, error: BaseException) -> OstiformError:
        return OstiformError(
            f"Dask scheduler {self.address}: expected it and its workers to go on, found that they "
            f"were lost ({str(error)[:200] or type(error).__name__}); start them and run the same "
            "command again, what was finished is kept"
        )


def _distributed() -> Any:
    try:
        return importlib.import_module("distributed")
    except ImportError as error:
        raise InputError(
            "--scheduler: expected Dask to be installed, found no package distributed; install it "
            "with `pip install 'ostiform[dask]'`, or use --workers for processes of this machine"
        ) from error


def _connected(address: str) -> Any:
    distributed = _distributed()
    try:
        client = distributed.Client(address, timeout=ANSWER_SECONDS)
    except (OSError, ValueError) as error:
        raise InputError(
            f"--scheduler {address}: expected a Dask scheduler that answers within "
            f"{ANSWER_SECONDS} s, found none; start one (`dask scheduler`) or check the address"
        ) from error
    try:
        client.wait_for_workers(1, timeout=WORKER_SECONDS)
    except TimeoutError as error:
        client.close()
        raise InputError(
            f"--scheduler {address}: expected at least 1 worker within {WORKER_SECONDS} s, found "
            f"none; start some (`dask worker {address}`)"
        ) from error
    return client


def _kept(content: Packed) -> Packed:
    return content


def _seen(folder: str) -> tuple[str, bool]:
    return __version__, Path(folder).is_dir()


def _killed() -> OstiformError:
    return OstiformError(
        "expected its Dask worker to finish, found that several were killed at it (out of memory, "
        "or a crash in compiled code); look at its files, or give the workers more memory"
    )
