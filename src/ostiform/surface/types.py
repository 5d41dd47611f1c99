"""Surfaces with openings, and the components that seams join them into."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

from ostiform.arrays import FloatArray, IntArray
from ostiform.values import Axes, IndexOf, value


@value
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

    vertices: Annotated[FloatArray, Axes("V", 3)]
    faces: Annotated[IntArray, Axes("F", 3), IndexOf("V")]
    loops: Mapping[str, Annotated[IntArray, Axes(None), IndexOf("V")]]


@dataclass(frozen=True, slots=True, order=True)
class Seam:
    """Two ostia that are one curve, written ``"PART.OSTIUM"``.

    On the component sphere the part of `first` lies outside the seam's circle (z < 0 for a
    single seam, whose circle is the equator) and the part of `second` inside it (z > 0). The two
    ostia of a seam may belong to the same part (a handle).
    """

    first: str
    second: str


@value
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
    parts: Annotated[tuple[str, ...], Axes("parts")]
    vertices: Annotated[FloatArray, Axes("V", 3)]
    faces: Annotated[IntArray, Axes("F", 3), IndexOf("V")]
    face_part: Annotated[IntArray, Axes("F"), IndexOf("parts")]
    rims: Mapping[str, Annotated[IntArray, Axes(None), IndexOf("V")]]
    seams: Mapping[Seam, Annotated[IntArray, Axes(None), IndexOf("V")]]
