"""Whether and where shape depends on groups and covariates, by permutation over subjects."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
