"""What all shapes share while the sweeps of one level go on."""

from dataclasses import dataclass

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.correspondence.fields import FieldBasis
from ostiform.correspondence.terms.displacement import DisplacementPenalty, displacement_penalty
from ostiform.correspondence.terms.landmarks import TemplateMarks
from ostiform.correspondence.terms.metric import MetricTerm
from ostiform.domain import Template


@dataclass(frozen=True, slots=True, eq=False)
class WarpLevel:
    """What the shapes share during the sweeps of one level.

    Attributes
    ----------
    template : Template
        All P points: they are carried along and kept free of turned triangles.
    coarse : Template
        The Q points at which the objective is evaluated.
    index : (Q,) int64
        Their indices in `template`.
    basis : FieldBasis
        D fields.
    displacement : DisplacementPenalty
        On the Q points.
    metric : MetricTerm
        Its reference is the mean of the conformal sampling; sweeps bring it up to date.
    marks : TemplateMarks or None
        Where the users' landmarks lie.
    """

    template: Template
    coarse: Template
    index: IntArray
    basis: FieldBasis
    displacement: DisplacementPenalty
    metric: MetricTerm
    marks: TemplateMarks | None = None


def warp_level(
    template: Template,
    least: int,
    weights: FloatArray,
    basis: FieldBasis,
    strengths: tuple[float, float],
    metric: MetricTerm,
    marks: TemplateMarks | None = None,
) -> WarpLevel:
    """Return the shared values of a level.

    Parameters
    ----------
    template : Template
    least : int
        Points at which the objective is evaluated, see `coarse_template`.
    weights : (Q,) float64
        Of these.
    basis : FieldBasis
    strengths : (float, float)
        See `displacement_penalty`.
    metric : MetricTerm
    marks : TemplateMarks, optional
    """
    coarse, index = coarse_template(template, least)
    displacement = displacement_penalty(coarse, index, weights, strengths, basis)
    return WarpLevel(template, coarse, index, basis, displacement, metric, marks)


def coarse_template(template: Template, least: int) -> tuple[Template, IntArray]:
    """Return the coarsest level of a template with at least so many points, and their indices.

    The whole template where no level has as many.
    """
    for level in template.levels:
        if least <= len(level.index) < len(template.points):
            index = level.index
            coarse = Template(
                points=template.points[index],
                sphere=template.sphere[index],
                part=template.part[index],
                faces=level.faces,
                face_part=level.face_part,
                parts=template.parts,
                curve=template.curve[index],
                curves=template.curves,
                loops={},
            )
            return coarse, index
    return template, np.arange(len(template.points))
