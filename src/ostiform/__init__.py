"""Ostiform: statistical shape models of surfaces with openings."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ostiform.api import (
        Results,
        Stage,
        build,
        example_results,
        example_study,
        figures,
        read_model,
        read_results,
        read_study,
    )

__version__ = "0.2.0.dev0"

__all__ = [
    "Results",
    "Stage",
    "__version__",
    "build",
    "example_results",
    "example_study",
    "figures",
    "read_model",
    "read_results",
    "read_study",
]


def __getattr__(name: str) -> Any:
    """Import the numerical libraries when a name of `ostiform.api` is first used."""
    if name not in __all__:
        raise AttributeError(f"module 'ostiform' has no attribute {name!r}")
    import warnings

    from ostiform import api
    from ostiform.kernel_cache import kernels_kept

    if note := kernels_kept():
        warnings.warn(note, stacklevel=2)
    return getattr(api, name)


def __dir__() -> list[str]:
    """Return the public names, before any of them is imported."""
    return sorted(__all__)
