"""What an embedding is, and the evidence that it is free of folds."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ostiform.arrays import FloatArray, IntArray
from ostiform.codecs import StoredAs
from ostiform.surface import Component, Seam, SphereLocator
from ostiform.values import Axes, value


@value
class Certificate:
    """The evidence that a map to the sphere is an embedding (design 3, step 4).

    Attributes
    ----------
    flipped, degenerate : int
        Triangles whose exact orientation predicate against the sphere's centre is negative, zero.
    area_defect : float
        Relative difference between the sum of the spherical triangle areas and the area of the
        domain (the sphere without the rim polygons); the map has degree one when it is small.
    rim_error : float
        Largest angular distance of a rim or seam vertex from its circle, radians.
    hole_order : tuple of str
        Rims and further seams in cyclic order about the pole, starting from the first by name.
    twist : mapping of str to float
        Angle in radians swept about each circle's centre by the images of the shortest paths from
        the rim's vertices to the tube's base, mean over the rim (`embedding.twist`). By full
        ostium name; a seam has a tube on each side and appears under both its names.
    problems : tuple of str
        One sentence per violated condition; empty for a certified map.
    """

    flipped: int
    degenerate: int
    area_defect: float
    rim_error: float
    hole_order: tuple[str, ...]
    twist: Mapping[str, float]
    problems: tuple[str, ...]

    @property
    def is_valid(self) -> bool:
        """Whether every condition holds."""
        return not self.problems


@dataclass(frozen=True, slots=True)
class SeamJump:
    """How far the map is from G1 across a seam (design 3).

    Attributes
    ----------
    mean, p95 : float
        Edge-length-weighted mean and 95 % of the relative jump of the co-normal derivative,
        ``|g+ - g-| / ((|g+| + |g-|) / 2)``.
    floor_mean : float
        The same mean on interior edge loops ten degrees either side: the mesh's own floor.
    kink : float
        Edge-length-weighted mean of ``|g+| / |g-|``; a mean or a mode is G1 where it does not
        vary between shapes.
    shear : float
        Edge-length-weighted mean of the angle in radians between g+ and g-.
    """

    mean: float
    p95: float
    floor_mean: float
    kink: float
    shear: float


@value
class Distortion:
    """Angle and area distortion of a map, weighted by area on the surface.

    Attributes
    ----------
    angle_mean, angle_median, angle_p99 : float
        Ratio of the singular values of the map, 1 for a conformal map.
    area_p01, area_p99 : float
        Share of the domain over share of the surface, 1st and 99th percentile.
    circle_ratio : mapping of str to float
        Radius of each rim's circle over the radius the opening gets in the hole-filled conformal
        map; the harmonic map is folded above about 2.
    seam_jump : mapping of Seam to SeamJump
    """

    angle_mean: float
    angle_median: float
    angle_p99: float
    area_p01: float
    area_p99: float
    circle_ratio: Mapping[str, float]
    seam_jump: Mapping[Seam, SeamJump]


@value
class EmbeddingState:
    """One step on the way to an embedding, kept for the report (HY Fig. 2).

    Attributes
    ----------
    name : str
        ``"tutte"``, ``"opened"``, ``"untangled"``, ``"smoothed"``, ``"harmonic"``, ...
    directions : (V, 3) float64, float32 where read from a file
        Unit vectors.
    flipped : int
        Triangles not positively oriented.
    seconds : float
    """

    name: str
    directions: Annotated[NDArray[Any], Axes("V", 3), StoredAs(np.float32)]
    flipped: int
    seconds: float


@value
class PlacedCurve:
    """A rim or a seam of a shape, and where its vertices lie on their circle.

    Attributes
    ----------
    first_angle : float
        Of the first vertex about the circle's centre, radians.
    sign : float
        1 where the angle increases along the curve, -1 where it decreases.
    positions : (n + 1,) float64
        Angle travelled from the first vertex to each, and back to the first, radians.
    loop : (n + 1,) int64
        The vertices in order; the first again at the end.
    frame : (3, 3) float64
        Rows e1, e2 of the circle's tangent frame, and its centre.
    """

    first_angle: float
    sign: float
    positions: Annotated[FloatArray, Axes("n")]
    loop: Annotated[IntArray, Axes("n")]
    frame: Annotated[FloatArray, Axes(3, 3)]


@value
class Embedding:
    """The map of one component of one shape to its component sphere.

    Attributes
    ----------
    component : Component
        The mesh that was mapped (after hygiene), in input coordinates.
    locator : SphereLocator
        Of the mesh on the sphere.
    curves : mapping of str to PlacedCurve
        By the names of `Sphere.curves`; empty where the map is not certified.
    certificate : Certificate
    distortion : Distortion
    states : tuple of EmbeddingState
        The steps in order; the last equals `directions`.
    method : str
        ``"barrier"``, ``"harmonic-barrier"`` or ``"harmonic"``.
    seconds : float
    """

    component: Component
    locator: SphereLocator
    curves: Mapping[str, PlacedCurve]
    certificate: Certificate
    distortion: Distortion
    states: tuple[EmbeddingState, ...]
    method: str
    seconds: float

    @property
    def directions(self) -> FloatArray:
        """Unit vectors (V, 3); rim vertices lie on their circles, seam vertices on theirs."""
        return self.locator.points[: len(self.component.vertices)]


Embeddings: TypeAlias = tuple[Embedding, ...]
"""Of one shape, one per component; its files hold them."""
