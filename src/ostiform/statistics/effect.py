"""The dependence of shape, or of a field on it, on a covariate: whether, where, and how far."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.errors import InputError
from ostiform.model import ShapeModel, reconstruct
from ostiform.statistics.covariates import Covariate
from ostiform.statistics.design import Design, design_of, permutations
from ostiform.statistics.points import PointTest, point_test
from ostiform.statistics.scores import ScoreTest, score_test
from ostiform.statistics.settings import EffectSettings
from ostiform.statistics.units import SubjectField, SubjectShapes
from ostiform.surface import face_normals
from ostiform.values import Axes, value


@value
class ShapeEffect:
    """What was found out about one covariate.

    Attributes
    ----------
    covariate : Covariate
        The one under test, of the S subjects.
    design : Design
    shape_mean : (P, 3) float64, mm
        The mean of the subjects.
    whole : ScoreTest
        Of the whole shape.
    points : PointTest
        Of every point.
    coefficients : (q, P, 3) float64, mm per unit of each column of the design
        The difference to the reference category, or the change per unit of the covariate.
    normal_coefficients : (q, P) float64, mm per unit
        Their components along the outward normal of the mean of the subjects.
    """

    covariate: Covariate
    design: Annotated[Design, Axes("names")]
    shape_mean: Annotated[FloatArray, Axes("P", 3)]
    whole: ScoreTest
    points: Annotated[PointTest, Axes("P")]
    coefficients: Annotated[FloatArray, Axes("names", "P", 3)]
    normal_coefficients: Annotated[FloatArray, Axes("names", "P")]

    def shape_at(self, value: float | str) -> FloatArray:
        """Return the fitted shape (P, 3) in mm at a value, or of a category, of the covariate.

        What is adjusted for is at its mean over the subjects.

        Raises
        ------
        InputError
            If a category is unknown.
        """
        return _fitted(self.covariate, self.shape_mean, self.coefficients, value)


@value
class FieldEffect:
    """What was found out about one covariate and a field of the surface.

    Attributes
    ----------
    name, units : str
        Of the field.
    covariate, design
        As `ShapeEffect`.
    tested : (T,) int64
        The points at which every subject has a value, in order.
    mean : (T,) float64
        The mean of the subjects there.
    whole : ScoreTest
        Of the field on all these points, weighted by area.
    points : PointTest
        Of every one of them.
    coefficients : (q, T) float64, the field's units per unit of each column of the design
    """

    name: str
    units: str
    covariate: Covariate
    design: Annotated[Design, Axes("names")]
    tested: Annotated[IntArray, Axes("T")]
    mean: Annotated[FloatArray, Axes("T")]
    whole: ScoreTest
    points: PointTest
    coefficients: Annotated[FloatArray, Axes("names", "T")]

    def everywhere(self, values: FloatArray, n_points: int) -> FloatArray:
        """Return values (T,) of the tested points at all points (P,), NaN at the others."""
        spread = np.full(n_points, np.nan)
        spread[self.tested] = values
        return spread

    def values_at(self, value: float | str) -> FloatArray:
        """Return the fitted values (T,) at a value, or of a category: see `ShapeEffect.shape_at`.

        Raises
        ------
        InputError
            If a category is unknown.
        """
        return _fitted(self.covariate, self.mean, self.coefficients, value)


def _fitted(
    covariate: Covariate, mean: FloatArray, coefficients: FloatArray, value: float | str
) -> FloatArray:
    if isinstance(value, str):
        if value not in covariate.levels:
            raise InputError(
                f'covariate "{covariate.name}": expected one of '
                f"{', '.join(covariate.levels) or 'numbers'}, found {value}"
            )
        row = np.arange(1, len(covariate.levels)) == covariate.levels.index(value)
    else:
        row = np.array([value - covariate.values.mean()])
    offset = row - covariate.columns()[0].mean(axis=0)
    fitted: FloatArray = mean + np.tensordot(offset, coefficients, axes=1)
    return fitted


def shape_effect(
    model: ShapeModel,
    shapes: SubjectShapes,
    covariate: Covariate,
    adjusted: Sequence[Covariate] = (),
    settings: EffectSettings | None = None,
) -> ShapeEffect:
    """Test whether and where shape depends on a covariate, adjusted for others.

    A group difference is the dependence on a categorical covariate.

    Parameters
    ----------
    model : ShapeModel
        Whose scores the subjects' shapes are given in.
    shapes : SubjectShapes
    covariate : Covariate
        Of the same subjects in the same order.
    adjusted : sequence of Covariate
    settings : EffectSettings, optional

    Raises
    ------
    InputError
        If the covariates do not fit the subjects or each other, or there are too few subjects.
    """
    settings = EffectSettings() if settings is None else settings
    if settings.movement not in ("any", "normal"):
        raise InputError(f'movement: expected "any" or "normal", found "{settings.movement}"')
    design, orders = _tested(len(shapes.subjects), covariate, adjusted, settings)
    positions = reconstruct(model, shapes.scores)  # (S, P, 3)
    mean = positions.mean(axis=0)
    normals = point_normals(mean, model)
    along = normal_movement(positions, mean, normals)
    tested = positions - mean if settings.movement == "any" else along[:, :, None]
    coefficients = design.coefficients(positions)
    return ShapeEffect(
        covariate=covariate,
        design=design,
        shape_mean=mean,
        whole=score_test(shapes.scores, design, orders, settings.modes, settings.shrinkage),
        points=point_test(tested, design, orders),
        coefficients=coefficients,
        normal_coefficients=np.einsum("qpi,pi->qp", coefficients, normals),
    )


def field_effect(
    field: SubjectField,
    weights: FloatArray,
    covariate: Covariate,
    adjusted: Sequence[Covariate] = (),
    settings: EffectSettings | None = None,
) -> FieldEffect:
    """Test whether and where a field depends on a covariate, adjusted for others.

    Points at which a subject has no value are not tested.

    Parameters
    ----------
    field : SubjectField
    weights : (P,) float64
        Area shares of the points.
    covariate, adjusted, settings
        As `shape_effect`; a field has no direction, so `movement` says nothing.

    Raises
    ------
    InputError
        As `shape_effect`, or if there is no point at which all subjects have a value.
    """
    settings = EffectSettings() if settings is None else settings
    design, orders = _tested(len(field.subjects), covariate, adjusted, settings)
    lacking = np.isnan(field.values).sum(axis=0)  # (P,)
    tested = np.flatnonzero(lacking == 0)
    if not len(tested):
        raise InputError(
            f"values at the points: expected points at which all {len(field.subjects)} subjects "
            f"have one, found none, {int(lacking.min())} subjects lack it at the best: leave out "
            "the subjects with the largest gaps"
        )
    values = field.values[:, tested]
    mean = values.mean(axis=0)
    scores = (values - mean) * np.sqrt(weights[tested] / weights[tested].sum())
    return FieldEffect(
        name=field.name,
        units=field.units,
        covariate=covariate,
        design=design,
        tested=tested,
        mean=mean,
        whole=score_test(scores, design, orders, settings.modes, settings.shrinkage),
        points=point_test((values - mean)[:, :, None], design, orders),
        coefficients=design.coefficients(values),
    )


def _tested(
    count: int, covariate: Covariate, adjusted: Sequence[Covariate], settings: EffectSettings
) -> tuple[Design, IntArray]:
    """Return the design of a test of so many subjects, and their permutations."""
    for each in (covariate, *adjusted):
        if len(each.values) != count:
            raise InputError(
                f'covariate "{each.name}": expected one value for each of {count} '
                f"subjects, found {len(each.values)}"
            )
    rng = np.random.default_rng(settings.seed)
    return design_of(covariate, adjusted), permutations(count, settings.permutations, rng)


def point_normals(shape: FloatArray, model: ShapeModel) -> FloatArray:
    """Return the outward unit normals (P, 3) of a shape: the mean over the triangles of a point."""
    faces = model.mesh.faces
    sums = np.zeros_like(shape)
    np.add.at(sums, faces.ravel(), np.repeat(face_normals(shape, faces), 3, axis=0))
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    normals: FloatArray = sums / np.where(lengths > 0.0, lengths, 1.0)
    return normals


def normal_movement(positions: FloatArray, mean: FloatArray, normals: FloatArray) -> FloatArray:
    """Return how far (S, P) in mm shapes (S, P, 3) lie from a mean along its normals."""
    moved: FloatArray = np.einsum("spi,pi->sp", positions - mean, normals)
    return moved
