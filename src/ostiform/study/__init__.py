"""Studies: settings, readers, naming of ostia, and the demonstration population."""

from ostiform.study.shape import Shape, ShapeId

__all__ = ["Shape", "ShapeId"]
