"""Checked, read-only arrays: what the frozen values that travel between stages hold."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ostiform.errors import InputError

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.int64]
BoolArray: TypeAlias = NDArray[np.bool_]

K = TypeVar("K")
Numbers = TypeVar("Numbers", bound=np.generic)
T = TypeVar("T")


def frozen_floats(values: ArrayLike, shape: tuple[int | None, ...], name: str) -> FloatArray:
    """Return finite values as a read-only C-contiguous float64 array of a given shape.

    Parameters
    ----------
    values : array_like
        The values; copied unless they are already a read-only float64 array.
    shape : tuple of int or None
        The expected shape; ``None`` where any length will do.
    name : str
        What the array is, for the error message.

    Raises
    ------
    InputError
        If the shape differs or a value is not finite.
    """
    array: FloatArray = _of_shape(frozen_array(values, np.float64, name, True), shape, name)
    _check_finite(array, name)
    return array


def frozen_ints(values: ArrayLike, shape: tuple[int | None, ...], name: str) -> IntArray:
    """Return values as a read-only C-contiguous int64 array of a given shape.

    Parameters and errors are those of `frozen_floats`.
    """
    array: IntArray = _of_shape(frozen_array(values, np.int64, name), shape, name)
    return array


def frozen_array(values: ArrayLike, dtype: Any, name: str, gaps: bool = False) -> Any:
    """Return values as a read-only C-contiguous array of any shape.

    Parameters
    ----------
    values : array_like
        Copied unless they are already a read-only array of that type.
    dtype : type
        A numpy scalar type; `Any` to keep the type that they have.
    name : str
        What the array is, for the error message.
    gaps : bool
        Whether NaN and infinite numbers are allowed.

    Raises
    ------
    InputError
        If a number is not finite.
    """
    array = np.asarray(values)
    wanted = array.dtype if dtype is Any else dtype
    if array.dtype != wanted or array.flags.writeable or not array.flags.c_contiguous:
        array = np.array(array, dtype=wanted, order="C")
        array.flags.writeable = False
    if not gaps and array.dtype.kind == "f":
        _check_finite(array, name)
    return array


def read_only(array: NDArray[Numbers]) -> NDArray[Numbers]:
    """Return a contiguous view that cannot be written through (a copy if it was not contiguous).

    A kernel is compiled for every type it meets, and whether an array may be written to is part of
    the type: given every input so, it is compiled once.
    """
    view = np.ascontiguousarray(array).view()
    view.flags.writeable = False
    return view


def shape_error(array: NDArray[Any], shape: Sequence[int | str | None], name: str) -> InputError:
    """Return the error for an array of another shape than expected; None is any length."""
    wanted = ", ".join("any" if n is None else str(n) for n in shape)
    return InputError(f"{name}: expected an array of shape ({wanted}), found {array.shape}")


def frozen_mapping(items: Mapping[K, T]) -> Mapping[K, T]:
    """Return a read-only copy of a mapping, in the same order."""
    return items if isinstance(items, _FrozenMapping) else _FrozenMapping(items)


class _FrozenMapping(Mapping[K, T]):
    """A mapping without a way to change it, which travels between processes."""

    __slots__ = ("_items",)

    def __init__(self, items: Mapping[K, T]) -> None:
        self._items = dict(items)

    def __getitem__(self, key: K) -> T:
        return self._items[key]

    def __iter__(self) -> Iterator[K]:
        return iter(self._items)

    def __len__(self) -> int:
        return len(self._items)

    def __repr__(self) -> str:
        return repr(self._items)


def _of_shape(array: Any, shape: tuple[int | None, ...], name: str) -> Any:
    fits = array.ndim == len(shape) and all(
        expected is None or found == expected
        for found, expected in zip(array.shape, shape, strict=True)
    )
    if not fits:
        raise shape_error(array, shape, name)
    return array


def _check_finite(array: FloatArray, name: str) -> None:
    if not np.isfinite(array).all():
        bad = np.argwhere(~np.isfinite(array))
        raise InputError(
            f"{name}: expected finite numbers, found {len(bad)} that are NaN or infinite, "
            f"the first at index {tuple(int(i) for i in bad[0])}"
        )
