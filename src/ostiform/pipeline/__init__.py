"""From a study to an output folder: the stages, resumed and skipped by what they depend on."""

from ostiform.pipeline.build import Stage, Summary, build_study
from ostiform.pipeline.events import Event, Note, Progress, Warn

__all__ = ["Event", "Note", "Progress", "Stage", "Summary", "Warn", "build_study"]
