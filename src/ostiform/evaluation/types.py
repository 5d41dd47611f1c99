"""The evidence about one model, gathered."""

from dataclasses import dataclass

from ostiform.errors import InputError
from ostiform.evaluation.classical import ClassicalMeasures
from ostiform.evaluation.compactness import Compactness
from ostiform.evaluation.coverage import Coverage
from ostiform.evaluation.generalisation import Generalisation
from ostiform.evaluation.specificity import Specificity
from ostiform.evaluation.specificity_to_surface import SurfaceSpecificity
from ostiform.evaluation.truth import TruthDistance
from ostiform.evaluation.variance import PopulationSpread
from ostiform.study import ShapeId


@dataclass(frozen=True, slots=True, eq=False)
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
        None in evaluations of earlier versions.
    surface_specificity : SurfaceSpecificity or None
        None where the original surfaces are not known.
    classical : ClassicalMeasures or None
        None where there are too few shapes.
    """

    kind: str
    ids: tuple[ShapeId, ...]
    compactness: Compactness
    description_length: float
    l_cut: float
    specificity: Specificity
    coverage: tuple[Coverage, ...]
    generalisation: Generalisation | None
    truth: TruthDistance | None
    spread: PopulationSpread | None = None
    surface_specificity: SurfaceSpecificity | None = None
    classical: ClassicalMeasures | None = None

    def __post_init__(self) -> None:
        """Check that everything is about the same shapes."""
        counts = {"coverage": len(self.coverage)}
        if self.generalisation is not None:
            counts["generalisation"] = len(self.generalisation.point)
        for name, count in counts.items():
            if count != len(self.ids):
                raise InputError(
                    f"evaluation of the {self.kind} model: expected {name} of {len(self.ids)} "
                    f"shapes, found {count}"
                )
