"""Correspondence by warps of the sphere that minimise the description length (HY 2.3)."""

from ostiform.correspondence.types import Correspondence

__all__ = ["Correspondence"]
