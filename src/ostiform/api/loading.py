"""Studies and models from files."""

from os import PathLike
from pathlib import Path

from ostiform import model, study
from ostiform.model import StoredModel
from ostiform.study import Study


def read_study(path: str | PathLike[str]) -> Study:
    """Read a study file and find the files of its shapes; no surface is read yet.

    Parameters
    ----------
    path : path
        The ``study.toml``.

    Returns
    -------
    study : Study
        Its `settings` and, for every shape, its `entries`: subject, phase, time and files.

    Raises
    ------
    InputError
        If the study file is wrong, no file matches, or a shape is given twice.
    """
    return study.read_study(Path(path))


def read_model(path: str | PathLike[str]) -> StoredModel:
    """Read a model file, written by Ostiform, statismo or scalismo.

    Parameters
    ----------
    path : path
        For example the ``model.h5`` of a results folder.

    Returns
    -------
    stored : StoredModel
        Its `model` (a `ShapeModel`), and where they are known the `ids` and `scores` of the
        training shapes.

    Raises
    ------
    ArtifactError
        If the file is missing, damaged or of another kind.
    """
    return model.read_model(Path(path))
