"""From a study to an output folder: the stages, resumed and skipped by what they depend on."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
