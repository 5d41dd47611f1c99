"""The crowding term: no triangle of the template should be squeezed flat by a warp.

Flows never fold the sphere, but straight-edged triangles carried along can be turned over where a
flow shears strongly beside a small circle. A limit alone, at which steps are refused, lets a few
such triangles hold up a whole shape. So a triangle whose determinant has fallen to less than half
of the template's pushes back: the term is ``strength * sum_t log(share_t / roomy)^2`` over those,
share_t the ratio of the determinants, and infinite where a triangle is turned over.
"""

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.correspondence.assembly_kernels import determinant_derivatives
from ostiform.correspondence.field_kernels import active_fields, determinants, field_vectors
from ostiform.correspondence.warps import FieldBasis, orientation_shares
from ostiform.domain import Template

STRENGTH = 3.0

ROOMY = 0.5
"""Share of a triangle's initial determinant above which the term does not see it."""


def crowding_value(template: Template, directions: FloatArray) -> float:
    """Return the crowding term of a template whose points are at directions (P, 3)."""
    shares = orientation_shares(template, directions)
    crowded = shares[shares < ROOMY]
    if crowded.min(initial=ROOMY) <= 0.0:
        return np.inf
    return STRENGTH * float((np.log(crowded / ROOMY) ** 2).sum())


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
    points = directions[corners]
    sphere, curve = template.sphere[corners], template.curve[corners]
    starts, fields = active_fields(points, sphere, basis.numbers, basis.labels, 0.0)
    vectors = field_vectors(
        points, sphere, curve, starts, fields, basis.numbers, basis.labels, basis.circles
    )
    local = local.reshape(-1, 3)
    slopes = determinant_derivatives(points, local, starts, fields, vectors, len(basis))
    root = np.sqrt(STRENGTH)
    slopes *= root / determinants(points, local)[:, None]
    return root * np.log(shares[crowded] / ROOMY), slopes
