"""Fitting a model to data it has never seen: surfaces, points, contours, landmarks."""

from ostiform.fitting.files import FileRules, TargetKind, read_named_points, read_targets
from ostiform.fitting.fit import fit_shape
from ostiform.fitting.leftover import (
    Leftover,
    LeftoverSource,
    estimated_leftover,
    leftover_of_spectrum,
)
from ostiform.fitting.posterior import shape_deviations
from ostiform.fitting.prior import FitPrior, fit_prior
from ostiform.fitting.results import fit_facts, write_fit
from ostiform.fitting.types import (
    CloudTarget,
    ContourTarget,
    FitSettings,
    FitStatus,
    LandmarkTarget,
    Pose,
    PoseKnowledge,
    Residue,
    Scaling,
    ShapeFit,
    SurfaceTarget,
    Target,
    Typicality,
)

__all__ = [
    "CloudTarget",
    "ContourTarget",
    "FileRules",
    "FitPrior",
    "FitSettings",
    "FitStatus",
    "LandmarkTarget",
    "Leftover",
    "LeftoverSource",
    "Pose",
    "PoseKnowledge",
    "Residue",
    "Scaling",
    "ShapeFit",
    "SurfaceTarget",
    "Target",
    "TargetKind",
    "Typicality",
    "estimated_leftover",
    "fit_facts",
    "fit_prior",
    "fit_shape",
    "leftover_of_spectrum",
    "read_named_points",
    "read_targets",
    "shape_deviations",
    "write_fit",
]
