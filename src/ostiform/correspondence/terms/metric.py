"""The metric term: corresponding edges should be stretched alike everywhere in a shape.

Where points slide tangentially the description length sees little, and neither do maps made shape
by shape: the term compares shapes with their population instead. With len_ie the length of edge e
of the sampled shape i, it is ``strength * sum_e w_e (r_ie)^2``, r_ie the deviation of
``log len_ie`` from its mean over the shapes, less the mean of these deviations over the shape's
part: a part may grow or shrink at no cost. Near-isometry is the usual prior of correspondence
between deformable shapes.
"""

from dataclasses import dataclass

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.correspondence.state import Linearised, WarpState
from ostiform.correspondence.terms.metric_kernels import metric_system
from ostiform.correspondence.terms.term import System
from ostiform.domain import Template
from ostiform.surface import face_areas, unique_edges


@dataclass(frozen=True, slots=True, eq=False)
class MetricTerm:
    """What the edges of a shape are compared with.

    Attributes
    ----------
    edges : (E, 2) int64
    weights : (E,) float64
        Share of the area beside the edge, sum 1.
    part : (E,) int64
    reference : (E,) float64
        Mean over the shapes of the logarithms of their lengths.
    strength : float
    """

    edges: IntArray
    weights: FloatArray
    part: IntArray
    reference: FloatArray
    strength: float

    def value(self, state: WarpState, transform: FloatArray) -> float:
        """Return the term of a shape; rigid motion and size do not count."""
        if self.strength == 0.0:
            return 0.0
        residuals = metric_residuals(self, state.landmarks)
        return self.strength * float(self.weights @ residuals**2)

    def system(self, at: Linearised) -> System:
        """Return the term's gradient and Gauss-Newton matrix about a state."""
        if self.strength == 0.0:
            return System(np.zeros(len(at.basis)))
        gradient, matrix = metric_system(
            at.state.landmarks,
            self.edges,
            metric_residuals(self, at.state.landmarks),
            self.strength * self.weights,
            at.fields.starts,
            at.fields.fields,
            at.moved,
            len(at.basis),
        )
        return System(gradient, matrix)


def metric_term(template: Template, mean_shape: FloatArray, strength: float) -> MetricTerm:
    """Return the term of a template, its edges weighted by area on a mean shape (P, 3)."""
    edges, of_face = unique_edges(template.faces)[:2]
    areas = face_areas(mean_shape, template.faces)
    rows = np.asarray(of_face).reshape(-1)
    weights = np.bincount(rows, np.repeat(areas, 3), len(edges))
    part = np.zeros(len(edges), np.int64)
    part[rows] = np.repeat(template.face_part, 3)
    term = MetricTerm(edges, weights / weights.sum(), part, np.zeros(len(edges)), strength)
    return with_reference(term, mean_shape[None])


def with_reference(term: MetricTerm, shapes: FloatArray) -> MetricTerm:
    """Return the term with the mean logarithmic lengths of shapes (N, P, 3) as reference."""
    reference = np.mean([_log_lengths(term, shape) for shape in shapes], axis=0)
    return MetricTerm(term.edges, term.weights, term.part, reference, term.strength)


def metric_residuals(term: MetricTerm, shape: FloatArray) -> FloatArray:
    """Return the deviations r (E,) of a shape's logarithmic edge lengths."""
    deviation = _log_lengths(term, shape) - term.reference
    count = int(term.part.max(initial=0)) + 1
    totals = np.bincount(term.part, term.weights, count)
    means = np.bincount(term.part, term.weights * deviation, count) / np.where(
        totals > 0.0, totals, 1.0
    )
    residuals: FloatArray = deviation - means[term.part]
    return residuals


def _log_lengths(term: MetricTerm, shape: FloatArray) -> FloatArray:
    sides = shape[term.edges[:, 0]] - shape[term.edges[:, 1]]  # (E, 3)
    squares = np.einsum("ek,ek->e", sides, sides)
    logarithms: FloatArray = 0.5 * np.log(np.maximum(squares, np.finfo(float).tiny))
    return logarithms
