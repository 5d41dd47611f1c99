"""What the interactive viewer of a report shows, as JSON.

Every shape that the viewer can show is the mean plus a combination of the modes of one model, so
that the page carries the mean and these modes once, as 16-bit integers, and everything else as
coefficients: the modes between subjects and of the motion, the cycles, the training shapes.
"""

import base64
import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.evaluation import PointResidues
from ostiform.model import (
    DynamicModel,
    ShapeModel,
    StoredModel,
    SurfaceField,
    field_summary,
    mean_cycle,
    project,
    resampled_cycle,
    truncated,
)
from ostiform.report.cutaway import enclosed_parts
from ostiform.report.html import Picture, Section
from ostiform.report.point_pictures import PointColumn, points_figure
from ostiform.report.shading import VIEWS
from ostiform.report.style import PART_COLOURS
from ostiform.surface import split_ostium_name

SLIDERS = 6
FRAMES = 24
"""Shapes per cycle; the viewer interpolates between them."""

BUDGET = 3_000_000
"""Characters of the page that the modes may take; later modes are left out."""

CHARACTERS_PER_POINT = 8
"""Three coordinates of two bytes each, four characters for three bytes."""

LARGEST_INTEGER = 32767
SUBJECTS_WITH_CYCLES = 30
MOST_SHAPES = 200
"""Training shapes that the page carries; the viewer says where there are more."""

ERROR_QUANTILE = 0.99

FIELD_QUANTILES = (0.01, 0.99)
"""Of all values of a field: the ends of its scale."""

FIELDS_IN_A_ROW = 4

FIELD_BUDGET = 2_000_000
"""Characters of the page that the fields of training shapes may take."""

MISSING = -32768
"""The 16-bit integer of a point without a value."""


def viewer_section(
    stored: StoredModel,
    dynamic: DynamicModel | None,
    residues: PointResidues | None,
    fields: Sequence[SurfaceField] = (),
) -> Section:
    """Return the section with the interactive viewer.

    Parameters
    ----------
    stored : StoredModel
    dynamic : DynamicModel or None
        Of the same shapes; None where no subject has several phases.
    residues : PointResidues or None
        Of the same shapes, where some could be left out.
    fields : sequence of SurfaceField
        Of the same shapes.
    """
    cycles = "" if dynamic is None else " Play the cycle of the mean or of one subject."
    return Section(
        "viewer",
        "Explore the model",
        (
            "Drag to turn, scroll to zoom; with the keyboard: arrow keys, + and -, 0 for the first "
            f"view. Move the sliders to combine modes.{cycles}",
        ),
        (_points_picture(stored.model, dynamic, residues), *_field_pictures(stored.model, fields)),
        viewer=viewer_data(stored, dynamic, residues, fields),
        fallback="modes",
    )


def _points_picture(
    model: ShapeModel, dynamic: DynamicModel | None, residues: PointResidues | None
) -> Picture:
    spreads = {"sd, all shapes": point_spread(model)}
    if dynamic is not None:
        for title, level in (
            ("sd between subjects", dynamic.between),
            ("sd of the motion", dynamic.within),
        ):
            if len(level.modes):
                spreads[title] = point_spread(level)
    largest = max(float(values.max()) for values in spreads.values())
    columns = [PointColumn(title, values, largest) for title, values in spreads.items()]
    error = ""
    if residues is not None:
        top = float(np.quantile(residues.rms, ERROR_QUANTILE))
        columns.append(PointColumn("left-out error, RMS", residues.rms, top))
        error = (
            " The left-out error is the distance of a point from its reconstruction with "
            f"up to {residues.modes} modes of a model built without the shape, its correspondence "
            "kept; its scale ends at the 99th percentile."
        )
    return Picture(
        "points",
        points_figure(model, columns),
        "The mean shape from two sides, coloured by the standard deviation of its points"
        f"{' and by where the model errs' if error else ''}.{error}",
        "The mean shape in two rows, one column for each quantity of its points.",
        is_vector=False,
    )


def _field_pictures(model: ShapeModel, fields: Sequence[SurfaceField]) -> tuple[Picture, ...]:
    columns = []
    for field in fields:
        middle = field_summary(field).middle
        if not field.is_label and not np.isnan(middle).all():
            low, high = (float(end) for end in np.nanquantile(middle, FIELD_QUANTILES))
            columns.append(PointColumn(field.name, middle, high, low, field.units))
    return tuple(
        Picture(
            f"fields{number or ''}",
            points_figure(model, columns[first : first + FIELDS_IN_A_ROW]),
            "The mean shape from two sides, coloured by the mean of its fields over the shapes "
            "that have a value, from the 1st to the 99th percentile; grey where none has.",
            "The mean shape in two rows, one column for each field of the surface.",
            is_vector=False,
        )
        for number, first in enumerate(range(0, len(columns), FIELDS_IN_A_ROW))
    )


def point_spread(model: ShapeModel) -> FloatArray:
    """Return the standard deviation (P,) in mm of every point, from all modes of a model."""
    spread: FloatArray = np.sqrt(np.einsum("k,kpd->p", model.variances, model.modes**2))
    return spread


def viewer_data(
    stored: StoredModel,
    dynamic: DynamicModel | None,
    residues: PointResidues | None,
    fields: Sequence[SurfaceField] = (),
) -> str:
    """Return what the viewer shows, as JSON.

    Parameters
    ----------
    stored : StoredModel
    dynamic : DynamicModel or None
        Of the same shapes.
    residues : PointResidues or None
        Of the same shapes.
    fields : sequence of SurfaceField
        Of the same shapes.
    """
    full = stored.model
    count = min(len(full.modes), max(1, BUDGET // (CHARACTERS_PER_POINT * len(full.mean))))
    basis = truncated(full, count)
    deviations = np.sqrt(np.maximum(basis.variances, np.finfo(np.float64).tiny))
    mesh = basis.mesh
    enclosing = enclosed_parts(basis)
    # Parts one after the other, so that each is one run of triangles.
    order = np.argsort(mesh.face_part, kind="stable")
    data: dict[str, Any] = {
        "points": len(basis.mean),
        "mean": _quantised(basis.mean - basis.mean.mean(axis=0)),
        "basis": [_quantised(mode * sd) for mode, sd in zip(basis.modes, deviations, strict=True)],
        "deviations": _rounded(deviations),
        "faces": _indices(mesh.faces[order]),
        "parts": [
            {
                "name": name,
                "colour": PART_COLOURS[index % len(PART_COLOURS)],
                "faces": int((mesh.face_part == index).sum()),
                "encloses": index in enclosing,
            }
            for index, name in enumerate(mesh.parts)
        ],
        "openings": [
            {"part": mesh.parts.index(split_ostium_name(name)[0]), "loop": _indices(loop)}
            for name, loop in mesh.loops.items()
        ],
        "views": [_rounded(view.axes) for view in VIEWS],
        "sets": _mode_sets(basis, full.total_variance, dynamic),
        "shapes": [
            {"subject": id.subject, "phase": id.phase, "scores": _rounded(scores)}
            for id, scores in zip(
                stored.ids[:MOST_SHAPES],
                stored.scores[:MOST_SHAPES, :count] / deviations,
                strict=True,
            )
        ],
        "shape_count": len(stored.ids),
        "error": None if residues is None else _quantised(residues.rms),
        "fields": _fields(fields, len(full.mean)),
        "cycles": [] if dynamic is None else _cycles(basis, dynamic),
        "left_out_share": round(basis.residual_variance / full.total_variance, 6),
    }
    return json.dumps(data, ensure_ascii=False, allow_nan=False, separators=(",", ":"))


def _fields(fields: Sequence[SurfaceField], n_points: int) -> list[dict[str, Any]]:
    """Return the fields: the middle of the shapes, and the shapes' own as far as there is room."""
    room = FIELD_BUDGET // max(1, CHARACTERS_PER_POINT * n_points * len(fields) // 3)
    found = []
    for field in fields:
        summary, known = field_summary(field), field.values[~np.isnan(field.values)]
        if not len(known):
            continue
        own = [summary.middle, *field.values[: min(room, MOST_SHAPES)]]
        facts: dict[str, Any] = {"name": field.name, "title": field.title}
        if field.is_label:
            labels = np.unique(known)
            own = [np.where(np.isnan(v), np.nan, np.searchsorted(labels, v)) for v in own]
            facts["labels"] = [f"{label:g}" for label in labels]
            facts["colours"] = [PART_COLOURS[k % len(PART_COLOURS)] for k in range(len(labels))]
        else:
            facts["ends"] = _rounded(np.quantile(known, FIELD_QUANTILES))
        encoded = [_quantised(values, 1.0 if field.is_label else None) for values in own]
        found.append({**facts, "mean": encoded[0], "shapes": encoded[1:]})
    return found


def _mode_sets(
    basis: ShapeModel, total: float, dynamic: DynamicModel | None
) -> list[dict[str, Any]]:
    named = [("all shapes", basis, total)]
    if dynamic is not None:
        named += [
            (label, model, model.total_variance)
            for label, model in (
                ("between subjects", dynamic.between),
                ("motion within subjects", dynamic.within),
            )
            if len(model.modes)
        ]
    sets = []
    for label, model, variance in named:
        modes = [
            {
                "sd": round(float(np.sqrt(model.variances[k])), 4),
                "share": round(float(model.variances[k]) / variance, 6),
                "coefficients": _coefficients(
                    basis, basis.mean + np.sqrt(model.variances[k]) * model.modes[k]
                ),
            }
            for k in range(min(SLIDERS, len(model.modes)))
        ]
        sets.append(
            {
                "label": label,
                "mean": _coefficients(basis, model.mean),
                "modes": modes,
                "spread": _quantised(point_spread(model)),
            }
        )
    return sets


def _cycles(basis: ShapeModel, dynamic: DynamicModel) -> list[dict[str, Any]]:
    times = np.arange(FRAMES) / FRAMES
    several = [
        subject
        for subject in dynamic.subjects
        if sum(id.subject == subject for id in dynamic.ids) > 1
    ]
    named = [("mean cycle", mean_cycle(dynamic, times))]
    named += [
        (f"cycle of {subject}", resampled_cycle(dynamic, subject, times))
        for subject in several[:SUBJECTS_WITH_CYCLES]
    ]
    return [
        {"label": label, "frames": [_coefficients(basis, shape) for shape in shapes]}
        for label, shapes in named
    ]


def _coefficients(basis: ShapeModel, shape: FloatArray) -> list[float]:
    """Scores of a shape in standard deviations of the basis's modes."""
    deviations = np.sqrt(np.maximum(basis.variances, np.finfo(np.float64).tiny))
    scores: list[float] = _rounded(project(basis, shape) / deviations)
    return scores


def _rounded(values: FloatArray) -> Any:
    return np.round(np.asarray(values, dtype=np.float64), 5).tolist()


def _quantised(values: FloatArray, unit: float | None = None) -> dict[str, Any]:
    """Little-endian 16-bit integers and what one unit of them is; error at most half a unit."""
    gaps = np.isnan(values)
    largest = float(np.abs(values[~gaps]).max(initial=0.0))
    if unit is None:
        unit = largest / LARGEST_INTEGER if largest > 0.0 else 1.0
    integers = np.where(gaps, MISSING, np.round(np.where(gaps, 0.0, values) / unit)).astype("<i2")
    return {"unit": unit, "data": base64.b64encode(integers.tobytes()).decode("ascii")}


def _indices(values: np.ndarray) -> str:
    return base64.b64encode(values.astype("<u4").tobytes()).decode("ascii")
