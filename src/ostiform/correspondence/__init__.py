"""Correspondence by warps of the sphere that minimise the description length (HY 2.3)."""

from ostiform.correspondence.build import build_yardstick, correspond
from ostiform.correspondence.finished import trained_from
from ostiform.correspondence.place import Placed, place
from ostiform.correspondence.population_template import (
    TemplateCoverage,
    mean_surface,
    population_template,
    template_coverage,
)
from ostiform.correspondence.sampling import (
    ShapeSampler,
    SurfaceMarks,
    pull_back,
    sample,
    sample_with_derivative,
    sampler,
)
from ostiform.correspondence.settings import CorrespondenceSettings
from ostiform.correspondence.shape_step import WarpState
from ostiform.correspondence.shapes import Shapes, ShapesInMemory
from ostiform.correspondence.streamed_spectrum import (
    StrongSpectrum,
    streamed_length,
    streamed_spectrum,
)
from ostiform.correspondence.sweeps import LevelState, LevelStatus, Population, SweepRecord
from ostiform.correspondence.trained import KINDS, Kind, TrainedCorrespondence, Yardstick
from ostiform.correspondence.types import Correspondence

__all__ = [
    "Correspondence",
    "CorrespondenceSettings",
    "KINDS",
    "Kind",
    "LevelState",
    "LevelStatus",
    "Population",
    "Placed",
    "ShapeSampler",
    "Shapes",
    "ShapesInMemory",
    "StrongSpectrum",
    "SurfaceMarks",
    "SweepRecord",
    "TemplateCoverage",
    "TrainedCorrespondence",
    "WarpState",
    "Yardstick",
    "build_yardstick",
    "correspond",
    "mean_surface",
    "place",
    "population_template",
    "pull_back",
    "sample",
    "sample_with_derivative",
    "sampler",
    "streamed_length",
    "streamed_spectrum",
    "template_coverage",
    "trained_from",
]
