"""The report alone, from an output folder, where nothing that it was made from has changed."""

from pathlib import Path

from ostiform.execution import Workers
from ostiform.pipeline.build import Summary, build_study
from ostiform.pipeline.events import Event, Note, OnEvent
from ostiform.pipeline.folder import locked
from ostiform.pipeline.report import report_again
from ostiform.pipeline.report_record import changed_inputs, read_record
from ostiform.pipeline.store import Store

NAMED = 3
"""Files that are named where several have changed or are gone."""


def report_study(
    study_path: Path,
    output: Path,
    *,
    workers: int = 1,
    scheduler: str | None = None,
    on_event: OnEvent | None = None,
) -> Summary:
    """Write the report of an output folder, from what lies in it if that is still true.

    The study and its meshes may be gone; what is still there must be what the run has read, else
    everything that has changed is built again first.

    Parameters
    ----------
    study_path : Path
        The ``study.toml``, or where it was.
    output : Path
        Folder with the artifacts of a run.
    workers : int
        Processes of this machine.
    scheduler : str, optional
        As `build_study`, where something is built again.
    on_event : callable, optional
        Takes the events of the run.

    Raises
    ------
    OstiformError
        As `build_study`.
    """
    watch: OnEvent = on_event or _silent
    record = read_record(Store(output))
    if record is None:
        return build_study(study_path, output, workers=workers, scheduler=scheduler, on_event=watch)
    changed, gone = changed_inputs(record, study_path)
    if changed:
        watch(Note(f"changed since the last run: {_several(changed)}; building again"))
        return build_study(study_path, output, workers=workers, scheduler=scheduler, on_event=watch)
    if gone:
        watch(Note(f"gone since the last run: {_several(gone)}; the report shows that run"))
    with locked(output), Workers(workers) as pool:
        report_again(output, pool, watch)
    watch(Note(f"report: {output / 'report.html'}"))
    return Summary(output, record.entries, record.failures, dict(record.seconds))


def _several(paths: list[str]) -> str:
    more = f" and {len(paths) - NAMED} more" if len(paths) > NAMED else ""
    return f"{', '.join(paths[:NAMED])}{more}"


def _silent(_: Event) -> None:
    pass
