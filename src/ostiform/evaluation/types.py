"""The evidence about one model, gathered."""

from typing import Annotated

from ostiform.evaluation.classical import ClassicalMeasures
from ostiform.evaluation.compactness import Compactness
from ostiform.evaluation.coverage import Coverage
from ostiform.evaluation.generalisation import Generalisation
from ostiform.evaluation.specificity import Specificity
from ostiform.evaluation.specificity_to_surface import SurfaceSpecificity
from ostiform.evaluation.truth import TruthDistance
from ostiform.evaluation.variance import PopulationSpread
from ostiform.study import ShapeId
from ostiform.values import Axes, value


@value
class Evaluation:
    """How good one model of a population is.

    Attributes
    ----------
    kind : str
        ``"conformal"``, ``"euclidean"`` or ``"optimal"``.
    ids : tuple of ShapeId
        The N shapes.
    compactness : Compactness
    description_length : float
        On the shared metric that the models of a comparison share.
    l_cut : float, mm^2
        Of that shared metric.
    specificity : Specificity
    coverage : tuple of Coverage
        Of each shape.
    generalisation : Generalisation or None
        None where there are too few shapes to leave some out.
    truth : TruthDistance or None
        None where the true correspondence is not known.
    spread : PopulationSpread or None
        None where it was not measured.
    surface_specificity : SurfaceSpecificity or None
        None where the original surfaces are not known.
    classical : ClassicalMeasures or None
        None where there are too few shapes.
    """

    kind: str
    ids: Annotated[tuple[ShapeId, ...], Axes("N")]
    compactness: Compactness
    description_length: float
    l_cut: float
    specificity: Specificity
    coverage: Annotated[tuple[Coverage, ...], Axes("N")]
    generalisation: Annotated[Generalisation, Axes("N")] | None
    truth: TruthDistance | None
    spread: PopulationSpread | None = None
    surface_specificity: SurfaceSpecificity | None = None
    classical: ClassicalMeasures | None = None
