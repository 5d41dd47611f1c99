"""Quadratic forms of a shape's aligned landmarks: length, coherence and distance are such."""

from dataclasses import dataclass

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.correspondence.assembly_kernels import (
    motion_derivatives,
    pulled_back,
    score_derivatives,
)
from ostiform.correspondence.state import Linearised, WarpState, aligned_landmarks
from ostiform.correspondence.terms.term import System

# Motions with less than this of the largest share are left out of a step's matrix (not of its
# gradient): half of them, whose curvature is then overestimated by little.
LEAST_SHARE_FELT = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class QuadraticForm:
    """The function ``z^T W z`` of a shape, z its deviation from a target scaled by root weights.

    W is never formed: it is `scale` times the identity less ``modes^T diag(gains) modes``, and
    less ``motions^T diag(shares) motions`` for each of the three coordinates alike.

    Attributes
    ----------
    target : (Q, 3) float64, mm
    root_weights : (Q,) float64
    scale : float
        1 / mm^2.
    modes : (R, 3Q) float64
        Orthonormal rows; best in Fortran order, as their columns are what a step needs.
    gains : (R,) float64
        Between 0 and `scale`.
    motions : (S, Q) float64
        Orthonormal rows, of one coordinate.
    shares : (S,) float64
        Not below 0; with the gains of the modes along a motion at most `scale`.
    """

    target: FloatArray
    root_weights: FloatArray
    scale: float
    modes: FloatArray
    gains: FloatArray
    motions: FloatArray
    shares: FloatArray

    def value(self, state: WarpState, transform: FloatArray) -> float:
        """Return the form of a shape's aligned landmarks."""
        return form_value(self, aligned_landmarks(state, transform))

    def system(self, at: Linearised) -> System:
        """Return the form's gradient and matrix about a state."""
        starts, fields, count = at.fields.starts, at.fields.fields, len(at.basis)
        moved = at.scaled(self.root_weights)
        force = form_product(self, aligned_landmarks(at.state, at.transform))
        explained = []
        if len(self.gains):
            modes = np.ascontiguousarray(self.modes.T)
            scores = score_derivatives(starts, fields, moved, modes, count)  # (D, R)
            explained.append(scores * np.sqrt(self.gains))
        felt = self.shares > LEAST_SHARE_FELT * self.shares.max(initial=0.0)
        if felt.any():
            motions = np.ascontiguousarray(self.motions[felt].T)
            along = motion_derivatives(starts, fields, moved, motions, count).reshape(count, -1)
            explained.append(along * np.sqrt(np.tile(self.shares[felt], 3)))  # (D, 3S)
        return System(
            pulled_back(starts, fields, moved, force, count),
            inertia=self.scale * self.root_weights**2,
            explained=np.concatenate(explained, axis=1) if explained else None,
        )


def form_value(form: QuadraticForm, shape: FloatArray) -> float:
    """Return ``z^T W z`` of a shape (Q, 3) in the target's frame, mm."""
    deviation = (shape - form.target) * form.root_weights[:, None]  # (Q, 3)
    scaled = deviation.ravel()  # (3Q,)
    scores = form.modes @ scaled  # (R,)
    along = form.motions @ deviation  # (S, 3)
    explained = form.gains @ scores**2 + form.shares @ (along**2).sum(axis=1)
    return float(form.scale * (scaled @ scaled) - explained)


def form_product(form: QuadraticForm, shape: FloatArray) -> FloatArray:
    """Return ``W z`` (Q, 3) of a shape (Q, 3): half the derivative by z, the scaled deviation."""
    deviation = (shape - form.target) * form.root_weights[:, None]  # (Q, 3)
    scaled = deviation.ravel()  # (3Q,)
    product = form.scale * scaled - (form.gains * (form.modes @ scaled)) @ form.modes
    along = form.shares[:, None] * (form.motions @ deviation)  # (S, 3)
    shaped: FloatArray = product.reshape(-1, 3) - form.motions.T @ along
    return shaped


def no_motions(target: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the motions and shares of a form without any."""
    return np.zeros((0, len(target))), np.zeros(0)
