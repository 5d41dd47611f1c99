"""Whether and where shape depends on groups and covariates, by permutation over subjects."""

from ostiform.statistics.covariates import (
    Covariate,
    complete_subjects,
    covariate_of,
    subject_values,
)
from ostiform.statistics.design import Design, design_of, permutations
from ostiform.statistics.effect import (
    EffectSettings,
    ShapeEffect,
    normal_movement,
    point_normals,
    shape_effect,
)
from ostiform.statistics.false_discovery import adjusted_p_values
from ostiform.statistics.points import Movement, PointTest, point_test
from ostiform.statistics.scores import (
    ScoreTest,
    permutation_p_value,
    score_test,
    shrinkage_intensity,
)
from ostiform.statistics.units import SubjectShapes, subject_shapes

__all__ = [
    "Covariate",
    "Design",
    "EffectSettings",
    "Movement",
    "PointTest",
    "ScoreTest",
    "ShapeEffect",
    "SubjectShapes",
    "adjusted_p_values",
    "complete_subjects",
    "covariate_of",
    "design_of",
    "normal_movement",
    "permutation_p_value",
    "permutations",
    "point_normals",
    "point_test",
    "score_test",
    "shape_effect",
    "shrinkage_intensity",
    "subject_shapes",
    "subject_values",
]
