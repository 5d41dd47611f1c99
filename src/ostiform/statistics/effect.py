"""The dependence of shape on a covariate: whether, where, and what it looks like."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.errors import InputError
from ostiform.model import ShapeModel, reconstruct
from ostiform.statistics.covariates import Covariate
from ostiform.statistics.design import Design, design_of, permutations
from ostiform.statistics.points import PointTest, point_test
from ostiform.statistics.scores import ScoreTest, score_test
from ostiform.statistics.settings import EffectSettings
from ostiform.statistics.units import SubjectShapes
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
        columns = self.covariate.columns()[0]
        if isinstance(value, str):
            if value not in self.covariate.levels:
                raise InputError(
                    f'covariate "{self.covariate.name}": expected one of '
                    f"{', '.join(self.covariate.levels) or 'numbers'}, found {value}"
                )
            row = np.arange(1, len(self.covariate.levels)) == self.covariate.levels.index(value)
        else:
            row = np.array([value - self.covariate.values.mean()])
        shape: FloatArray = self.shape_mean + np.tensordot(
            row - columns.mean(axis=0), self.coefficients, axes=1
        )
        return shape


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
    for each in (covariate, *adjusted):
        if len(each.values) != len(shapes.subjects):
            raise InputError(
                f'covariate "{each.name}": expected one value for each of {len(shapes.subjects)} '
                f"subjects, found {len(each.values)}"
            )
    if settings.movement not in ("any", "normal"):
        raise InputError(f'movement: expected "any" or "normal", found "{settings.movement}"')
    design = design_of(covariate, adjusted)
    rng = np.random.default_rng(settings.seed)
    orders = permutations(len(shapes.subjects), settings.permutations, rng)
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
