"""Fold-free maps of open surfaces to the sphere (HY 2.1, 2.2)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
