"""Values that travel between stages: the annotations of their fields say what they may hold.

A class under `value` is a frozen dataclass whose fields are checked and frozen once, when it is
made: arrays become read-only (float64, int64 or bool, finite, of the shape that `Axes` states),
mappings read-only, sequences tuples; numbers are held to `AtLeast` and `Above`, choices to
``Literal``. What annotations cannot say stays in ``__post_init__``, which runs afterwards.

::

    @value
    class Surface:
        vertices: Annotated[FloatArray, Axes("V", 3)]  # mm
        faces: Annotated[IntArray, Axes("F", 3), IndexOf("V")]
        loops: Mapping[str, Annotated[IntArray, Axes(None), IndexOf("V")]]
"""

import dataclasses
import types
from collections.abc import Callable, Iterator, Mapping
from functools import cache, partial
from typing import (
    Annotated,
    Any,
    Literal,
    TypeVar,
    Union,
    dataclass_transform,
    get_args,
    get_origin,
    get_type_hints,
    overload,
)

import numpy as np

from ostiform.arrays import frozen_array, frozen_mapping, shape_error
from ostiform.errors import InputError

C = TypeVar("C", bound=type)


@dataclasses.dataclass(frozen=True, slots=True, init=False)
class Axes:
    """How long the axes of an array are, or how many items a tuple or mapping has.

    A letter stands for one length in the whole value, None for any, ``...`` alone for any shape.
    On a field that is a value itself the letters are those which both share.

    Attributes
    ----------
    sizes : tuple of str, int or None; None for any shape
    gaps : bool
        Whether entries may be NaN (where there is no number to give).
    """

    sizes: tuple[str | int | None, ...] | None
    gaps: bool

    def __init__(self, *sizes: Any, gaps: bool = False) -> None:
        object.__setattr__(self, "sizes", None if sizes == (...,) else sizes)
        object.__setattr__(self, "gaps", gaps)


ANY_SHAPE = Axes(...)


@dataclasses.dataclass(frozen=True, slots=True)
class IndexOf:
    """That integers count places along an axis, from 0."""

    axis: str


@overload
def value(cls: C, /) -> C: ...


@overload
def value(*, eq: bool = False, kw_only: bool = False) -> Callable[[C], C]: ...


@dataclass_transform(frozen_default=True, eq_default=False)
def value(cls: Any = None, /, *, eq: bool = False, kw_only: bool = False) -> Any:
    """Make a class a frozen dataclass that checks and freezes its own fields.

    Parameters
    ----------
    cls : type
    eq : bool
        Whether values compare by their fields; not where they hold arrays.
    kw_only : bool
        As for dataclasses.
    """
    if cls is None:
        return partial(_made_value, eq=eq, kw_only=kw_only)
    return _made_value(cls, eq=eq, kw_only=kw_only)


def _made_value(cls: Any, *, eq: bool, kw_only: bool) -> Any:
    finish = cls.__dict__.get("__post_init__")

    def __post_init__(self: Any) -> None:  # noqa: N807
        settle(self)
        if finish is not None:
            finish(self)

    cls.__post_init__ = __post_init__
    return dataclasses.dataclass(frozen=True, slots=True, eq=eq, kw_only=kw_only)(cls)


@dataclasses.dataclass(frozen=True, slots=True)
class AtLeast:
    """That a number, or every one of an array, is finite and not below this."""

    least: float

    def holds(self, number: float) -> bool:
        """Whether a number keeps it."""
        return number >= self.least

    def __str__(self) -> str:
        """Return it in words."""
        return f"at least {self.least:g}"


@dataclasses.dataclass(frozen=True, slots=True)
class Above:
    """That a number, or every one of an array, is finite and greater than this."""

    bound: float

    def holds(self, number: float) -> bool:
        """Whether a number keeps it."""
        return number > self.bound

    def __str__(self) -> str:
        """Return it in words."""
        return f"a number above {self.bound:g}"


Sizes = dict[str, int]
Step = Callable[[Any, Sizes, str], Any]
"""Takes what a field was given, the axes known so far and its name; returns what it keeps."""
Check = Callable[[Any, Sizes, str], None]


def settle(self: Any) -> None:
    """Check the fields of a value that is being made, and freeze them.

    Raises
    ------
    InputError
        If a field is not what its annotation says, or the fields do not fit each other.
    """
    cls: Any = type(self)
    steps, checks = _plan(cls)
    sizes: Sizes = {}
    for name, shown, step in steps:
        given = getattr(self, name)
        kept = step(given, sizes, shown)
        if kept is not given:
            object.__setattr__(self, name, kept)
    for name, shown, check in checks:
        check(getattr(self, name), sizes, shown)


@cache
def type_hints(cls: type) -> dict[str, Any]:
    """Return the annotations of the fields that a dataclass is made from, by name and in order."""
    hints = get_type_hints(cls, include_extras=True)
    return {field.name: hints[field.name] for field in dataclasses.fields(cls) if field.init}


def dtype_of(hint: Any) -> Any:
    """Return the scalar type that an array's annotation names, `Any` for any."""
    return get_args(get_args(hint)[1])[0]


def unwrapped(hint: Any) -> tuple[Any, tuple[Any, ...]]:
    """Return a type without what ``Annotated`` adds to it, and what that is."""
    if get_origin(hint) is Annotated:
        plain, *added = get_args(hint)
        return plain, tuple(added)
    return hint, ()


def is_union(hint: Any) -> bool:
    """Whether an annotation allows several types."""
    return get_origin(hint) in (Union, types.UnionType)


@cache
def _plan(
    cls: type,
) -> tuple[tuple[tuple[str, str, Step], ...], tuple[tuple[str, str, Check], ...]]:
    """Return what is done to the fields of a class, and what is checked when all are known.

    What is named or held by others comes before arrays, which have to agree with it.
    """
    hints = sorted(type_hints(cls).items(), key=lambda item: _is_array(item[1]))
    found = [(name, name.replace("_", " "), *_step_and_check(hint)) for name, hint in hints]
    return (
        tuple((name, shown, step) for name, shown, step, _ in found if step is not None),
        tuple((name, shown, check) for name, shown, _, check in found if check is not None),
    )


def _is_array(hint: Any) -> bool:
    options = get_args(hint) if is_union(hint) else (hint,)
    return any(get_origin(unwrapped(option)[0]) is np.ndarray for option in options)


def _step_and_check(hint: Any) -> tuple[Step | None, Check | None]:
    step, check = _step_and_check_of_kind(hint)
    for bound in unwrapped(hint)[1]:
        if isinstance(bound, (AtLeast, Above)):
            step = _bounded(step, bound)
    return step, check


def _step_and_check_of_kind(hint: Any) -> tuple[Step | None, Check | None]:
    hint, added = unwrapped(hint)
    axes = next((one for one in added if isinstance(one, Axes)), None)
    index = next((one for one in added if isinstance(one, IndexOf)), None)
    origin = get_origin(hint)
    if origin is np.ndarray:
        check = None if index is None else _index_check(index.axis)
        return _array_step(dtype_of(hint), axes or ANY_SHAPE), check
    if origin is Literal:
        return _choice_step(get_args(hint)), None
    if origin is tuple and get_args(hint)[1:] == (...,):
        return _tuple_steps(get_args(hint)[0], axes)
    if origin is Mapping:
        return _mapping_steps(get_args(hint)[1], axes)
    if is_union(hint):
        return _optional_steps([one for one in get_args(hint) if one is not type(None)])
    if axes is not None:
        return _shared_axes_step(axes), None
    return None, None


def _bounded(own: Step | None, bound: AtLeast | Above) -> Step:
    def step(given: Any, known: Sizes, name: str) -> Any:
        kept = given if own is None else own(given, known, name)
        for number in np.ravel(kept):
            if not (bound.holds(number) and number < np.inf):
                raise InputError(f"{name}: expected {bound}, found {number:g}")
        return kept

    return step


def _choice_step(choices: tuple[Any, ...]) -> Step:
    def step(given: Any, known: Sizes, name: str) -> Any:
        if given not in choices:
            allowed = ", ".join(map(str, choices))
            raise InputError(f'{name}: expected one of {allowed}, found "{given}"')
        return given

    return step


def _array_step(dtype: Any, axes: Axes) -> Step:
    sizes, gaps = axes.sizes, axes.gaps

    def step(given: Any, known: Sizes, name: str) -> Any:
        array = frozen_array(given, dtype, name, gaps)
        if sizes is not None:
            wanted = [known.get(size, size) if type(size) is str else size for size in sizes]
            fits = array.ndim == len(sizes)
            for size, found in zip(wanted, array.shape, strict=False):
                if type(size) is str:
                    size = known.setdefault(size, found)
                fits = fits and (size is None or size == found)
            if not fits:
                raise shape_error(array, wanted, name)
        return array

    return step


def _count(items: Any, axes: Axes | None, known: Sizes, name: str) -> None:
    """Compare the number of items of a tuple or mapping with what is known of its axis."""
    if axes is not None and axes.sizes:
        axis = axes.sizes[0]
        wanted = known.setdefault(axis, len(items)) if isinstance(axis, str) else axis
        if wanted != len(items):
            raise InputError(f"{name}: expected {wanted} of them, found {len(items)}")


def _tuple_steps(hint: Any, axes: Axes | None) -> tuple[Step, Check | None]:
    own, check = _step_and_check(hint)

    def step(given: Any, known: Sizes, name: str) -> Any:
        items = given if type(given) is tuple else tuple(given)
        _count(items, axes, known, name)
        if own is None:
            return items
        kept = tuple(own(item, known, f"{name} {place}") for place, item in enumerate(items))
        return items if all(map(_is, kept, items)) else kept

    def check_items(kept: Any, known: Sizes, name: str) -> None:
        for place, item in enumerate(kept):
            check(item, known, f"{name} {place}")  # type: ignore[misc]

    return step, check and check_items


def _mapping_steps(hint: Any, axes: Axes | None) -> tuple[Step, Check | None]:
    own, check = _step_and_check(hint)

    def step(given: Any, known: Sizes, name: str) -> Any:
        _count(given, axes, known, name)
        if own is None:
            return frozen_mapping(given)
        kept = {key: own(item, known, f"{name} {key}") for key, item in given.items()}
        unchanged = all(map(_is, kept.values(), given.values()))
        return frozen_mapping(given if unchanged else kept)

    def check_items(kept: Any, known: Sizes, name: str) -> None:
        for key, item in kept.items():
            check(item, known, f"{name} {key}")  # type: ignore[misc]

    return step, check and check_items


def _optional_steps(options: list[Any]) -> tuple[Step | None, Check | None]:
    if len(options) > 1:  # which of several it is only the class can tell
        return None, None
    own, check = _step_and_check(options[0])

    def step(given: Any, known: Sizes, name: str) -> Any:
        return None if given is None else own(given, known, name)  # type: ignore[misc]

    def check_given(kept: Any, known: Sizes, name: str) -> None:
        if kept is not None:
            check(kept, known, name)  # type: ignore[misc]

    return own and step, check and check_given


def _shared_axes_step(axes: Axes) -> Step:
    letters = [one for one in axes.sizes or () if isinstance(one, str)]

    def step(given: Any, known: Sizes, name: str) -> Any:
        for letter in letters:
            found = axis_length(given, letter)
            wanted = known.setdefault(letter, found)
            if wanted != found:
                raise InputError(
                    f"{name}: expected {letter} = {wanted} as in the fields before, found {found}"
                )
        return given

    return step


def axis_length(value: Any, letter: str) -> int:
    """Return how long an axis of a value is, by its letter."""
    cls: Any = type(value)
    for field, place in _places_of_axis(cls, letter):
        held = getattr(value, field)
        if held is not None:
            if place is None:
                return axis_length(held, letter)
            return int(held.shape[place]) if isinstance(held, np.ndarray) else len(held)
    raise TypeError(f"{type(value).__name__} has no axis {letter}")


@cache
def _places_of_axis(cls: type, letter: str) -> tuple[tuple[str, int | None], ...]:
    return tuple(_axis_places(cls, letter))


def _axis_places(cls: type, letter: str) -> Iterator[tuple[str, int | None]]:
    for name, hint in type_hints(cls).items():
        options = get_args(hint) if is_union(hint) else (hint,)
        for option in options:
            plain, added = unwrapped(option)
            for axes in added:
                if isinstance(axes, Axes) and letter in (axes.sizes or ()):
                    is_nested = get_origin(plain) is None
                    yield name, None if is_nested else (axes.sizes or ()).index(letter)


def _index_check(axis: str) -> Check:
    def check(kept: Any, known: Sizes, name: str) -> None:
        # Read as unsigned, negative numbers are the largest.
        if kept.size and kept.view(np.uint64).max() >= known[axis]:
            raise InputError(
                f"{name}: expected indices from 0 to {known[axis] - 1}, "
                f"found {int(kept.min())} to {int(kept.max())}"
            )

    return check


def _is(first: Any, second: Any) -> bool:
    return first is second
