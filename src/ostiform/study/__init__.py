"""Studies: settings, readers, naming of ostia, and the demonstration population."""

from ostiform.study.demonstration import (
    demonstration_truth,
    write_demonstration,
    write_population,
)
from ostiform.study.naming import LoopFacts, loop_facts, named_loops
from ostiform.study.population import PopulationNames, ShapeNames, named_population
from ostiform.study.proposal import proposed_study
from ostiform.study.reading import part_facts, read_shape, survey_shape
from ostiform.study.settings import (
    CircleSettings,
    StudySettings,
    parsed_settings,
    read_settings,
)
from ostiform.study.shape import Shape, ShapeId
from ostiform.study.study import ShapeEntry, Study, natural_key, read_study
from ostiform.study.survey import ShapeSurvey, survey_from_json, survey_to_json
from ostiform.study.truth import Truth, material_coordinates, read_truth, true_positions

__all__ = [
    "CircleSettings",
    "LoopFacts",
    "PopulationNames",
    "Shape",
    "ShapeEntry",
    "ShapeId",
    "ShapeNames",
    "ShapeSurvey",
    "Study",
    "StudySettings",
    "Truth",
    "demonstration_truth",
    "loop_facts",
    "material_coordinates",
    "named_loops",
    "named_population",
    "natural_key",
    "parsed_settings",
    "part_facts",
    "proposed_study",
    "read_settings",
    "read_shape",
    "read_study",
    "survey_from_json",
    "survey_shape",
    "survey_to_json",
    "read_truth",
    "true_positions",
    "write_demonstration",
    "write_population",
]
