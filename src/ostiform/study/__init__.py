"""Studies: settings, readers, naming of ostia, and the demonstration population."""

from ostiform.study.demonstration import (
    demonstration_truth,
    write_demonstration,
    write_population,
)
from ostiform.study.naming import LoopFacts, loop_facts, named_loops
from ostiform.study.reading import read_shape
from ostiform.study.settings import (
    CircleSettings,
    StudySettings,
    parsed_settings,
    read_settings,
)
from ostiform.study.shape import Shape, ShapeId
from ostiform.study.study import ShapeEntry, Study, natural_key, read_study
from ostiform.study.truth import Truth, material_coordinates, read_truth, true_positions

__all__ = [
    "CircleSettings",
    "LoopFacts",
    "Shape",
    "ShapeEntry",
    "ShapeId",
    "Study",
    "StudySettings",
    "Truth",
    "demonstration_truth",
    "loop_facts",
    "material_coordinates",
    "named_loops",
    "natural_key",
    "parsed_settings",
    "read_settings",
    "read_shape",
    "read_study",
    "read_truth",
    "true_positions",
    "write_demonstration",
    "write_population",
]
