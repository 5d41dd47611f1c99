"""Fold-free maps of open surfaces to the sphere (HY 2.1, 2.2)."""

from ostiform.embedding.types import (
    Certificate,
    Distortion,
    Embedding,
    EmbeddingState,
    SeamJump,
)

__all__ = ["Certificate", "Distortion", "Embedding", "EmbeddingState", "SeamJump"]
