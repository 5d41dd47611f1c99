"""A finished model, frozen: what places shapes that it was not built from."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

from ostiform.arrays import FloatArray
from ostiform.correspondence.fields import FieldBasis
from ostiform.correspondence.terms.landmarks import TemplateMarks
from ostiform.correspondence.terms.metric import MetricTerm
from ostiform.correspondence.terms.quadratic_form import QuadraticForm
from ostiform.domain import Template
from ostiform.study import AlignmentMode, ShapeId
from ostiform.values import Axes, value


@dataclass(frozen=True, slots=True, eq=False)
class FrozenLevel:
    """One level through which a further shape's warp is composed.

    Attributes
    ----------
    basis : FieldBasis
        D fields: those that the run optimised with.
    forms : mapping of str to QuadraticForm
        What a further shape minimises at the Q optimiser's points beside the other terms:
        ``distance`` to the mean at level 1, ``length`` and ``coherence`` after.
    """

    basis: FieldBasis
    forms: Mapping[str, QuadraticForm]


@value
class FrozenModel:
    """What places further shapes in a correspondence, as its run left it.

    Attributes
    ----------
    template : Template
    n_optimised : int
        The Q optimiser's points are its coarsest level with at least so many points.
    weights : (P,) float64
        Of the template's points, sum 1.
    mean : (P, 3) float64, mm
        Of the aligned shapes.
    coarse_weights : (Q,) float64
    stretch, offset : float
        See `displacement.displacement_penalty`.
    metric : MetricTerm
        Referred to the aligned shapes.
    marks : TemplateMarks or None
        Where the users' landmarks lie among the Q points.
    alignment : {"rigid", "similarity", "none"}
    jointly : bool
        Whether the phases of a subject share one transform.
    ids : tuple of ShapeId
        N shapes of the model.
    transforms : (N, 4, 4) float64
        From their input to aligned coordinates.
    levels : tuple of FrozenLevel
        All that the run went through, repeated ones too; empty for the conformal kind.
    """

    template: Annotated[Template, Axes("P")]
    n_optimised: int
    weights: Annotated[FloatArray, Axes("P")]
    mean: Annotated[FloatArray, Axes("P", 3)]
    coarse_weights: Annotated[FloatArray, Axes(None)]
    stretch: float
    offset: float
    metric: MetricTerm
    marks: TemplateMarks | None
    alignment: AlignmentMode
    jointly: bool
    ids: Annotated[tuple[ShapeId, ...], Axes("N")]
    transforms: Annotated[FloatArray, Axes("N", 4, 4)]
    levels: tuple[FrozenLevel, ...]

    def transform_of(self, subject: str) -> FloatArray | None:
        """Return the transform (4, 4) of a subject that has phases in the model; None elsewhere.

        A fit to further phases alone would align motion away.
        """
        if self.jointly:
            for id, transform in zip(self.ids, self.transforms, strict=True):
                if id.subject == subject:
                    known: FloatArray = transform
                    return known
        return None
