"""The demonstration population as a study on disk, written once."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ostiform.demo import write_demonstration
from ostiform.execution import Workers
from ostiform.pipeline.events import OnEvent, Progress
from ostiform.pipeline.store import Store, key_of


@dataclass(frozen=True, slots=True)
class _Spread:
    """A function of several values as a function of their tuple."""

    function: Callable[..., Any]

    def __call__(self, arguments: tuple[Any, ...]) -> Any:
        return self.function(*arguments)


def demonstration_study(
    folder: Path, subjects: int, shapes: int, seed: int, workers: int, on_event: OnEvent
) -> Path:
    """Write the demonstration population, unless it is there already, and return its study file.

    Parameters
    ----------
    folder : Path
    subjects, shapes, seed : int
        As `write_demonstration`.
    workers : int
        Processes.
    on_event : callable
        Takes the events of the run.
    """
    store = Store(folder)
    key = key_of("demonstration", subjects, shapes, seed)
    if not store.is_current("demonstration.json", key):
        with Workers(workers) as pool:

            def mapped(function: Callable[..., Any], *items: Iterable[Any]) -> Sequence[Any]:
                tasks = list(zip(*items, strict=True))
                results: list[Any] = [None] * len(tasks)
                for done, outcome in enumerate(pool.each(_Spread(function), tasks), start=1):
                    results[outcome.index] = outcome.result
                    on_event(Progress("generate", done, len(tasks)))
                return results

            write_demonstration(folder, subjects, shapes, seed, mapped=mapped)
        facts = {"subjects": subjects, "shapes": shapes, "seed": seed}
        store.write_json("demonstration.json", key, facts)
    return folder / "study.toml"
