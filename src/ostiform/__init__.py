"""Ostiform: statistical shape models of surfaces with openings."""

__version__ = "0.1.0"
