"""The penalty on how far a warp has carried the points (design 5, regularisation that works)."""

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ostiform.arrays import FloatArray
from ostiform.correspondence.warps import ActiveFields
from ostiform.domain import Template
from ostiform.surface import cotangent_stiffness, face_areas


@dataclass(frozen=True, slots=True, eq=False)
class DisplacementPenalty:
    """A quadratic form of the accumulated displacement D (chords, template point to position).

    ``stretch mean |grad D|^2 + offset mean |D|^2``, the first mean over the area of the domain
    (piecewise linear elements), the second over the surface (the points' weights), so that the
    value does not depend on how finely the template is drawn.

    Attributes
    ----------
    points : (Q, 3) float64
        Template points, unit vectors.
    matrix : (Q, Q) sparse
        Applied to each coordinate of D.
    """

    points: FloatArray
    matrix: sparse.csr_array


def displacement_penalty(
    template: Template, weights: FloatArray, stretch: float, offset: float
) -> DisplacementPenalty:
    """Return the penalty of a template.

    Parameters
    ----------
    template : Template
    weights : (Q,) float64
        Area share of each point on the surfaces, sum 1.
    stretch : float
        Factor of the mean squared gradient of the displacement, dimensionless.
    offset : float
        Factor of the mean squared displacement, per square radian.
    """
    area = float(face_areas(template.points, template.faces).sum())
    stiffness = cotangent_stiffness(template.points, template.faces)
    matrix = (stretch / area) * stiffness + sparse.diags_array(offset * weights)
    return DisplacementPenalty(template.points, sparse.csr_array(matrix))


def penalty_value(penalty: DisplacementPenalty, directions: FloatArray) -> float:
    """Return the penalty of points (Q, 3) at their current positions."""
    displacement = directions - penalty.points  # (Q, 3)
    return float(np.sum(displacement * (penalty.matrix @ displacement)))


def penalty_force(penalty: DisplacementPenalty, directions: FloatArray) -> FloatArray:
    """Return half the derivative (Q, 3) of the penalty by the positions."""
    force: FloatArray = penalty.matrix @ (directions - penalty.points)
    return force


def penalty_hessian(
    penalty: DisplacementPenalty, fields: ActiveFields, n_fields: int
) -> FloatArray:
    """Return half the second derivative (D, D) of the penalty by the coefficients of fields.

    Parameters
    ----------
    penalty : DisplacementPenalty
    fields : ActiveFields
        The basis at the Q points.
    n_fields : int
    """
    count = len(penalty.points)
    rows = np.repeat(np.arange(count), np.diff(fields.starts))
    hessian = np.zeros((n_fields, n_fields))
    for axis in range(3):
        matrix = sparse.csr_array(
            (fields.vectors[:, axis], (rows, fields.fields)), shape=(count, n_fields)
        )
        hessian += (matrix.T @ (penalty.matrix @ matrix)).toarray()
    return hessian
