"""What every stage of a run shares, and how a shape is left out."""

import traceback
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

from ostiform.errors import ArtifactError, OstiformError
from ostiform.execution import Executor
from ostiform.pipeline.events import OnEvent, Progress, Warn
from ostiform.pipeline.store import Store
from ostiform.study import ShapeId, Study

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class Run:
    """A study, where its results go, and how the work is done.

    Attributes
    ----------
    study : Study
    store : Store
    workers : Executor
    on_event : callable
        Takes the events of the run.
    """

    study: Study
    store: Store
    workers: Executor
    on_event: OnEvent


@dataclass(frozen=True, slots=True)
class Ready:
    """A shape that a stage has finished.

    Attributes
    ----------
    id : ShapeId
    name : str
        Path segment of its artifacts.
    key : str
        Hash of everything its artifact was made from.
    """

    id: ShapeId
    name: str
    key: str


@dataclass(frozen=True, slots=True)
class Failure:
    """A shape left out of the model, and why."""

    id: ShapeId
    stage: str
    reason: str


def over_shapes(
    run: Run,
    stage: str,
    function: Callable[[Item], Result | None],
    items: Sequence[Item],
    ids: Sequence[ShapeId],
) -> tuple[list[Result | None], list[Failure]]:
    """Apply a stage's function to every shape, keeping failures apart, foreseen or not.

    Parameters
    ----------
    run : Run
    stage : str
        For progress and failures.
    function : callable
        Importable by name.
    items : sequence
        One per shape.
    ids : sequence of ShapeId

    Returns
    -------
    results : list
        In the order of the items; None for a shape that failed or gave none.
    failures : list of Failure

    Raises
    ------
    OstiformError
        The first failure, where the study says that one bad shape stops the run.
    ArtifactError
        If the output folder cannot be written or read: that is no shape's fault.
    """
    results: list[Result | None] = [None] * len(items)
    failures = []
    run.on_event(Progress(stage, 0, len(items)))
    for done, outcome in enumerate(run.workers.each(partial(_guarded, function), items), 1):
        shape = ids[outcome.index]
        if outcome.error is None:
            results[outcome.index] = outcome.value
        else:
            is_fault_of_folder = isinstance(outcome.error, ArtifactError)  # a full disk, say
            if is_fault_of_folder or run.study.settings.shapes.on_error == "stop":
                raise outcome.error
            reason = str(outcome.error)
            if str(shape) not in reason:
                reason = f"shape {shape}: {reason}"
            failures.append(Failure(shape, stage, reason))
            run.on_event(Warn(f"{shape} left out: {reason}"))
        run.on_event(Progress(stage, done, len(items), str(shape)))
    return results, sorted(failures, key=lambda failure: list(ids).index(failure.id))


def _guarded(function: Callable[[Item], Result | None], item: Item) -> Result | None:
    """Apply a function to one shape; whatever goes wrong is the failure of this shape only."""
    try:
        return function(item)
    except OstiformError:
        raise
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        failure = OstiformError(
            f"expected to use this shape, found an error that was not foreseen "
            f"({type(error).__name__}: {error}, in {place.name}, line {place.lineno}); leave the "
            "shape out or report the error together with its files"
        )
        failure.add_note(traceback.format_exc())
        raise failure from error


def survivors(ready: Iterable[Ready | None]) -> tuple[Ready, ...]:
    """Return the shapes that did not fail.

    Raises
    ------
    OstiformError
        If none is left.
    """
    kept = tuple(shape for shape in ready if shape is not None)
    if not kept:
        raise OstiformError(
            "expected at least 1 usable shape, found none; "
            "mend the shapes named above and run again"
        )
    return kept
