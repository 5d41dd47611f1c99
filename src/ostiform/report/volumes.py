"""What a report says about the volumes of the parts over the cycle."""

from collections.abc import Mapping, Sequence

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.evaluation import ClinicalTable, VolumeCurve, volume_curves
from ostiform.report.curves import volumes_figure
from ostiform.report.html import Picture, Section, Table
from ostiform.report.style import MM3_PER_ML
from ostiform.study import ShapeId


def volumes_section(table: ClinicalTable) -> Section:
    """Return the volumes over the cycle with ejection fractions, or a table without phases."""
    ids, volumes = table.ids, table.volumes
    curves = volume_curves(ids, volumes)
    text = (
        "Volumes of the shapes as sampled by the model, every opening capped flat; computed with "
        "the divergence theorem. The file volumes.csv holds all of them."
    )
    if not curves:
        return Section("volumes", "Volumes", (text,), (), (_shape_table(ids, volumes),))
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
        (_curve_table(curves, table.columns),),
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
