"""What becomes of an item, and what everything that works on items can do."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from multiprocessing.reduction import ForkingPickler
from typing import Any, Generic, Protocol, TypeVar, TypeVarTuple

from threadpoolctl import threadpool_limits

from ostiform.errors import OstiformError

Item = TypeVar("Item")
Result = TypeVar("Result")
Shared = TypeVarTuple("Shared")

READ_ONLY_KEPT = 5
"""The protocol that keeps read-only arrays so: compiled kernels tell them from others."""


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


class Executor(Protocol):
    """What works on the items of a run."""

    @property
    def count(self) -> int:
        """Items that are worked on at the same time."""

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
            Importable by name; it may run in another process, and again where one was killed.
        items : sequence
        *shared : object
            What all items need alike, handed over as few times as possible.

        Raises
        ------
        OstiformError
            If nothing is left to work on the items.
        """


@dataclass(frozen=True, slots=True)
class Packed:
    """Values on their way to another process, read back there once for every item."""

    content: bytes

    def values(self) -> tuple[Any, ...]:
        """Return the values."""
        loaded: tuple[Any, ...] = ForkingPickler.loads(self.content)
        return loaded


def packed(values: tuple[Any, ...]) -> Packed:
    """Pack values that travel between processes of one run, and nowhere else."""
    return Packed(bytes(ForkingPickler.dumps(values, READ_ONLY_KEPT)))


def outcome_of(
    function: Callable[..., Result], index: int, item: Any, shared: tuple[Any, ...] | Packed
) -> Outcome[Result]:
    """Return the outcome of one item: a foreseen failure is one, anything else is raised."""
    values = shared.values() if isinstance(shared, Packed) else shared
    try:
        return Outcome(index, function(item, *values), None)
    except OstiformError as error:
        return Outcome(index, None, error)


def single_threaded() -> AbstractContextManager[Any]:
    """Give linear algebra one thread while a block runs.

    Work is shared out over items by processes, and sums over threads would make results depend on
    their number.
    """
    limits: AbstractContextManager[Any] = threadpool_limits(1)
    return limits
