"""The evidence that a model is good: how compact, general, specific and true it is."""

from ostiform.evaluation.compactness import Compactness, model_compactness
from ostiform.evaluation.comparison import (
    PAPER_GAINS,
    Comparison,
    PairedDifference,
    ResidueComparison,
    compare,
    paired_difference,
)
from ostiform.evaluation.coverage import Coverage, shape_coverage
from ostiform.evaluation.distances import SurfaceDistance, surface_distances
from ostiform.evaluation.dynamics import LevelResidues, level_residues
from ostiform.evaluation.evaluate import evaluate_model
from ostiform.evaluation.files import (
    comparison_facts,
    evaluation_facts,
    evaluation_from_facts,
    read_evaluation,
    write_comparisons,
    write_evaluation,
)
from ostiform.evaluation.folds import Division, Fold, Folds, cross_validation_folds
from ostiform.evaluation.generalisation import (
    MEASURES,
    MODE_COUNTS,
    FoldResidues,
    Generalisation,
    OriginalMesh,
    PlacedFold,
    Residues,
    cross_validated,
    fold_residues,
    shape_residues,
)
from ostiform.evaluation.specificity import Specificity, model_specificity
from ostiform.evaluation.truth import MaterialMap, TruthDistance, distance_to_truth
from ostiform.evaluation.types import Evaluation

__all__ = [
    "MEASURES",
    "MODE_COUNTS",
    "PAPER_GAINS",
    "Compactness",
    "Comparison",
    "Coverage",
    "Division",
    "Evaluation",
    "Fold",
    "FoldResidues",
    "Folds",
    "Generalisation",
    "LevelResidues",
    "MaterialMap",
    "OriginalMesh",
    "PairedDifference",
    "PlacedFold",
    "ResidueComparison",
    "Residues",
    "Specificity",
    "SurfaceDistance",
    "TruthDistance",
    "compare",
    "comparison_facts",
    "cross_validated",
    "cross_validation_folds",
    "distance_to_truth",
    "evaluate_model",
    "evaluation_facts",
    "evaluation_from_facts",
    "fold_residues",
    "level_residues",
    "model_compactness",
    "model_specificity",
    "paired_difference",
    "read_evaluation",
    "shape_coverage",
    "shape_residues",
    "surface_distances",
    "write_comparisons",
    "write_evaluation",
]
