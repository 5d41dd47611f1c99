"""Studies: settings, readers of surfaces and label maps, and the naming of ostia."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
