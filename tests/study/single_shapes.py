"""A shape of a study read alone, as a build reads it in a study of one shape."""

from ostiform.errors import InputError
from ostiform.study import (
    Shape,
    ShapeEntry,
    ShapeNames,
    Study,
    named_population,
    named_shape,
    opened_shape,
    shape_survey,
)


def read_shape(study: Study, entry: ShapeEntry, names: ShapeNames | None = None) -> Shape:
    opened = opened_shape(study, entry)
    if names is None:
        found = named_population(study.settings, [shape_survey(opened)])
        if entry.id in found.problems:
            raise InputError(f"shape {entry.id}: {found.problems[entry.id]}")
        names = found.names[entry.id]
    return named_shape(study.settings, opened, names)
