"""Group differences and regressions of a finished model, with maps and a page of their own.

What is tested is shape, or a field of the surface. Files of a test: ``summary.json``,
``points.csv``, ``effect.vtp``, the fitted shapes ``fitted_VALUE.vtp``, ``report.html`` and its
figures in ``figures/``.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from math import factorial, prod
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from ostiform import __version__
from ostiform.arrays import FloatArray
from ostiform.atomic import atomically
from ostiform.errors import InputError
from ostiform.model import ShapeModel, field_named, read_model
from ostiform.pipeline.carried_fields import read_fields
from ostiform.pipeline.covariates import read_covariates
from ostiform.pipeline.store import Store
from ostiform.report import FOUND_LEVEL, draw_picture, effect_page, render_page, save_drawing
from ostiform.statistics import (
    Covariate,
    EffectSettings,
    FieldEffect,
    ShapeEffect,
    SubjectField,
    SubjectShapes,
    complete_subjects,
    covariate_of,
    field_effect,
    shape_effect,
    subject_field,
    subject_shapes,
    subject_values,
)
from ostiform.surface import write_surface
from ostiform.tables import write_table

SCHEMA = 1
LOW_AND_HIGH = (5.0, 95.0)
"""Percentiles of a continuous covariate whose fitted shapes are written."""


@dataclass(frozen=True, slots=True)
class Question:
    """What is asked of a model.

    Attributes
    ----------
    covariate : str
        A column of the sheet.
    adjusted : tuple of str
        Columns whose influence is removed.
    categorical : tuple of str
        Columns of numbers that are categories.
    phase : str or None
        The phase that stands for a subject; its mean over the cycle if None.
    settings : EffectSettings
    field : str or None
        The field of the surface that is tested; shape if None.
    """

    covariate: str
    adjusted: tuple[str, ...] = ()
    categorical: tuple[str, ...] = ()
    phase: str | None = None
    settings: EffectSettings = EffectSettings()
    field: str | None = None

    def __post_init__(self) -> None:
        """Check the columns, and what is tested."""
        if self.field is not None and self.settings.movement != "any":
            raise InputError(
                f"a test of the field {self.field}: expected no movement, found "
                f"{self.settings.movement}: a field has no direction"
            )
        named = (self.covariate, *self.adjusted)
        if len(set(named)) < len(named):
            raise InputError(
                f"a test of shape: expected different columns, found {', '.join(named)}"
            )


@dataclass(frozen=True, slots=True, eq=False)
class EffectResult:
    """The answer.

    Attributes
    ----------
    effect : ShapeEffect or FieldEffect
    subjects : tuple of str
        Those used.
    left_out : dict of str to str
        The others, and why.
    what : str
        What stands for a subject.
    warnings : tuple of str
    folder : Path
    """

    effect: ShapeEffect | FieldEffect
    subjects: tuple[str, ...]
    left_out: dict[str, str]
    what: str
    warnings: tuple[str, ...]
    folder: Path

    @property
    def name(self) -> str:
        """What was asked: the covariate, or a field by it."""
        named = self.effect.covariate.name
        return named if isinstance(self.effect, ShapeEffect) else f"{self.effect.name} by {named}"

    def as_json(self) -> dict[str, Any]:
        """Return the answer as plain values."""
        effect, whole, points = self.effect, self.effect.whole, self.effect.points
        covariate = effect.covariate
        return {
            "schema": SCHEMA,
            "package_version": __version__,
            "covariate": covariate.name,
            "type": "categorical" if covariate.is_categorical else "continuous",
            "categories": {
                level: int((covariate.values == number).sum())
                for number, level in enumerate(covariate.levels)
            },
            "adjusted": list(effect.design.adjusted),
            "subjects": list(self.subjects),
            "left_out": self.left_out,
            "stands_for_a_subject": self.what,
            **({} if isinstance(effect, ShapeEffect) else {"field": effect.name}),
            "whole_shape": {
                "t2": whole.statistic,
                "p_value": whole.p_value,
                "permutations": len(whole.null),
                "modes": whole.n_modes,
                "variance_share": whole.variance_share,
                "shrinkage": whole.shrinkage,
                "explained": whole.explained,
                "degrees_of_freedom": effect.design.degrees,
            },
            "points": {
                "number": len(points.q_value),
                "found_q_0.05": int((points.q_value <= FOUND_LEVEL).sum()),
                "found_family_0.05": int((points.family_p_value <= FOUND_LEVEL).sum()),
                "smallest_q": float(points.q_value.min()),
            },
            "effects": _effects(effect),
            "warnings": list(self.warnings),
        }  # fmt: skip


def _effects(effect: ShapeEffect | FieldEffect) -> list[dict[str, Any]]:
    """Return how large the effect of every column of the design is."""
    if isinstance(effect, FieldEffect):
        return [
            {"name": name, "units": effect.units, "change": [float(c.min()), float(c.max())]}
            for name, c in zip(effect.design.names, effect.coefficients, strict=True)
        ]
    return [
        {
            "name": name,
            "largest_mm": float(np.linalg.norm(coefficient, axis=1).max()),
            "outward_mm": [float(normal.min()), float(normal.max())],
        }
        for name, coefficient, normal in zip(
            effect.design.names, effect.coefficients, effect.normal_coefficients, strict=True
        )
    ]


def shape_question(
    results: Path, question: Question, folder: Path, sheet: Path | None = None
) -> EffectResult:
    """Test whether and where shape, or a field, depends on a column of the sheet.

    Parameters
    ----------
    results : Path
        A folder of results.
    question : Question
    folder : Path
        For the files of the answer; made if missing.
    sheet : Path, optional
        Instead of the columns kept with the results (see `read_covariates`).

    Raises
    ------
    InputError
        If a column or field is missing or cannot be used, or there are too few subjects.
    ArtifactError
        If the results hold no model or no columns, or a file cannot be written.
    """
    stored = read_model(results / "model.h5")
    units: SubjectShapes | SubjectField
    if question.field is None:
        units = subject_shapes(stored, question.phase)
    else:
        field = field_named(read_fields(Store(results)), question.field)
        units = subject_field(stored.ids, field, question.phase)
    rows = read_covariates(results, sheet, stored, question.phase)
    names = (question.covariate, *question.adjusted)
    columns = {name: subject_values(rows, name) for name in names}
    subjects, left_out = complete_subjects(units.subjects, columns)
    covariates = [
        covariate_of(
            name,
            [columns[name][subject] or "" for subject in subjects],
            True if name in question.categorical else None,
        )
        for name in names
    ]
    chosen, tested = units.chosen(subjects), (*covariates[1:],)
    model, settings = stored.model, question.settings
    effect: ShapeEffect | FieldEffect
    if isinstance(chosen, SubjectShapes):
        effect = shape_effect(model, chosen, covariates[0], tested, settings)
    else:
        effect = field_effect(chosen, model.weights, covariates[0], tested, settings)
        known = {id.subject for id in stored.ids}
        left_out |= {s: f"no value of {chosen.name}" for s in known - {*units.subjects}}
    warnings = _warnings(effect, left_out, len(model.mean))
    result = EffectResult(effect, tuple(subjects), left_out, units.what, warnings, folder)
    _write(result, stored.model, question)
    return result


def _warnings(
    effect: ShapeEffect | FieldEffect, left_out: dict[str, str], n_points: int
) -> tuple[str, ...]:
    warnings = [f"subject {name} left out: {reason}" for name, reason in left_out.items()]
    if n_untested := n_points - len(effect.points.q_value):
        warnings.append(
            f"{n_untested} of {n_points} points not tested: some subject has no value there"
        )
    fewest = smallest_p_value(effect.covariate)
    if not effect.design.adjusted and fewest > FOUND_LEVEL:
        warnings.append(
            f"with {len(effect.covariate.values)} subjects no p-value can be below {fewest:.2g}: "
            "there are too few ways to permute them"
        )
    return tuple(warnings)


def smallest_p_value(covariate: Covariate) -> float:
    """Return one over the number of ways to give a covariate's values to the subjects."""
    counts = np.unique(covariate.values, return_counts=True)[1]
    ways = factorial(len(covariate.values)) // prod(factorial(int(count)) for count in counts)
    return 1.0 / ways


def _write(result: EffectResult, model: ShapeModel, question: Question) -> None:
    folder, effect = result.folder, result.effect
    points, n_points = effect.points, len(model.mean)
    tests = {
        "t2": points.statistic,
        "p": points.p_value,
        "q": points.q_value,
        "p_family": points.family_p_value,
    }
    if isinstance(effect, ShapeEffect):
        surface = effect.shape_mean
        sizes = _per_column("effect_mm", effect, np.linalg.norm(effect.coefficients, axis=2))
        normal = _per_column("outward_mm", effect, effect.normal_coefficients)
        arrays = _per_column("effect_mm", effect, effect.coefficients) | normal | tests
        columns = sizes | normal | tests
    else:
        surface = model.mean
        found = _per_column("effect", effect, effect.coefficients) | tests
        arrays = {name: effect.everywhere(values, n_points) for name, values in found.items()}
        columns = arrays
    _write_mesh(folder / "effect.vtp", model, surface, arrays)
    for name, value in _fitted_values(effect.covariate).items():
        path = folder / f"fitted_{quote(name, safe=' ')}.vtp"
        if isinstance(effect, ShapeEffect):
            shape = effect.shape_at(value)
            _write_mesh(path, model, shape, {"displacement_mm": shape - effect.shape_mean})
        else:
            fitted = effect.everywhere(effect.values_at(value), n_points)
            _write_mesh(path, model, model.mean, {effect.name: fitted})
    _write_points(folder / "points.csv", model, surface, columns)
    page = effect_page(model, effect, _subtitle(result), _notes(result, question), result.warnings)
    drawings = {}
    for section in page.sections:
        for picture in section.pictures:
            drawings[picture.name] = draw_picture(picture)
            save_drawing(drawings[picture.name], picture.name, folder / "figures")
    _write_text(folder / "report.html", render_page(page, drawings))
    facts = json.dumps(result.as_json(), indent=1, ensure_ascii=False, allow_nan=False)
    _write_text(folder / "summary.json", facts + "\n")


def _per_column(
    name: str, effect: ShapeEffect | FieldEffect, values: FloatArray
) -> dict[str, FloatArray]:
    if len(values) == 1:
        return {name: values[0]}
    return {
        f"{name} {column}": value for column, value in zip(effect.design.names, values, strict=True)
    }


def _fitted_values(covariate: Covariate) -> dict[str, float | str]:
    if covariate.is_categorical:
        return {level: level for level in covariate.levels}
    low, high = np.percentile(covariate.values, LOW_AND_HIGH)
    return {f"{value:.4g}": float(value) for value in (low, high)}


def _write_mesh(
    path: Path, model: ShapeModel, shape: FloatArray, arrays: dict[str, FloatArray]
) -> None:
    write_surface(path, shape, model.mesh.faces, arrays, {"part": model.mesh.face_part})


def _write_points(
    path: Path, model: ShapeModel, surface: FloatArray, columns: dict[str, FloatArray]
) -> None:
    header = ["point", "part", "x_mm", "y_mm", "z_mm", *columns]
    numbers = np.column_stack([surface, *columns.values()])
    rows = (
        [number, model.mesh.parts[part], *(None if np.isnan(v) else float(v) for v in row)]
        for number, (part, row) in enumerate(zip(model.mesh.part, numbers, strict=True))
    )
    write_table(path, header, rows)


def _subtitle(result: EffectResult) -> str:
    adjusted = result.effect.design.adjusted
    return (
        f"{len(result.subjects)} subjects, each by its {result.what}"
        + (f"; adjusted for {', '.join(adjusted)}" if adjusted else "")
        + f"; Ostiform {__version__}"
    )


def _notes(result: EffectResult, question: Question) -> Sequence[str]:
    settings, effect = question.settings, result.effect
    tested = (
        f"the value of {effect.name} at a point"
        if isinstance(effect, FieldEffect)
        else "any movement of a point"
        if settings.movement == "any"
        else "the movement of a point along the normal"
    )
    return (
        f"Tested: {tested}. p-values come from {settings.permutations} permutations of the "
        f"subjects (seed {settings.seed}"
        + (", of the residuals after adjustment" if effect.design.adjusted else "")
        + "), q-values from the procedure of Benjamini and Hochberg.",
        "Of the points found, at most 5 % are expected to be found wrongly. Points that change "
        "together are found together: a patch says where an effect is seen, not where it begins.",
    )


def _write_text(path: Path, text: str) -> None:
    with atomically(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
