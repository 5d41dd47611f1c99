"""The further columns of a study's sheet, kept beside its results.

Artifact: ``covariates.csv``, one row per shape of the model: subject, phase, and the columns.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

from ostiform.errors import ArtifactError, InputError
from ostiform.model import StoredModel
from ostiform.pipeline.store import Store, key_of
from ostiform.study import ShapeId, read_sheet
from ostiform.tables import write_table

COVARIATES = "covariates.csv"

Rows = list[tuple[str, Mapping[str, str]]]


def write_covariates(
    store: Store, ids: Sequence[ShapeId], covariates: Sequence[Mapping[str, str]]
) -> None:
    """Write what is known of every shape beyond its files, if anything."""
    columns = list(dict.fromkeys(name for cells in covariates for name in cells))
    if not columns:
        store.remove(COVARIATES)
        return
    rows = [
        [id.subject, id.phase, *(cells.get(name, "") for name in columns)]
        for id, cells in zip(ids, covariates, strict=True)
    ]
    key = key_of("covariates", columns, rows)
    if store.is_current(COVARIATES, key):
        return
    with store.writing(COVARIATES, key) as path:
        write_table(path, ["subject", "phase", *columns], rows)


def read_covariates(
    results: Path, sheet: Path | None, stored: StoredModel, phase: str | None
) -> Rows:
    """Return what is known about the subjects of a model: (subject, cells) per row.

    Parameters
    ----------
    results : Path
        A folder of results.
    sheet : Path or None
        A CSV or XLSX file with a column ``subject``, and ``phase`` where rows differ by it; the
        columns kept with the results if absent.
    stored : StoredModel
    phase : str or None
        Rows of other phases are left out, where the sheet says the phase.

    Raises
    ------
    InputError
        If the sheet is wrong or says nothing about any subject of the model.
    ArtifactError
        If there is no sheet and the results hold none.
    """
    path = results / COVARIATES if sheet is None else sheet
    if sheet is None and not path.is_file():
        raise ArtifactError(
            f"{path}: expected the further columns of the study's sheet, found no such file; add "
            "columns to the sheet and run `ostiform build` again, or name a sheet with --sheet"
        )
    rows = read_sheet(path, ())
    phases = {id.phase for id in stored.ids}
    says_phase = any(row.phase in phases for row in rows) and len({r.phase for r in rows}) > 1
    subjects = {id.subject for id in stored.ids}
    found: Rows = [
        (row.subject, row.covariates)
        for row in rows
        if row.subject in subjects and (phase is None or not says_phase or row.phase == phase)
    ]
    if not found:
        raise InputError(
            f"{path}: expected rows of the model's subjects ({', '.join(sorted(subjects)[:3])}, "
            f"...), found {', '.join(sorted({row.subject for row in rows})[:3]) or 'no rows'}"
        )
    return found
