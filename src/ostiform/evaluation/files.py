"""Evaluations and comparisons as JSON: mm, and mm^2 per point."""

from collections.abc import Sequence
from pathlib import Path

from ostiform.artifacts import load, save
from ostiform.atomic import atomically
from ostiform.evaluation.comparison import Comparison
from ostiform.evaluation.types import Evaluation


def write_evaluation(path: Path, evaluation: Evaluation) -> None:
    """Write an evaluation.

    Raises
    ------
    ArtifactError
        If the file cannot be written.
    """
    with atomically(path) as temporary:
        save(temporary, evaluation)


def read_evaluation(path: Path) -> Evaluation:
    """Read what `write_evaluation` wrote.

    Raises
    ------
    ArtifactError
        If the file is missing, damaged or of another kind or layout.
    """
    return load(path, Evaluation, "run `ostiform evaluate` again")


def write_comparisons(path: Path, comparisons: Sequence[Comparison]) -> None:
    """Write comparisons of a model with others.

    Raises
    ------
    ArtifactError
        If the file cannot be written.
    """
    with atomically(path) as temporary:
        save(temporary, tuple(comparisons), tuple[Comparison, ...])
