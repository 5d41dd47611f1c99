"""Where one shape's warp stands, and how its landmarks move with the coefficients of a flow."""

from dataclasses import dataclass

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.correspondence.assembly_kernels import landmark_derivatives
from ostiform.correspondence.fields import ActiveFields, FieldBasis, active
from ostiform.correspondence.sampling import ShapeSampler, sample_with_derivative
from ostiform.domain import Template

# Levenberg damping of a first step, relative to the mean diagonal of the normal matrix.
FIRST_DAMPING = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class WarpState:
    """Where one shape's warp stands.

    Attributes
    ----------
    directions : (P, 3) float64
        Every template point's current position on its sphere.
    landmarks : (Q, 3) float64, mm
        The shape sampled at the optimiser's points, input coordinates.
    damping : float
        Levenberg damping of the next step.
    """

    directions: FloatArray
    landmarks: FloatArray
    damping: float = FIRST_DAMPING


def aligned_landmarks(state: WarpState, transform: FloatArray) -> FloatArray:
    """Return the landmarks (Q, 3) in aligned coordinates, by a transform (4, 4) from input ones."""
    aligned: FloatArray = state.landmarks @ transform[:3, :3].T + transform[:3, 3]
    return aligned


@dataclass(frozen=True, slots=True, eq=False)
class Linearised:
    """A shape, and the first order of its landmarks in the coefficients of a flow composed on top.

    Attributes
    ----------
    state : WarpState
    transform : (4, 4) float64
        From input to aligned coordinates.
    basis : FieldBasis
        D fields.
    fields : ActiveFields
        At the Q points.
    moved : (A, 3) float64, mm
        How every active field moves its landmark, in input coordinates.
    turned : (A, 3) float64, mm
        The same in aligned coordinates.
    """

    state: WarpState
    transform: FloatArray
    basis: FieldBasis
    fields: ActiveFields
    moved: FloatArray
    turned: FloatArray

    def scaled(self, roots: FloatArray) -> FloatArray:
        """Return `turned` (A, 3) with every landmark's motions times its root weight (Q,)."""
        scaled: FloatArray = self.turned * np.repeat(roots, np.diff(self.fields.starts))[:, None]
        return scaled


def linearised(
    sampler: ShapeSampler,
    state: WarpState,
    basis: FieldBasis,
    coarse: Template,
    index: IntArray,
    transform: FloatArray,
) -> Linearised:
    """Return the first order of a shape about its state.

    Parameters
    ----------
    sampler : ShapeSampler
    state : WarpState
    basis : FieldBasis
    coarse : Template
        Of the Q landmarks.
    index : (Q,) int64
        Their indices among the points of the state.
    transform : (4, 4) float64
    """
    directions = state.directions[index]
    fields = active(basis, coarse, directions)
    derivatives = sample_with_derivative(sampler, coarse, directions)[1]
    moved = landmark_derivatives(fields.starts, fields.vectors, derivatives)
    turned = moved @ transform[:3, :3].T
    return Linearised(state, transform, basis, fields, moved, turned)
