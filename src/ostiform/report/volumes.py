"""What a report says about the volumes of the parts over the cycle."""

from collections.abc import Mapping, Sequence

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.evaluation import ClinicalTable, VolumeCurve, volume_curves
from ostiform.report.curves import volumes_figure
from ostiform.report.html import Picture, Section, Table
from ostiform.report.style import MM3_PER_ML
from ostiform.study import ShapeId

ROWS_SHOWN = 12


def volumes_section(table: ClinicalTable, surfaces: ClinicalTable | None = None) -> Section:
    """Return the volumes over the cycle with ejection fractions, or a table without phases.

    Parameters
    ----------
    table : ClinicalTable
        Of the shapes as sampled by the model.
    surfaces : ClinicalTable or None
        Of their meshes as read, where these are known: what sampling changes is told.
    """
    ids, volumes = table.ids, table.volumes
    curves = volume_curves(ids, volumes)
    text = (
        "Volumes of the shapes as sampled by the model, every opening capped flat; computed with "
        "the divergence theorem. The file volumes.csv holds all of them."
    )
    sampling = () if surfaces is None else (_sampling_table(table, surfaces),)
    if not curves:
        return Section("volumes", "Volumes", (text,), (), (_shape_table(ids, volumes), *sampling))
    return Section(
        "volumes",
        "Volumes over the cycle",
        (text,),
        (
            Picture(
                "volumes",
                volumes_figure(curves),
                "Volume of each part over the cycle, one line per subject; the first phase is "
                "repeated at the end of the cycle.",
                "Closed curves of volume against time, one panel per part.",
            ),
        ),
        (_curve_table(curves, table.columns), *sampling),
    )


def _curve_table(curves: Sequence[VolumeCurve], columns: Sequence[str]) -> Table:
    rows = [
        (
            curve.subject,
            curve.part,
            f"{curve.volumes[curve.largest] / MM3_PER_ML:.1f}",
            f"{curve.phases[curve.largest]} ({curve.times[curve.largest]:.2f})",
            f"{curve.volumes[curve.smallest] / MM3_PER_ML:.1f}",
            f"{curve.phases[curve.smallest]} ({curve.times[curve.smallest]:.2f})",
            f"{100 * curve.ejection_fraction:.0f} %"
            if f"{curve.part}_ejection_fraction_percent" in columns
            else "",  # a wall
        )
        for curve in curves
    ]
    return Table(
        "Ejection fractions, of the phases in the model: (largest \N{MINUS SIGN} smallest volume) "
        "/ largest volume",
        (
            "subject",
            "part",
            "largest volume (ml)",
            "at phase (time)",
            "smallest volume (ml)",
            "at phase (time)",
            "ejection fraction",
        ),
        tuple(rows),
        texts=(1,),
    )


def _shape_table(ids: Sequence[ShapeId], volumes: Mapping[str, FloatArray]) -> Table:
    stacked = np.stack(list(volumes.values()), axis=1) / MM3_PER_ML  # (N, parts)
    return Table(
        "Volumes of all shapes (ml)",
        ("shape", *volumes),
        tuple(
            (str(shape), *(f"{value:.1f}" for value in row))
            for shape, row in zip(ids, stacked, strict=True)
        ),
    )


def _sampling_table(table: ClinicalTable, surfaces: ClinicalTable) -> Table:
    """Means of the sizes that both tables have, over the shapes that both have."""
    place = {id: row for row, id in enumerate(table.ids)}
    rows = [row for row, id in enumerate(surfaces.ids) if id in place]
    sampled_rows = [place[surfaces.ids[row]] for row in rows]
    lines = []
    for column in surfaces.columns:
        if column in table.columns:
            sampled, own = table.column(column)[sampled_rows], surfaces.column(column)[rows]
            change = 100.0 * (sampled / own - 1.0)
            furthest = change[np.abs(change).argmax()]
            cells = (f"{value:z.1f}" for value in (sampled.mean(), own.mean()))
            changes = (
                f"{c:+z.1f}".replace("-", "\N{MINUS SIGN}") for c in (change.mean(), furthest)
            )
            lines.append((column, *cells, *changes))
    return Table(
        "Sizes as sampled by the model against those of the meshes as read (surfaces.csv)",
        ("size", "sampled, mean", "mesh, mean", "difference, mean (%)", "furthest (%)"),
        tuple(lines),
        rows_shown=ROWS_SHOWN,
    )
