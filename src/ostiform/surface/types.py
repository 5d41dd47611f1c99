"""Surfaces with openings, and the components that seams join them into."""

from collections.abc import Mapping
from dataclasses import dataclass

from ostiform.arrays import FloatArray, IntArray, frozen_floats, frozen_ints, frozen_mapping
from ostiform.errors import InputError


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """A triangulated surface with named openings (ostia).

    Attributes
    ----------
    vertices : (V, 3) float64, mm
        Positions in the internal LPS frame.
    faces : (F, 3) int64
        Vertex indices, counter-clockwise seen from outside.
    loops : mapping of str to (n,) int64
        Vertex indices of each ostium's boundary loop, in order, the surface on the left seen
        from outside (the direction of the half-edges of the faces at the loop).
    """

    vertices: FloatArray
    faces: IntArray
    loops: Mapping[str, IntArray]

    def __post_init__(self) -> None:
        """Check the arrays and make them read-only."""
        object.__setattr__(self, "vertices", frozen_floats(self.vertices, (None, 3), "vertices"))
        object.__setattr__(self, "faces", frozen_ints(self.faces, (None, 3), "faces"))
        object.__setattr__(self, "loops", _frozen_loops(self.loops))
        _check_indices(self.faces, len(self.vertices), "faces")
        for name, loop in self.loops.items():
            _check_indices(loop, len(self.vertices), f"loop {name}")


@dataclass(frozen=True, slots=True, order=True)
class Seam:
    """Two ostia that are one curve, written ``"PART.OSTIUM"``.

    On the component sphere the part of `first` lies outside the seam's circle (z < 0 for a
    single seam, whose circle is the equator) and the part of `second` inside it (z > 0). The two
    ostia of a seam may belong to the same part (a handle).
    """

    first: str
    second: str


@dataclass(frozen=True, slots=True, eq=False)
class Component:
    """Parts joined by seams into one connected mesh, the unit of all computation on a sphere.

    Attributes
    ----------
    name : str
        The names of its parts joined by ``+``.
    parts : tuple of str
        The parts, in study order.
    vertices : (V, 3) float64, mm
    faces : (F, 3) int64
        Counter-clockwise seen from outside.
    face_part : (F,) int64
        Index into `parts` of the part each face belongs to.
    rims : mapping of str to (n,) int64
        The boundary loops that stay open, by full name (``"LA.RSPV"``), surface on the left.
    seams : mapping of Seam to (n,) int64
        The inner curves along which parts meet, the part of `Seam.second` on the left.
    """

    name: str
    parts: tuple[str, ...]
    vertices: FloatArray
    faces: IntArray
    face_part: IntArray
    rims: Mapping[str, IntArray]
    seams: Mapping[Seam, IntArray]

    def __post_init__(self) -> None:
        """Check the arrays and make them read-only."""
        object.__setattr__(self, "vertices", frozen_floats(self.vertices, (None, 3), "vertices"))
        object.__setattr__(self, "faces", frozen_ints(self.faces, (None, 3), "faces"))
        object.__setattr__(
            self, "face_part", frozen_ints(self.face_part, (len(self.faces),), "face_part")
        )
        object.__setattr__(self, "rims", _frozen_loops(self.rims))
        object.__setattr__(
            self,
            "seams",
            frozen_mapping(
                {
                    seam: frozen_ints(loop, (None,), f"seam {seam.first} = {seam.second}")
                    for seam, loop in self.seams.items()
                }
            ),
        )
        _check_indices(self.faces, len(self.vertices), "faces")
        _check_indices(self.face_part, len(self.parts), "face_part")
        for curve in (*self.rims.values(), *self.seams.values()):
            _check_indices(curve, len(self.vertices), "loops")


def _frozen_loops(loops: Mapping[str, IntArray]) -> Mapping[str, IntArray]:
    return frozen_mapping(
        {name: frozen_ints(loop, (None,), f"loop {name}") for name, loop in loops.items()}
    )


def _check_indices(indices: IntArray, count: int, name: str) -> None:
    if indices.size and (indices.min() < 0 or indices.max() >= count):
        raise InputError(
            f"{name}: expected indices from 0 to {count - 1}, "
            f"found {int(indices.min())} to {int(indices.max())}"
        )
