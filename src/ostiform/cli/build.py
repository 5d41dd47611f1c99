"""``ostiform build`` and one command per stage."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from ostiform import pipeline
from ostiform.cli.options import DEFAULTS, Common, Output, Scheduler, StudyPath
from ostiform.cli.running import run_command, show_summary, worker_count


def build(
    study: StudyPath,
    output: Output = Path("out"),
    *,
    scheduler: Scheduler = None,
    common: Common = DEFAULTS,
) -> int:
    """Build the shape model of a study, with its evidence and report.

    All stages are run: embed, correspond, model, evaluate, report. Whatever is already in the
    output folder and still true is kept, so a run that was interrupted goes on where it was.
    """
    return _until(pipeline.Stage.REPORT, study, output, scheduler, common)


def embed(
    study: StudyPath,
    output: Output = Path("out"),
    *,
    scheduler: Scheduler = None,
    common: Common = DEFAULTS,
) -> int:
    """Read the shapes and map each to the base domain, with a certificate against folds."""
    return _until(pipeline.Stage.EMBED, study, output, scheduler, common)


def correspond(
    study: StudyPath,
    output: Output = Path("out"),
    *,
    scheduler: Scheduler = None,
    common: Common = DEFAULTS,
) -> int:
    """Bring the shapes into correspondence (and run the stages before, where needed)."""
    return _until(pipeline.Stage.CORRESPOND, study, output, scheduler, common)


def model(
    study: StudyPath,
    output: Output = Path("out"),
    *,
    scheduler: Scheduler = None,
    common: Common = DEFAULTS,
) -> int:
    """Fit the shape models and write their meshes (and run the stages before, where needed)."""
    return _until(pipeline.Stage.MODEL, study, output, scheduler, common)


def evaluate(
    study: StudyPath,
    output: Output = Path("out"),
    *,
    scheduler: Scheduler = None,
    common: Common = DEFAULTS,
) -> int:
    """Measure how good the models are (and run the stages before, where needed)."""
    return _until(pipeline.Stage.EVALUATE, study, output, scheduler, common)


def report(
    source: Annotated[Path, Parameter(help="A folder of results, or the study of its run.")],
    output: Annotated[
        Path | None,
        Parameter(name=["--output", "-o"], help="The folder of results, where a study is given."),
    ] = None,
    *,
    scheduler: Scheduler = None,
    common: Common = DEFAULTS,
) -> int:
    """Write the report again, from a folder of results alone.

    The study and its meshes may be gone, and the folder may be a copy. Where a study is given
    (then the folder is `out` unless said otherwise) and it or a mesh has changed, or no run has
    been finished, the stages before are run first.
    """
    folder = Path("out") if output is None and not source.is_dir() else output
    return run_command(
        common,
        lambda on_event: show_summary(
            common,
            pipeline.report_results(
                source,
                folder,
                workers=worker_count(common),
                scheduler=scheduler,
                on_event=on_event,
            ),
        ),
    )


def _until(
    stage: pipeline.Stage, study: Path, output: Path, scheduler: str | None, common: Common
) -> int:
    return run_command(
        common,
        lambda on_event: show_summary(
            common,
            pipeline.build_study(
                study,
                output,
                until=stage,
                workers=worker_count(common),
                scheduler=scheduler,
                on_event=on_event,
            ),
        ),
    )
