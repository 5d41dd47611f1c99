"""A results folder as a value, and how one is made."""

import json
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

from ostiform.correspondence import KINDS, Correspondence, Kind, Warp
from ostiform.errors import ArtifactError, InputError
from ostiform.evaluation import Evaluation, read_evaluation
from ostiform.model import (
    ShapeModel,
    StoredModel,
    SurfaceField,
    read_correspondence,
    read_model,
    read_warp,
)
from ostiform.pipeline import Event, OnEvent, Stage, Store, Summary, build_study, read_fields
from ostiform.study import ShapeId, Study


@dataclass(frozen=True, slots=True)
class Results:
    """The folder that a build has left; its files are read when asked for, each time anew.

    Attributes
    ----------
    folder : Path
    summary : Summary or None
        What the run did: shapes left out, seconds of each stage; None where the folder was only
        read.
    """

    folder: Path
    summary: Summary | None = None

    @property
    def report(self) -> Path:
        """Path of the report, to be opened in a browser."""
        return self.folder / "report.html"

    @property
    def model_path(self) -> Path:
        """Path of the model file, readable by statismo and scalismo too."""
        return self.folder / "model.h5"

    @property
    def model(self) -> ShapeModel:
        """The optimal model."""
        return self.stored().model

    @property
    def correspondence(self) -> Correspondence:
        """The shapes in correspondence, as the optimal model has them."""
        return self.corresponded()

    @property
    def evaluation(self) -> Evaluation:
        """The evidence about the optimal model."""
        return self.evaluated()

    @property
    def fields(self) -> tuple[SurfaceField, ...]:
        """The fields of the study at the corresponding points of every shape."""
        return read_fields(Store(self.folder))

    @property
    def left_out(self) -> dict[str, str]:
        """The reason for every shape that was left out, by ``SUBJECT/PHASE``."""
        path = self.folder / "failed.json"
        try:
            facts = json.loads(path.read_text(encoding="utf-8"))
            return {
                str(ShapeId(item["subject"], item["phase"], 0.0)): item["reason"] for item in facts
            }
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise ArtifactError(
                f"{path}: expected the list of shapes left out, found a missing or damaged file "
                f"({error}); build the study again"
            ) from error

    def stored(self, kind: Kind = "optimal") -> StoredModel:
        """Read one of the three models with the scores and names of its training shapes.

        Parameters
        ----------
        kind : {"optimal", "conformal", "euclidean"}

        Raises
        ------
        InputError
            If there is no such kind of model.
        ArtifactError
            If the folder does not hold it.
        """
        return read_model(self._path(kind, "model.h5"))

    def corresponded(self, kind: Kind = "optimal") -> Correspondence:
        """Read the shapes in correspondence; parameters and errors as `stored`."""
        return read_correspondence(self._path(kind, "correspondence.h5"))

    def evaluated(self, kind: Kind = "optimal") -> Evaluation:
        """Read the evidence about one of the three models; parameters and errors as `stored`."""
        return read_evaluation(self._path(kind, "evaluation.json"))

    def warp(self, shape: ShapeId | str) -> Warp:
        """Read the warp of a shape in the optimal model: where points of the domain go on it.

        ``results.warp("anna/0")(directions, sphere)`` carries any directions (n, 3), unit vectors,
        of a component sphere; those of the template come to the directions of the
        correspondence.

        Parameters
        ----------
        shape : ShapeId or str
            ``SUBJECT/PHASE``.

        Raises
        ------
        ArtifactError
            If the folder does not hold it, or has no such shape.
        """
        return read_warp(self.folder / "warps.h5", shape)

    def _path(self, kind: Kind, name: str) -> Path:
        if kind not in KINDS:
            raise InputError(f'kind of model: expected one of {", ".join(KINDS)}, found "{kind}"')
        return self.folder / kind / name


def build(
    study: Study | str | PathLike[str],
    output: str | PathLike[str],
    *,
    until: Stage = Stage.REPORT,
    workers: int = 1,
    scheduler: str | None = None,
    on_event: OnEvent | None = None,
) -> Results:
    """Build the model of a study, with its evidence and report.

    What is already in the output folder and still true is used; the rest is made again.

    Parameters
    ----------
    study : Study or path
        As `read_study` returns it, perhaps with other settings (`dataclasses.replace`), or the
        path of a ``study.toml``.
    output : path
        Folder for the results; made if missing.
    until : Stage
        The last stage to run.
    workers : int
        Processes; in a script more than one needs the usual ``if __name__ == "__main__":``.
    scheduler : str, optional
        Address of a Dask scheduler, whose workers do the work instead; see :doc:`/scale`.
    on_event : callable, optional
        Takes the events of the run, see `ostiform.pipeline.Event`; nothing is printed.

    Returns
    -------
    results : Results

    Raises
    ------
    OstiformError
        If the study is wrong, too few shapes can be used, or an artifact cannot be written.
    """
    watch = on_event or _silent
    source = study if isinstance(study, Study) else Path(study)
    summary = build_study(
        source, Path(output), until=until, workers=workers, scheduler=scheduler, on_event=watch
    )
    return Results(summary.output, summary)


def read_results(folder: str | PathLike[str]) -> Results:
    """Return the results that a build has left in a folder.

    Raises
    ------
    ArtifactError
        If the folder holds no model.
    """
    results = Results(Path(folder))
    if not results.model_path.is_file():
        raise ArtifactError(
            f"{results.folder}: expected a results folder with a model.h5, found none there; "
            "build the study first (`ostiform build study.toml -o FOLDER`)"
        )
    return results


def _silent(_: Event) -> None:
    pass
