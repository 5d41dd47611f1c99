"""Group differences and regressions of a finished model, with maps and a page of their own.

Files of a test: ``summary.json``, ``points.csv``, ``effect.vtp``, the fitted shapes
``fitted_VALUE.vtp``, ``report.html`` and its figures in ``figures/``.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import factorial, prod
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from ostiform import __version__
from ostiform.atomic import atomically
from ostiform.errors import InputError
from ostiform.model import ShapeModel, StoredModel, read_model
from ostiform.pipeline.covariates import read_covariates
from ostiform.report import FOUND_LEVEL, draw_picture, effect_page, render_page, save_drawing
from ostiform.statistics import (
    Covariate,
    EffectSettings,
    ShapeEffect,
    complete_subjects,
    covariate_of,
    shape_effect,
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
    """

    covariate: str
    adjusted: tuple[str, ...] = ()
    categorical: tuple[str, ...] = ()
    phase: str | None = None
    settings: EffectSettings = field(default_factory=EffectSettings)

    def __post_init__(self) -> None:
        """Check the columns."""
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
    effect : ShapeEffect
    subjects : tuple of str
        Those used.
    left_out : dict of str to str
        The others, and why.
    what : str
        What stands for a subject.
    warnings : tuple of str
    folder : Path
    """

    effect: ShapeEffect
    subjects: tuple[str, ...]
    left_out: dict[str, str]
    what: str
    warnings: tuple[str, ...]
    folder: Path

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
            "effects": [
                {
                    "name": name,
                    "largest_mm": float(np.linalg.norm(coefficient, axis=1).max()),
                    "outward_mm": [float(normal.min()), float(normal.max())],
                }
                for name, coefficient, normal in zip(
                    effect.design.names, effect.coefficients, effect.normal_coefficients,
                    strict=True,
                )
            ],
            "warnings": list(self.warnings),
        }  # fmt: skip


def shape_question(
    results: Path, question: Question, folder: Path, sheet: Path | None = None
) -> EffectResult:
    """Test whether and where shape depends on a column of the sheet, and write the answer.

    Parameters
    ----------
    results : Path
        A folder of results.
    question : Question
    folder : Path
        For the files; made if missing.
    sheet : Path, optional
        Instead of the columns kept with the results (see `read_covariates`).

    Raises
    ------
    InputError
        If a column is missing or cannot be used, or there are too few subjects.
    ArtifactError
        If the results hold no model or no columns, or a file cannot be written.
    """
    stored = read_model(results / "model.h5")
    shapes = subject_shapes(stored, question.phase)
    rows = read_covariates(results, sheet, stored, question.phase)
    names = (question.covariate, *question.adjusted)
    columns = {name: subject_values(rows, name) for name in names}
    subjects, left_out = complete_subjects(shapes.subjects, columns)
    covariates = [
        covariate_of(
            name,
            [columns[name][subject] or "" for subject in subjects],
            True if name in question.categorical else None,
        )
        for name in names
    ]
    effect = shape_effect(
        stored.model, shapes.chosen(subjects), covariates[0], covariates[1:], question.settings
    )
    result = EffectResult(
        effect, tuple(subjects), left_out, shapes.what, _warnings(effect, left_out), folder
    )
    _write(result, stored, question)
    return result


def _warnings(effect: ShapeEffect, left_out: dict[str, str]) -> tuple[str, ...]:
    warnings = [f"subject {name} left out: {reason}" for name, reason in left_out.items()]
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


def _write(result: EffectResult, stored: StoredModel, question: Question) -> None:
    folder, effect, model = result.folder, result.effect, stored.model
    write_surface(
        folder / "effect.vtp",
        effect.shape_mean,
        model.mesh.faces,
        point_data={
            **_per_column("effect_mm", effect, effect.coefficients),
            **_per_column("outward_mm", effect, effect.normal_coefficients),
            "t2": effect.points.statistic,
            "p": effect.points.p_value,
            "q": effect.points.q_value,
            "p_family": effect.points.family_p_value,
        },
        cell_data={"part": model.mesh.face_part},
    )
    for name, value in _fitted_values(effect.covariate).items():
        shape = effect.shape_at(value)
        write_surface(
            folder / f"fitted_{quote(name, safe=' ')}.vtp",
            shape,
            model.mesh.faces,
            point_data={"displacement_mm": shape - effect.shape_mean},
            cell_data={"part": model.mesh.face_part},
        )
    _write_points(folder / "points.csv", effect, model)
    page = effect_page(model, effect, _subtitle(result), _notes(result, question), result.warnings)
    drawings = {}
    for section in page.sections:
        for picture in section.pictures:
            drawings[picture.name] = draw_picture(picture)
            save_drawing(drawings[picture.name], picture.name, folder / "figures")
    _write_text(folder / "report.html", render_page(page, drawings))
    facts = json.dumps(result.as_json(), indent=1, ensure_ascii=False, allow_nan=False)
    _write_text(folder / "summary.json", facts + "\n")


def _per_column(name: str, effect: ShapeEffect, values: np.ndarray) -> dict[str, np.ndarray]:
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


def _write_points(path: Path, effect: ShapeEffect, model: ShapeModel) -> None:
    points = effect.points
    normal = _per_column("outward_mm", effect, effect.normal_coefficients)
    size = _per_column("effect_mm", effect, np.linalg.norm(effect.coefficients, axis=2))
    header = ["point", "part", "x_mm", "y_mm", "z_mm", *size, *normal, "t2", "p", "q", "p_family"]
    numbers = np.column_stack(
        [
            effect.shape_mean,
            *size.values(),
            *normal.values(),
            points.statistic,
            points.p_value,
            points.q_value,
            points.family_p_value,
        ]
    )
    rows = (
        [number, model.mesh.parts[part], *map(float, row)]
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
        "any movement of a point"
        if settings.movement == "any"
        else "the movement of a point along the normal"
    )
    return (
        f"Tested: {tested}. p-values come from {settings.permutations} permutations of the "
        f"subjects (seed {settings.seed}"
        + (", of the residuals after adjustment" if effect.design.adjusted else "")
        + "), q-values from the procedure of Benjamini and Hochberg.",
        "Of the points found, at most 5 % are expected to be found wrongly. Points that move "
        "together are found together: a patch says where an effect is seen, not where it begins.",
    )


def _write_text(path: Path, text: str) -> None:
    with atomically(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
