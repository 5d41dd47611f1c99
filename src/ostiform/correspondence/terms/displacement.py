"""The penalty on how far a warp has carried the points (design 5, regularisation that works)."""

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ostiform.arrays import FloatArray, IntArray
from ostiform.correspondence.assembly_kernels import pulled_back
from ostiform.correspondence.fields import FieldBasis, active
from ostiform.correspondence.state import Linearised, WarpState
from ostiform.correspondence.terms.term import System
from ostiform.domain import Template
from ostiform.surface import cotangent_stiffness, face_areas


@dataclass(frozen=True, slots=True, eq=False)
class DisplacementPenalty:
    """A quadratic form of the accumulated displacement (chords, template point to position).

    ``stretch mean |grad u|^2 + offset mean |u|^2``, the first mean over the area of the domain
    (piecewise linear elements), the second over the surface (the points' weights), so that the
    value does not depend on how finely the template is drawn.

    Attributes
    ----------
    points : (Q, 3) float64
        Template points, unit vectors.
    index : (Q,) int64
        Their indices among all points.
    stiffness : (Q, Q) sparse
        Applied to each coordinate of the displacement.
    curvature : (D, D) float64
        Half the second derivative by the coefficients of a level's fields, at the identity warp.
    """

    points: FloatArray
    index: IntArray
    stiffness: sparse.csr_array
    curvature: FloatArray

    def value(self, state: WarpState, transform: FloatArray) -> float:
        """Return the penalty of a shape; no alignment enters."""
        displacement = state.directions[self.index] - self.points  # (Q, 3)
        return float(np.sum(displacement * (self.stiffness @ displacement)))

    def system(self, at: Linearised) -> System:
        """Return the penalty's gradient about a state, and its curvature at the identity."""
        starts, fields, vectors = at.fields.starts, at.fields.fields, at.fields.vectors
        force = self.stiffness @ (at.state.directions[self.index] - self.points)  # (Q, 3)
        half_gradient = pulled_back(starts, fields, vectors, force, len(at.basis))
        return System(half_gradient, self.curvature)


def displacement_penalty(
    template: Template,
    index: IntArray,
    weights: FloatArray,
    strengths: tuple[float, float],
    basis: FieldBasis,
) -> DisplacementPenalty:
    """Return the penalty of a template.

    Parameters
    ----------
    template : Template
        Of the Q points.
    index : (Q,) int64
        Their indices among all points.
    weights : (Q,) float64
        Area share of each point on the surfaces, sum 1.
    strengths : (float, float)
        Factors of the mean squared gradient of the displacement, dimensionless, and of the mean
        squared displacement, per square radian.
    basis : FieldBasis
        Of the level.
    """
    stretch, offset = strengths
    area = float(face_areas(template.points, template.faces).sum())
    stiffness = cotangent_stiffness(template.points, template.faces)
    matrix = sparse.csr_array((stretch / area) * stiffness + sparse.diags_array(offset * weights))
    return DisplacementPenalty(template.points, index, matrix, _curvature(matrix, template, basis))


def _curvature(matrix: sparse.csr_array, template: Template, basis: FieldBasis) -> FloatArray:
    """Return half the second derivative (D, D) by the coefficients of fields at the identity."""
    fields = active(basis, template, template.points)
    count = len(template.points)
    rows = np.repeat(np.arange(count), np.diff(fields.starts))
    curvature = np.zeros((len(basis), len(basis)))
    for axis in range(3):
        motions = sparse.csr_array(
            (fields.vectors[:, axis], (rows, fields.fields)), shape=(count, len(basis))
        )
        curvature += (motions.T @ (matrix @ motions)).toarray()
    return curvature
