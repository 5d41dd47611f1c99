"""Loops compiled by Numba, once on a machine: what one process has compiled the others load.

Without this every worker of a first run compiles every kernel, as all of them meet it at the same
time and none finds it on disk.
"""

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar, overload

from filelock import FileLock, Timeout
from numba import njit
from numba.core.caching import FunctionCache

Function = TypeVar("Function", bound=Callable[..., Any])

LOCK = "compiling"
"""The file among the kernels of a folder that is locked by who compiles one of them."""

PATIENCE_S = 60.0
"""How long another process may compile one before this one does so itself."""


@overload
def kernel(function: Function, /) -> Function: ...


@overload
def kernel(**options: Any) -> Callable[[Function], Function]: ...


def kernel(function: Any = None, /, **options: Any) -> Any:
    """Compile a function when it is first called, unless it is found compiled on disk.

    Parameters
    ----------
    function : callable
        Of numbers, arrays and tuples of them.
    **options
        Of `numba.njit`.
    """
    if function is None:
        return lambda own: kernel(own, **options)
    compiled = njit(**options)(function)
    compiled._cache = _SharedCache(function)
    return compiled


class _SharedCache(FunctionCache):  # type: ignore[misc]
    """Kernels on disk; the second process that misses one waits for the first to compile it."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call]
        self._lock = FileLock(Path(self.cache_path) / LOCK, is_singleton=True)  # kernels nest

    def load_overload(self, signature: Any, context: Any) -> Any:
        """Return a kernel from disk, or None: then this process is the one to compile it."""
        found = super().load_overload(signature, context)  # type: ignore[no-untyped-call]
        if found is None:
            with suppress(OSError, NotImplementedError, Timeout):  # then each compiles its own
                self._lock.acquire(timeout=PATIENCE_S, poll_interval=0.01)
                found = super().load_overload(signature, context)  # type: ignore[no-untyped-call]
                if found is not None:
                    self._lock.release()
        return found

    def save_overload(self, signature: Any, compiled: Any) -> None:
        """Keep a kernel on disk, for this and all other processes."""
        try:
            super().save_overload(signature, compiled)  # type: ignore[no-untyped-call]
        finally:
            self._lock.release()
