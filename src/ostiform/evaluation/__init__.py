"""The evidence that a model is good: how compact, general, specific and true it is."""

from ostiform.evaluation.classical import ClassicalMeasures, classical_measures
from ostiform.evaluation.clinical import (
    VolumeCurve,
    enclosed_volumes,
    part_volumes,
    volume_curves,
)
from ostiform.evaluation.collapse import signs_of_collapse
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
from ostiform.evaluation.dynamics import LEVELS, LevelResidues, level_residues
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
from ostiform.evaluation.generated import TruePopulation, true_population
from ostiform.evaluation.jackknife import (
    GainInterval,
    cumulative_variance_error,
    gain_interval,
)
from ostiform.evaluation.levels import (
    DynamicEvaluation,
    dynamic_evaluation_facts,
    evaluate_dynamic_model,
)
from ostiform.evaluation.measurements import (
    ClinicalTable,
    LongAxis,
    RimMeasures,
    clinical_measures,
    clinical_table,
    long_axes,
    rim_measures,
    twist_angles,
)
from ostiform.evaluation.pointwise import PointResidues, left_out_point_residues
from ostiform.evaluation.prediction import PredictionErrors, baseline_cycles, prediction_errors
from ostiform.evaluation.specificity import Specificity, model_specificity
from ostiform.evaluation.surface_specificity import SurfaceSpecificity, surface_specificity
from ostiform.evaluation.table import evaluation_rows, write_evaluation_table
from ostiform.evaluation.truth import MaterialMap, TruthDistance, distance_to_truth
from ostiform.evaluation.types import Evaluation
from ostiform.evaluation.variance import (
    DividedVariance,
    PopulationSpread,
    divided_variance,
    population_spread,
    surface_variance,
    weight_drift,
)

__all__ = [
    "LEVELS",
    "MEASURES",
    "MODE_COUNTS",
    "PAPER_GAINS",
    "ClassicalMeasures",
    "ClinicalTable",
    "Compactness",
    "Comparison",
    "Coverage",
    "Division",
    "DividedVariance",
    "DynamicEvaluation",
    "Evaluation",
    "Fold",
    "FoldResidues",
    "Folds",
    "GainInterval",
    "Generalisation",
    "LevelResidues",
    "LongAxis",
    "MaterialMap",
    "OriginalMesh",
    "PairedDifference",
    "PlacedFold",
    "PointResidues",
    "PopulationSpread",
    "PredictionErrors",
    "ResidueComparison",
    "Residues",
    "RimMeasures",
    "Specificity",
    "SurfaceDistance",
    "SurfaceSpecificity",
    "TruePopulation",
    "TruthDistance",
    "VolumeCurve",
    "classical_measures",
    "clinical_measures",
    "clinical_table",
    "compare",
    "comparison_facts",
    "cross_validated",
    "cross_validation_folds",
    "cumulative_variance_error",
    "distance_to_truth",
    "divided_variance",
    "dynamic_evaluation_facts",
    "enclosed_volumes",
    "evaluate_dynamic_model",
    "evaluate_model",
    "evaluation_facts",
    "evaluation_rows",
    "evaluation_from_facts",
    "fold_residues",
    "gain_interval",
    "left_out_point_residues",
    "level_residues",
    "long_axes",
    "model_compactness",
    "model_specificity",
    "paired_difference",
    "part_volumes",
    "population_spread",
    "baseline_cycles",
    "prediction_errors",
    "read_evaluation",
    "rim_measures",
    "shape_coverage",
    "shape_residues",
    "signs_of_collapse",
    "surface_distances",
    "surface_specificity",
    "surface_variance",
    "true_population",
    "twist_angles",
    "volume_curves",
    "weight_drift",
    "write_comparisons",
    "write_evaluation",
    "write_evaluation_table",
]
