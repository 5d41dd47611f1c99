"""The base domain: spheres, circles, seams, their layout, and the template (HY 2.1, 2.2)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
