"""What was measured about the models of a run, by the number of modes, as a CSV table."""

from collections.abc import Sequence
from pathlib import Path

from ostiform.evaluation.types import Evaluation
from ostiform.tables import write_table

COLUMNS = (
    "model",
    "modes",
    "cumulative_variance_mm2",
    "left_out_surface_mm",
    "left_out_point_mm",
    "specificity_surface_mm",
    "specificity_point_mm",
    "classical_compactness_mm2",
    "classical_generalisation_mm",
    "classical_generalisation_error_mm",
    "classical_specificity_mm",
    "classical_specificity_error_mm",
)


def evaluation_rows(evaluation: Evaluation) -> list[tuple[str | int | float | None, ...]]:
    """Return the rows of one model under `COLUMNS`; None where nothing was measured."""
    compactness, specificity = evaluation.compactness, evaluation.specificity
    found: dict[int, dict[str, float]] = {}

    def note(modes: Sequence[int], name: str, values: Sequence[float]) -> None:
        for count, value in zip(modes, values, strict=True):
            found.setdefault(int(count), {})[name] = float(value)

    n_modes = len(compactness.variances)
    note(range(1, n_modes + 1), "cumulative_variance_mm2", compactness.cumulative.tolist())
    left_out = evaluation.generalisation
    if left_out is not None:
        counts = left_out.mode_counts.tolist()
        note(counts, "left_out_surface_mm", left_out.surface_mean.mean(axis=0).tolist())
        note(counts, "left_out_point_mm", left_out.point.mean(axis=0).tolist())
    note(specificity.mode_counts.tolist(), "specificity_point_mm", specificity.mean.tolist())
    if evaluation.surface_specificity is not None:
        note([n_modes], "specificity_surface_mm", [evaluation.surface_specificity.mean])
    classical = evaluation.classical
    if classical is not None:
        counts = classical.mode_counts.tolist()
        for name in ("generalisation", "specificity"):
            note(counts, f"classical_{name}_mm", getattr(classical, name).tolist())
            note(counts, f"classical_{name}_error_mm", getattr(classical, f"{name}_error").tolist())
        note(counts, "classical_compactness_mm2", classical.compactness.tolist())
    return [
        (evaluation.kind, count, *(found[count].get(name) for name in COLUMNS[2:]))
        for count in sorted(found)
    ]


def write_evaluation_table(path: Path, evaluations: Sequence[Evaluation]) -> None:
    """Write the rows of several models; a cell is empty where nothing was measured.

    Raises
    ------
    ArtifactError
        If the file cannot be written.
    """
    rows = (row for evaluation in evaluations for row in evaluation_rows(evaluation))
    write_table(path, COLUMNS, rows)
