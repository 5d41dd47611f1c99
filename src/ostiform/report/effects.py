"""The dependence of shape, or of a field, on a covariate as a surface map, and how sure it is."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from ostiform.arrays import BoolArray, FloatArray
from ostiform.model import ShapeModel
from ostiform.report.cutaway import drawn_faces
from ostiform.report.html import Fact, Page, Picture, Section, Table
from ostiform.report.modes import extents_of
from ostiform.report.shading import (
    ALL_ROUND,
    draw_raster,
    draw_visible_curves,
    shaded_surface,
)
from ostiform.report.style import COLOURS, PRINT_DPI, figure, plain_figure, styled
from ostiform.statistics import FieldEffect, ScoreTest, ShapeEffect

PANEL_MM = 36.0
LABEL_MM = 30.0
"""Strip at the right of each row for its colour bar."""
TITLE_MM = 8.0
GREY = np.array([0.86, 0.87, 0.88])
FADED = 0.88
"""How far a point that was not found is faded into grey."""
OUTWARD_MAP = "RdBu_r"
MOVEMENT_MAP = "cividis"
Q_MAP = "Blues_r"
SMALLEST_Q = 1e-4
"""The lower end of the scale of q-values."""

FOUND_LEVEL = 0.05
RIM = "#1b2733"


@dataclass(frozen=True, slots=True, eq=False)
class _Row:
    """One map: values (P,), NaN where there is none, and which points are shown in full."""

    label: str
    values: FloatArray
    colour_map: str
    limits: tuple[float, float]
    kept: BoolArray | None

    def corner_colours(self, model: ShapeModel) -> FloatArray:
        """Return the colours (F, 3, 3) of the triangles' corners."""
        colours: FloatArray = colormaps[self.colour_map](Normalize(*self.limits)(self.values))
        colours = colours[:, :3]
        if self.kept is not None:
            colours[~self.kept] = (1.0 - FADED) * colours[~self.kept] + FADED * GREY
        colours[np.isnan(self.values)] = GREY
        corners: FloatArray = colours[model.mesh.faces]
        return corners


def effect_figure(model: ShapeModel, effect: ShapeEffect | FieldEffect, column: int = 0) -> Figure:
    """Draw where and how far the surface moves or its field changes, from four sides.

    The movement along the outward normal and the whole movement, or the change of the field, per
    unit of the covariate, grey where the q-value is above 0.05; below them the q-value.

    Parameters
    ----------
    model : ShapeModel
        Gives the mesh, and the surface that a field is drawn on.
    effect : ShapeEffect or FieldEffect
    column : int
        Of the design: which category against the reference.
    """
    if isinstance(effect, ShapeEffect):
        surface, rows = effect.shape_mean, _movements(effect, column)
    else:
        surface, rows = model.mean, _changes(effect, column, len(model.mean))
    extents = extents_of(ALL_ROUND, [surface])
    height = PANEL_MM * float((extents[0, 3] - extents[0, 2]) / (extents[0, 1] - extents[0, 0]))
    size = (round(PANEL_MM / 25.4 * PRINT_DPI), round(height / 25.4 * PRINT_DPI))
    shown = drawn_faces(model, ALL_ROUND)
    wide, high = PANEL_MM * len(ALL_ROUND) + LABEL_MM, height * len(rows) + TITLE_MM
    with styled():
        drawing = plain_figure(wide, high)
        for number, row in enumerate(rows):
            colours = row.corner_colours(model)
            bottom = (len(rows) - 1 - number) * height
            for column, (view, extent) in enumerate(zip(ALL_ROUND, extents, strict=True)):
                box = (column * PANEL_MM / wide, bottom / high, PANEL_MM / wide, height / high)
                axes = drawing.add_axes(box)
                drawn = shown[column]
                picture = shaded_surface(
                    view, surface, model.mesh.faces[drawn], colours[drawn], extent, size
                )
                draw_raster(axes, picture)
                loops = [surface[loop] for loop in model.mesh.loops.values()]
                draw_visible_curves(axes, picture, view, loops, RIM, 0.6)
                if number == 0:
                    axes.set_title(view.name, pad=2.0)
            left = PANEL_MM * len(ALL_ROUND) + 0.15 * LABEL_MM
            bar = drawing.add_axes(
                (left / wide, (bottom + 0.15 * height) / high, 3.0 / wide, 0.7 * height / high)
            )
            scale = ScalarMappable(Normalize(*row.limits), row.colour_map)
            drawing.colorbar(scale, cax=bar, label=row.label)
            bar.grid(visible=False)
            if row.kept is None:
                ticks = np.array([-4.0, -3.0, -2.0, np.log10(FOUND_LEVEL), 0.0])
                bar.set_yticks(ticks, [f"{10.0**tick:g}" for tick in ticks])
    return drawing


def _movements(effect: ShapeEffect, column: int) -> tuple[_Row, ...]:
    outward = effect.normal_coefficients[column]
    movement = np.linalg.norm(effect.coefficients[column], axis=1)
    found = effect.points.q_value <= FOUND_LEVEL
    unit = _per_unit("mm", effect)
    return (
        _Row(f"outward movement{unit}", outward, OUTWARD_MAP, _either_way(outward), found),
        _Row(f"movement{unit}", movement, MOVEMENT_MAP, (0.0, _either_way(movement)[1]), found),
        _q_row(effect.points.q_value),
    )


def _changes(effect: FieldEffect, column: int, n_points: int) -> tuple[_Row, ...]:
    change, q_value = (
        effect.everywhere(values, n_points)
        for values in (effect.coefficients[column], effect.points.q_value)
    )
    label = f"change{_per_unit(effect.units, effect)}"
    found = q_value <= FOUND_LEVEL
    return _Row(label, change, OUTWARD_MAP, _either_way(change), found), _q_row(q_value)


def _either_way(values: FloatArray) -> tuple[float, float]:
    most = max(float(np.nanmax(np.abs(values))), np.finfo(np.float64).tiny)
    return -most, most


def _per_unit(units: str, effect: ShapeEffect | FieldEffect) -> str:
    per = "" if effect.covariate.is_categorical else "per unit"
    text = " ".join(word for word in (units, per) if word)
    return f"\n({text})" if text else ""


def _q_row(q_value: FloatArray) -> _Row:
    scale = np.log10(np.clip(q_value, SMALLEST_Q, 1.0))
    return _Row("q-value", scale, Q_MAP, (np.log10(SMALLEST_Q), 0.0), None)


def null_figure(test: ScoreTest) -> Figure:
    """Draw the statistic of the whole shape among those of the permutations."""
    with styled():
        drawing = figure(90.0, 55.0)
        axes = drawing.subplots()
        axes.hist(test.null, bins=40, color="#9FB3C2")
        axes.axvline(test.statistic, color=COLOURS["euclidean"], linewidth=2.0)
        axes.set_xlabel("T² of the data (line) and of the permutations")
        axes.set_ylabel("permutations")
    return drawing


def effect_page(
    model: ShapeModel,
    effect: ShapeEffect | FieldEffect,
    subtitle: str,
    notes: Sequence[str] = (),
    warnings: Sequence[str] = (),
) -> Page:
    """Return a report of one effect.

    Parameters
    ----------
    model : ShapeModel
    effect : ShapeEffect or FieldEffect
    subtitle : str
    notes : sequence of str
        What was tested, one sentence each.
    warnings : sequence of str
    """
    whole, points = effect.whole, effect.points
    if isinstance(effect, ShapeEffect):
        subject, weights, changes = "shape", model.weights, effect.normal_coefficients
        maps = "movement along the outward normal, whole movement (both"
        change, units = "movement along the normal", "mm"
    else:
        subject, weights = f"field {effect.name}", model.weights[effect.tested]
        changes, maps = effect.coefficients, f"change of {effect.name} ("
        change, units = f"change of {effect.name}", effect.units
    q_share, family_share = (
        float((values <= FOUND_LEVEL) @ weights / weights.sum())
        for values in (points.q_value, points.family_p_value)
    )
    facts = (
        Fact(f"whole {subject}, p", _p_text(whole.p_value), note=f"{len(whole.null)} permutations"),
        Fact("of the variance explained", f"{100 * whole.explained:.1f} %"),
        Fact("of the surface found", f"{100 * q_share:.0f} %", note="q at most 0.05"),
        Fact("of the surface found", f"{100 * family_share:.0f} %", note="max-T p at most 0.05"),
    )
    pictures = [
        Picture(
            f"effect{column + 1}" if len(effect.design.names) > 1 else "effect",
            effect_figure(model, effect, column),
            f"{name}. From above: {maps} grey where q is above 0.05), q-value of every point.",
            f"Surface map of the effect of {name}: the {change} is between "
            f"{changes[column].min():.2f} and {changes[column].max():.2f} {units} per unit.",
            is_vector=False,
        )
        for column, name in enumerate(effect.design.names)
    ]
    null = Picture(
        "null",
        null_figure(whole),
        f"The statistic of the whole {subject} (line) among those of permuted subjects.",
        f"Histogram of {len(whole.null)} permuted statistics; the one of the data is "
        f"{whole.statistic:.3g}, p {_p_text(whole.p_value)}.",
    )
    they = "the shapes differ" if subject == "shape" else f"the {subject} differs"
    return Page(
        title=f"{subject[:1].upper()}{subject[1:]} and {effect.covariate.name}",
        subtitle=subtitle,
        facts=facts,
        sections=(
            Section("where", f"Where {they}", tuple(notes), tuple(pictures)),
            Section("whether", f"Whether {they}", (), (null,), (_table(effect, subject),)),
        ),
        warnings=tuple(warnings),
    )


def _table(effect: ShapeEffect | FieldEffect, subject: str) -> Table:
    whole = effect.whole
    return Table(
        f"The test of the whole {subject}.",
        ("quantity", "value"),
        (
            ("T²", f"{whole.statistic:.4g}"),
            ("p-value", _p_text(whole.p_value)),
            ("modes", f"{whole.n_modes}, {100 * whole.variance_share:.0f} % of the variance"),
            ("shrinkage of the covariance", f"{whole.shrinkage:.2f}"),
            ("subjects", f"{len(effect.covariate.values)}"),
            ("degrees of freedom of the noise", f"{effect.design.degrees}"),
            ("adjusted for", ", ".join(effect.design.adjusted) or "nothing"),
        ),
    )


def _p_text(p_value: float) -> str:
    return f"{p_value:.4f}" if p_value >= 0.001 else f"{p_value:.1e}"
