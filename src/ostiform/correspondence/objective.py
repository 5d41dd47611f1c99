"""The one objective: what its terms are, and their sum.

A further term is a module of `terms` and a line of `shape_terms`.
"""

from collections.abc import Mapping, Sequence
from typing import TypeAlias

from ostiform.arrays import FloatArray
from ostiform.correspondence.level import WarpLevel
from ostiform.correspondence.sampling import SurfaceMarks
from ostiform.correspondence.state import Linearised, WarpState
from ostiform.correspondence.terms.crowding import Crowding
from ostiform.correspondence.terms.landmarks import landmark_term
from ostiform.correspondence.terms.metric import MetricTerm
from ostiform.correspondence.terms.term import System, Term, summed

Terms: TypeAlias = Mapping[str, Term]


def shape_terms(
    forms: Terms, level: WarpLevel, metric: MetricTerm, own: SurfaceMarks | None
) -> Terms:
    """Return the terms of one shape, by name.

    Parameters
    ----------
    forms : mapping of str to Term
        What the population asks of the shape: ``distance`` at level 1, ``length`` and
        ``coherence`` after.
    level : WarpLevel
    metric : MetricTerm
        The level's, with the reference of the time.
    own : SurfaceMarks or None
        Landmarks of the shape.
    """
    landmarks = landmark_term(level.marks, own)
    return {
        **forms,
        "metric": metric,
        "displacement": level.displacement,
        "crowding": Crowding(level.template),
        **({} if landmarks is None else {"landmarks": landmarks}),
    }


def values(terms: Terms, state: WarpState, transform: FloatArray) -> dict[str, float]:
    """Return every term of a shape that a transform (4, 4) aligns."""
    return {name: term.value(state, transform) for name, term in terms.items()}


def value(terms: Terms, state: WarpState, transform: FloatArray) -> float:
    """Return the objective of a shape: the sum of its terms."""
    return sum(values(terms, state, transform).values())


def system(terms: Terms, at: Linearised) -> System:
    """Return the Gauss-Newton system of a shape: the sum of those of its terms."""
    return summed(term.system(at) for term in terms.values())


def population_values(
    terms: Sequence[Terms], states: Sequence[WarpState], transforms: FloatArray
) -> dict[str, float]:
    """Return every term summed over the shapes and divided by N - 1, as it goes with F."""
    totals: dict[str, float] = {}
    for own, state, transform in zip(terms, states, transforms, strict=True):
        for name, found in values(own, state, transform).items():
            totals[name] = totals.get(name, 0.0) + found
    return {name: total / max(len(states) - 1, 1) for name, total in totals.items()}
