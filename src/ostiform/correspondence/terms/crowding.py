"""The crowding term: no triangle of the template should be squeezed flat by a warp.

Flows never fold the sphere, but straight-edged triangles carried along can be turned over where a
flow shears strongly beside a small circle. A limit alone, at which steps are refused, lets a few
such triangles hold up a whole shape. So a triangle whose determinant has fallen to less than half
of the template's pushes back: the term is ``strength * sum_t log(share_t / roomy)^2`` over those,
share_t the ratio of the determinants, and infinite where a triangle is turned over.
"""

from dataclasses import dataclass

import numpy as np

from ostiform.arrays import FloatArray, read_only
from ostiform.correspondence.assembly_kernels import determinant_derivatives
from ostiform.correspondence.field_kernels import active_fields, determinants, field_vectors
from ostiform.correspondence.fields import FieldBasis, orientation_shares
from ostiform.correspondence.state import Linearised, WarpState
from ostiform.correspondence.terms.term import System
from ostiform.domain import Template

STRENGTH = 3.0

ROOMY = 0.5
"""Share of a triangle's initial determinant above which the term does not see it."""


@dataclass(frozen=True, slots=True, eq=False)
class Crowding:
    """The term of a template's triangles.

    Attributes
    ----------
    template : Template
        Of all P points.
    """

    template: Template

    def value(self, state: WarpState, transform: FloatArray) -> float:
        """Return the term of a shape; no alignment enters."""
        shares = orientation_shares(self.template, state.directions)
        crowded = shares[shares < ROOMY]
        if crowded.min(initial=ROOMY) <= 0.0:
            return np.inf
        return STRENGTH * float((np.log(crowded / ROOMY) ** 2).sum())

    def system(self, at: Linearised) -> System:
        """Return the term's gradient and Gauss-Newton matrix; no triangle is turned over."""
        residuals, slopes = crowding_residuals(at.basis, self.template, at.state.directions)
        if not len(residuals):
            return System(np.zeros(len(at.basis)))
        return System(residuals @ slopes, slopes.T @ slopes)


def crowding_residuals(
    basis: FieldBasis, template: Template, directions: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the residuals whose squares add up to the term, and their derivatives.

    Parameters
    ----------
    basis : FieldBasis
        D fields.
    template : Template
    directions : (P, 3) float64
        Current positions; no triangle of the template is turned over.

    Returns
    -------
    residuals : (T,) float64
        One per crowded triangle.
    derivatives : (T, D) float64
        By the coefficients of a flow composed on top.
    """
    shares = orientation_shares(template, directions)
    crowded = np.flatnonzero(shares < ROOMY)
    corners, local = np.unique(template.faces[crowded], return_inverse=True)
    points = read_only(directions[corners])
    sphere, curve = read_only(template.sphere[corners]), read_only(template.curve[corners])
    starts, fields = active_fields(points, sphere, basis.table, basis.labels)
    vectors = field_vectors(
        points, sphere, curve, starts, fields, basis.table, basis.labels, basis.circles
    )
    local = read_only(local.reshape(-1, 3))
    slopes = determinant_derivatives(points, local, starts, fields, vectors, len(basis))
    root = np.sqrt(STRENGTH)
    slopes *= root / determinants(points, local)[:, None]
    return root * np.log(shares[crowded] / ROOMY), slopes
