"""All stages in order, each skipped where its inputs have not changed (design 1)."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from pathlib import Path
from typing import Any

from ostiform.errors import CollapseError
from ostiform.execution import ClusterWorkers, Workers
from ostiform.pipeline.correspond import Corresponded, correspond_shapes
from ostiform.pipeline.embed import Embedded, embed_shapes
from ostiform.pipeline.evaluate import evaluate_models
from ostiform.pipeline.events import Event, OnEvent, Warn
from ostiform.pipeline.folder import locked
from ostiform.pipeline.model import model_shapes
from ostiform.pipeline.prepare import Prepared, prepare_shapes
from ostiform.pipeline.record import record_run
from ostiform.pipeline.run import Failure, Run
from ostiform.pipeline.store import Store, key_of
from ostiform.study import Study, read_study


class Stage(IntEnum):
    """The stages, in order; running one runs those before it that are not current."""

    EMBED = 1
    CORRESPOND = 2
    MODEL = 3
    EVALUATE = 4
    REPORT = 5


@dataclass(frozen=True, slots=True)
class Summary:
    """What a run did.

    Attributes
    ----------
    output : Path
    shapes : int
        Shapes in the study.
    failures : tuple of Failure
        Shapes left out, with the reason.
    seconds : mapping of str to float
        Wall time of each stage that was run.
    """

    output: Path
    shapes: int
    failures: tuple[Failure, ...]
    seconds: dict[str, float]

    def as_json(self) -> dict[str, Any]:
        """Return the summary as plain values."""
        return {
            "output": str(self.output),
            "shapes": self.shapes,
            "used": self.shapes - len(self.failures),
            "failed": _failure_facts(self.failures),
            "seconds": {stage: round(value, 2) for stage, value in self.seconds.items()},
        }


def build_study(
    study: Study | Path,
    output: Path,
    *,
    until: Stage = Stage.REPORT,
    workers: int = 1,
    scheduler: str | None = None,
    on_event: OnEvent | None = None,
) -> Summary:
    """Build the model of a study, or the part of it up to a stage.

    What is already in the output folder and still true is used; the rest is made again.

    Parameters
    ----------
    study : Study or Path
        The study, or its ``study.toml``.
    output : Path
        Folder for the artifacts; made if missing.
    until : Stage
        The last stage to run.
    workers : int
        Processes of this machine.
    scheduler : str, optional
        Address of a Dask scheduler, whose workers do the work instead. They must see the study
        and the output folder under the same paths.
    on_event : callable, optional
        Takes the events of the run.

    Raises
    ------
    OstiformError
        If the study is wrong, too few shapes can be used, an artifact cannot be written, or,
        after everything is written, if an optimised model has collapsed (`CollapseError`).
    """
    heard: list[str] = []

    def watch(event: Event) -> None:
        if isinstance(event, Warn):
            heard.append(event.text)
        if on_event is not None:
            on_event(event)

    if scheduler is None:
        read = study if isinstance(study, Study) else read_study(study)
        with locked(output), Workers(workers) as pool:
            return _staged(Run(read, Store(output), pool, watch), until, heard)
    read = _findable(study if isinstance(study, Study) else read_study(study.absolute()))
    root = output.absolute()
    with ClusterWorkers(scheduler) as cluster, locked(root):
        cluster.check(root)
        return _staged(Run(read, Store(root), cluster, watch), until, heard)


def _findable(study: Study) -> Study:
    """Return a study whose files are found from any folder of any machine."""
    entries = tuple(
        replace(
            entry,
            files={part: path.absolute() for part, path in entry.files.items()},
            cuts=tuple(cut.absolute() for cut in entry.cuts),
        )
        for entry in study.entries
    )
    return replace(
        study, path=study.path.absolute(), folder=study.folder.absolute(), entries=entries
    )


def _staged(run: Run, until: Stage, heard: Sequence[str]) -> Summary:
    clock = _Clock({})
    failures: list[Failure] = []
    collapsed: tuple[str, ...] = ()
    try:
        prepared: Prepared = clock.timed("prepare", lambda: prepare_shapes(run))
        failures += prepared.failures
        embedded: Embedded = clock.timed("embed", lambda: embed_shapes(run, prepared))
        failures += embedded.failures
    finally:
        _write_failures(run, failures)
    if until >= Stage.CORRESPOND:
        corresponded: Corresponded = clock.timed(
            "correspond", lambda: correspond_shapes(run, prepared, embedded)
        )
    if until >= Stage.MODEL:
        clock.timed("model", lambda: model_shapes(run, prepared, embedded, corresponded))
    if until >= Stage.EVALUATE:
        collapsed = clock.timed(
            "evaluate", lambda: evaluate_models(run, prepared, embedded, corresponded)
        )
        record_run(run, prepared, embedded, corresponded, failures, clock.seconds, heard)
    if until >= Stage.REPORT:
        from ostiform.pipeline.report import write_report  # slow to import, and needed here only

        clock.timed("report", lambda: write_report(run.store, run.workers, run.on_event))
    if collapsed and run.study.settings.evaluation.collapse == "stop":
        raise CollapseError(
            f"{run.store.root}: {'; '.join(collapsed)}; everything is written there: look at the "
            'report, raise "coherence" of [correspondence] or take the conformal model, or accept '
            'this one with collapse = "warn" in [evaluation]'
        )
    return Summary(run.store.root, len(run.study.entries), tuple(failures), clock.seconds)


@dataclass(frozen=True, slots=True)
class _Clock:
    seconds: dict[str, float]

    def timed(self, stage: str, work: Callable[[], Any]) -> Any:
        start = time.monotonic()
        result = work()
        self.seconds[stage] = time.monotonic() - start
        return result


def _write_failures(run: Run, failures: Sequence[Failure]) -> None:
    run.store.write_json("failed.json", key_of("failures"), _failure_facts(failures))


def _failure_facts(failures: Sequence[Failure]) -> list[dict[str, str]]:
    return [
        {"subject": f.id.subject, "phase": f.id.phase, "stage": f.stage, "reason": f.reason}
        for f in failures
    ]
