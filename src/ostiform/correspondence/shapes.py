"""The shapes of a population, wherever they are kept, and one function over all of them.

The algorithms never hold a population's meshes: they hand a pure function of one shape to
`Shapes.each` and get back small values (landmarks, coefficients, directions), in the order of the
shapes. Sums over the shapes are taken from these, so a result does not depend on where, in how
many processes or in which order the function ran.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeAlias, TypeVar

from ostiform.arrays import FloatArray
from ostiform.correspondence.sampling import ShapeSampler, SurfaceMarks, sample
from ostiform.domain import Template

Item = TypeVar("Item")
Shared = TypeVar("Shared")
Result = TypeVar("Result")


class Shapes(Protocol):
    """N shapes prepared for sampling, in study order."""

    def __len__(self) -> int:
        """Return the number N of shapes."""

    def at(self, index: int) -> ShapeSampler:
        """Return one shape."""

    def chosen(self, indices: Sequence[int]) -> "Shapes":
        """Return some of the shapes, in the order given."""

    def each(
        self,
        function: Callable[[ShapeSampler, Item, Shared], Result],
        items: Sequence[Item],
        shared: Shared,
    ) -> list[Result]:
        """Return ``function(shape, item, shared)`` of every shape, in their order.

        Parameters
        ----------
        function : callable
            Pure, and importable by name: it may run in another process, more than once.
        items : sequence
            One per shape.
        shared : object
            What all shapes need alike.

        Raises
        ------
        OstiformError
            If the function fails for a shape.
        """


@dataclass(frozen=True, slots=True, eq=False)
class ShapesInMemory:
    """Shapes that this process holds, taken one after the other.

    Attributes
    ----------
    samplers : tuple of ShapeSampler
    """

    samplers: tuple[ShapeSampler, ...]

    def __len__(self) -> int:
        """Return the number of shapes."""
        return len(self.samplers)

    def at(self, index: int) -> ShapeSampler:
        """Return one shape."""
        return self.samplers[index]

    def chosen(self, indices: Sequence[int]) -> "ShapesInMemory":
        """Return some of the shapes, in the order given."""
        return ShapesInMemory(tuple(self.samplers[index] for index in indices))

    def each(
        self,
        function: Callable[[ShapeSampler, Item, Shared], Result],
        items: Sequence[Item],
        shared: Shared,
    ) -> list[Result]:
        """Return ``function(shape, item, shared)`` of every shape, in their order."""
        return [
            function(shape, item, shared) for shape, item in zip(self.samplers, items, strict=True)
        ]


GivenShapes: TypeAlias = Shapes | Sequence[ShapeSampler]
"""What the algorithms take: shapes kept somewhere, or a plain sequence of them in memory."""


def as_shapes(given: GivenShapes) -> Shapes:
    """Return shapes that are given either way as `Shapes`."""
    return ShapesInMemory(tuple(given)) if isinstance(given, Sequence) else given


def sampled(shape: ShapeSampler, directions: FloatArray, template: Template) -> FloatArray:
    """Return the positions (P, 3) of a template's points, moved to directions (P, 3), in mm."""
    return sample(shape, template, directions)


def marks_of(shape: ShapeSampler, _item: None, _shared: None) -> SurfaceMarks | None:
    """Return the user's landmarks of a shape."""
    return shape.marks
