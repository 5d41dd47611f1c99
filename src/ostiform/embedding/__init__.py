"""Fold-free maps of open surfaces to the sphere (HY 2.1, 2.2)."""

from ostiform.embedding.certificate import certify, population_problems
from ostiform.embedding.conformal import conformal_holes
from ostiform.embedding.distortion import angle_distortion, area_shares, measure_distortion
from ostiform.embedding.embed import embed
from ostiform.embedding.fixed_circle_tutte import (
    PlanarChart,
    arc_length_images,
    fixed_circle_charts,
    natural_rotations,
    on_sphere,
)
from ostiform.embedding.harmonic import (
    HarmonicResult,
    HarmonicStatus,
    fold_explanations,
    folds_by_circle_ratio,
    harmonic_map,
    widest_harmonic_circle,
)
from ostiform.embedding.maxmin import MaxMinResult, MaxMinStatus, untangled_by_area
from ostiform.embedding.paper import (
    PaperEmbedding,
    PaperSettings,
    harmonic_embedding,
    paper_states,
)
from ostiform.embedding.seam_jump import loop_near_circle, one_sided_derivatives, seam_jump
from ostiform.embedding.settings import EmbeddingSettings
from ostiform.embedding.smoothing import (
    SmoothingResult,
    smoothed_where_better,
    triangle_qualities,
)
from ostiform.embedding.twist import measured_twists
from ostiform.embedding.types import (
    Certificate,
    Distortion,
    Embedding,
    EmbeddingState,
    SeamJump,
)

__all__ = [
    "Certificate",
    "Distortion",
    "Embedding",
    "EmbeddingSettings",
    "EmbeddingState",
    "HarmonicResult",
    "HarmonicStatus",
    "MaxMinResult",
    "MaxMinStatus",
    "PaperEmbedding",
    "PaperSettings",
    "PlanarChart",
    "SeamJump",
    "SmoothingResult",
    "angle_distortion",
    "arc_length_images",
    "area_shares",
    "certify",
    "conformal_holes",
    "embed",
    "fixed_circle_charts",
    "fold_explanations",
    "folds_by_circle_ratio",
    "harmonic_embedding",
    "harmonic_map",
    "loop_near_circle",
    "measure_distortion",
    "measured_twists",
    "natural_rotations",
    "on_sphere",
    "one_sided_derivatives",
    "paper_states",
    "population_problems",
    "seam_jump",
    "smoothed_where_better",
    "triangle_qualities",
    "untangled_by_area",
    "widest_harmonic_circle",
]
