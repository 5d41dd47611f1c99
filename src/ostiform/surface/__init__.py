"""Triangulated surfaces with openings: topology, operators, queries, repair."""

from ostiform.surface.types import Component, Seam, Surface

__all__ = ["Component", "Seam", "Surface"]
