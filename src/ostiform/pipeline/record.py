"""What is said about a run beyond its other artifacts: ``run.json``.

With it the report can be made when the study and its meshes are elsewhere.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ostiform import __version__
from ostiform.artifacts import from_json, to_json
from ostiform.errors import ArtifactError
from ostiform.pipeline.correspond import Corresponded
from ostiform.pipeline.embed import Embedded
from ostiform.pipeline.prepare import Prepared
from ostiform.pipeline.run import Failure, Ready, Run
from ostiform.pipeline.store import Store, file_hash, key_of
from ostiform.study import Study

RECORD = "run.json"
SCHEMA = 1


@dataclass(frozen=True, slots=True)
class InputFile:
    """A file that a run has read.

    Attributes
    ----------
    shape : str
        The shape it belongs to.
    role : str
        The part it holds, or ``"cuts"``.
    path : str
        As the study names it, below the folder of the study where it lies there.
    sha256 : str
    """

    shape: str
    role: str
    path: str
    sha256: str


@dataclass(frozen=True, slots=True)
class RunRecord:
    """What was run.

    Attributes
    ----------
    version : str
        Of this program, when the model was built.
    title : str
        Of the study.
    study : str
        Path of the study file when it was run.
    study_sha256 : str
    settings : mapping of str to any
        All settings, as plain values.
    entries : int
        Shapes of the study.
    shapes : tuple of Ready
        The shapes in the model.
    failures : tuple of Failure
    repairs : mapping of str to tuple of str
        What was changed on reading, by artifact name.
    warnings : tuple of str
    seconds : mapping of str to float
        Wall time of each stage, the last time that it did its work.
    files : tuple of InputFile
    domain_key, correspondence_key : str
        Hashes of what the base domain and the correspondence were made from.
    """

    version: str
    title: str
    study: str
    study_sha256: str
    settings: Mapping[str, Any]
    entries: int
    shapes: tuple[Ready, ...]
    failures: tuple[Failure, ...]
    repairs: Mapping[str, tuple[str, ...]]
    warnings: tuple[str, ...]
    seconds: Mapping[str, float]
    files: tuple[InputFile, ...]
    domain_key: str
    correspondence_key: str

    @property
    def part_names(self) -> tuple[str, ...]:
        """The parts in study order."""
        return tuple(self.settings["parts"])


def record_run(
    run: Run,
    prepared: Prepared,
    embedded: Embedded,
    corresponded: Corresponded,
    failures: Sequence[Failure],
    seconds: Mapping[str, float],
    warnings: Sequence[str],
) -> None:
    """Write what was run, with what an earlier run did of it and said.

    Parameters
    ----------
    run : Run
    prepared, embedded, corresponded : Prepared, Embedded, Corresponded
        What the stages have left.
    failures : sequence of Failure
    seconds : mapping of str to float
        Wall time of the stages of this run.
    warnings : sequence of str
        What the stages of this run have warned of.
    """
    study = run.study
    left_out = {f"{failure.id} left out: {failure.reason}" for failure in failures}
    record = RunRecord(
        version=__version__,
        title=study.settings.report.title or study.path.resolve().parent.name or "study",
        study=str(study.path),
        study_sha256=file_hash(study.path),
        settings=study.settings.model_dump(mode="json", by_alias=True),
        entries=len(study.entries),
        shapes=embedded.ready,
        failures=tuple(failures),
        repairs=prepared.repairs,
        warnings=tuple(text for text in warnings if text not in left_out),
        seconds=dict(seconds),
        files=_inputs(study),
        domain_key=prepared.domain_key,
        correspondence_key=corresponded.key,
    )
    write_record(run.store, after(read_record(run.store), record))


def _inputs(study: Study) -> tuple[InputFile, ...]:
    """Return the files that the shapes of a study are read from, with their hashes.

    Files that are missing are left out: the reason is among the failures of the run.
    """
    folder = study.path.parent
    found = []
    for entry in study.entries:
        paths = dict(entry.files) | {f"cuts {k}": cut for k, cut in enumerate(entry.cuts)}
        found += [
            InputFile(str(entry.id), role, _below(path, folder), file_hash(path))
            for role, path in paths.items()
            if path.is_file()
        ]
    return tuple(found)


def write_record(store: Store, record: RunRecord) -> None:
    """Write the record of a run."""
    facts = {"schema": SCHEMA, **to_json(record)}
    store.write_json(RECORD, key_of("run", record.correspondence_key), facts)


def read_record(store: Store) -> RunRecord | None:
    """Return the record of the run that filled a folder; None where no run has got so far.

    Raises
    ------
    ArtifactError
        If the record is damaged or of another schema.
    """
    if not store.path(RECORD).is_file():
        return None
    facts = store.read_json(RECORD)
    try:
        if facts.pop("schema") != SCHEMA:
            raise ValueError("another schema")
        return from_json(facts, RunRecord)
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise ArtifactError(
            f"{store.path(RECORD)}: expected the record of a run of Ostiform {__version__}, found "
            f"{error!r}; run `ostiform build` on this output folder"
        ) from error


def changed_inputs(record: RunRecord, study_path: Path) -> tuple[list[str], list[str]]:
    """Return the input files of a run that are no longer the same, and those that are gone.

    Parameters
    ----------
    record : RunRecord
    study_path : Path
        Where the study file is, or was.
    """
    stated = [(study_path, record.study_sha256)]
    stated += [(study_path.parent / file.path, file.sha256) for file in record.files]
    changed = [str(path) for path, sha256 in stated if path.is_file() and file_hash(path) != sha256]
    return changed, [str(path) for path, _ in stated if not path.is_file()]


def after(earlier: RunRecord | None, now: RunRecord) -> RunRecord:
    """Return the record of a run that found some of its work done by an earlier run.

    What the earlier run did and said still holds for what was found done: the times of its
    stages, its warnings, and its repairs of the shapes that were not read again.
    """
    if earlier is None:
        return now
    keys = {shape.name: shape.key for shape in earlier.shapes}
    kept = {
        shape.name: earlier.repairs[shape.name]
        for shape in now.shapes
        if shape.name in earlier.repairs and keys.get(shape.name) == shape.key
    }
    same = earlier.correspondence_key == now.correspondence_key
    seconds = dict(now.seconds)
    if same:
        seconds = {
            stage: max(earlier.seconds.get(stage, 0.0), now.seconds.get(stage, 0.0))
            for stage in {**earlier.seconds, **now.seconds}
        }
    return replace(
        now,
        repairs={**kept, **now.repairs},
        warnings=tuple(dict.fromkeys((*(earlier.warnings if same else ()), *now.warnings))),
        seconds=seconds,
    )


def _below(path: Path, folder: Path) -> str:
    try:
        return path.resolve().relative_to(folder.resolve()).as_posix()
    except ValueError:
        return str(path.resolve())
