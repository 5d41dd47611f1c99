"""Harmonic maps to the sphere with fixed rims (HY eq. 3 and 4).

The energy ``1/2 sum_ij kappa_ij |x_i - x_j|^2`` of springs with cotangent constants is lowered by
moving every free vertex against the tangential part of ``(L x)_i = sum_j kappa_ij (x_i - x_j)``::

    explicit:       x <- (x - dt D x) / |.|,           D x = L x - <L x, x> x     (HY eq. 4)
    semi-implicit:  (M + dt L) y = -dt D x,            x <- (x + P y) / |.|

(P the projection to the tangent plane). The second is implicit in the displacement, so that its
steps can be thousands of times larger; the fixed points, D x = 0, are the same. Steps are halved
where they would raise the energy.

HY state that a sufficiently small dt converges to the conformal map. It converges to the harmonic
map, which with rims fixed on circles is conformal only if the circles have the radii of the
conformal map; where a circle is wider than about twice that, the minimum itself is folded,
whatever the start and the step. For a vein of length L and radius r that opens from a ring of
radius R the limit is `widest_harmonic_circle`, R / cosh(L / r). So the number of folded triangles
is part of the result.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from enum import Enum
from typing import Annotated, Literal

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from ostiform.arrays import BoolArray, FloatArray, IntArray
from ostiform.domain import Circle, ConformalHoles, Sphere
from ostiform.embedding.fixed_circle_tutte import fixed_circle_charts, on_sphere
from ostiform.errors import InputError
from ostiform.surface import Component, cotangent_stiffness, count_flipped, vertex_areas
from ostiform.values import Axes, value

Descent = Literal["explicit", "semi-implicit"]

# Ratio of a circle to its conformal radius above which the harmonic map is folded (design 3).
SAFE_RATIO = 2.0
# The explicit step is this over the largest row of L: 1 is the limit of stability.
EXPLICIT_STEP = 0.9
# The implicit step in units of the sphere's area over the number of vertices, so that
# neighbouring rows of M are small against L; larger steps only save iterations.
IMPLICIT_STEP = 1e3
MOST_HALVINGS = 30


class HarmonicStatus(Enum):
    """Why the descent stopped."""

    CONVERGED = "the energy has stopped falling"
    EXHAUSTED = "the number of iterations allowed is used up"
    STALLED = "no step lowers the energy"


@value
class HarmonicResult:
    """Where the descent arrived.

    Attributes
    ----------
    directions : (V, 3) float64
        Unit vectors.
    energies : (n + 1,) float64
        Harmonic energy at the start and after every iteration; never rises.
    folded : int
        Triangles flipped or degenerate by exact predicates.
    status : HarmonicStatus
    """

    directions: Annotated[FloatArray, Axes("V", 3)]
    energies: Annotated[FloatArray, Axes(None)]
    folded: int
    status: HarmonicStatus

    @property
    def iterations(self) -> int:
        """Iterations done."""
        return len(self.energies) - 1


def harmonic_map(
    component: Component,
    directions: FloatArray,
    is_fixed: BoolArray,
    descent: Descent = "semi-implicit",
    max_iterations: int = 1000,
    tolerance: float = 1e-9,
) -> HarmonicResult:
    """Lower the harmonic energy of a map with some vertices fixed (HY eq. 3, 4).

    Parameters
    ----------
    component : Component
    directions : (V, 3) float64
        The start, unit vectors.
    is_fixed : (V,) bool
        Vertices of rims and seams.
    descent : str
        ``"explicit"`` (the paper's) or ``"semi-implicit"``.
    max_iterations : int
    tolerance : float
        Relative decrease of the energy in one iteration below which it has converged; the
        explicit descent, whose steps are some thousand times smaller, needs a smaller one.

    Raises
    ------
    InputError
        If the descent is unknown.
    """
    if descent not in ("explicit", "semi-implicit"):
        raise InputError(f"descent: expected explicit or semi-implicit, found {descent!r}")
    stiffness = cotangent_stiffness(component.vertices, component.faces)
    free = np.flatnonzero(~is_fixed)
    step = (
        _ExplicitStep(stiffness, free)
        if descent == "explicit"
        else _ImplicitStep(stiffness, component, free)
    )
    current = np.array(directions, dtype=np.float64)
    energies = [_energy(stiffness, current)]
    status = HarmonicStatus.EXHAUSTED
    for _ in range(max_iterations):
        moved = _lowered(stiffness, current, step.displacement(current), free, energies[-1])
        if moved is None:
            status = HarmonicStatus.STALLED
            break
        current = moved
        energies.append(_energy(stiffness, current))
        if energies[-2] - energies[-1] <= tolerance * energies[-1]:
            status = HarmonicStatus.CONVERGED
            break
    return HarmonicResult(
        current, np.array(energies), count_flipped(current, component.faces), status
    )


def widest_harmonic_circle(length: float, radius: float, ring: float) -> float:
    """Return the widest circle whose harmonic map of a straight tube is injective.

    The planar harmonic map of a tube of length L and radius r between a ring of radius R and a
    circle of radius r0 sends the height s above the end to ``(R sinh(s/r) + r0 sinh((L-s)/r)) /
    sinh(L/r)``; it rises monotonically, so does not fold, if and only if ``r0 <= R / cosh(L/r)``.

    Parameters
    ----------
    length, radius : float, mm
    ring : float
        In the unit of the result.
    """
    return ring / float(np.cosh(length / radius))


def fold_explanations(sphere: Sphere, holes: ConformalHoles) -> tuple[str, ...]:
    """Return one sentence for every circle that is too wide for a harmonic map to be injective.

    Parameters
    ----------
    sphere : Sphere
    holes : ConformalHoles
        Of the shape.
    """
    ratios = {
        name: circle.radius / holes.radii[name]
        for name, circle in sphere.rims.items()
        if name in holes.radii
    }
    return tuple(
        f"{name}: expected a circle of at most {SAFE_RATIO:g} times the opening's conformal radius "
        f"of {np.degrees(holes.radii[name]):.3g} degrees, found {ratio:.3g} times; the harmonic "
        "map is folded there at its minimum, make the circle smaller or use the barrier method"
        for name, ratio in ratios.items()
        if ratio > SAFE_RATIO
    )


def folds_by_circle_ratio(
    component: Component,
    sphere: Sphere,
    holes: ConformalHoles,
    ratios: Sequence[float],
    rotations: Mapping[str, float] | None = None,
) -> IntArray:
    """Return the folded triangles of the converged harmonic map for wider and wider circles.

    Every rim with a conformal radius gets a circle of `ratios` times that radius about its
    conformal position; the others and the seams stay.

    Parameters
    ----------
    component : Component
    sphere : Sphere
    holes : ConformalHoles
        Of this shape.
    ratios : sequence of float
    rotations : mapping of str to float, optional
        Angle on its circle, in radians, of the first vertex of each rim and seam; the phase of
        the circle by default. A rim turned against its tube folds the map for that reason alone.

    Returns
    -------
    folded : (len(ratios),) int64
    """
    is_fixed = np.zeros(len(component.vertices), dtype=np.bool_)
    for curve in (*component.rims.values(), *component.seams.values()):
        is_fixed[curve] = True
    counts = []
    for ratio in ratios:
        rims = {
            name: Circle(
                holes.directions.get(name, circle.center),
                ratio * holes.radii[name],
                circle.phase,
            )
            if name in holes.radii
            else circle
            for name, circle in sphere.rims.items()
        }
        start = on_sphere(
            fixed_circle_charts(component, replace(sphere, rims=rims), rotations),
            len(component.vertices),
        )
        counts.append(harmonic_map(component, start, is_fixed).folded)
    return np.array(counts, dtype=np.int64)


class _ExplicitStep:
    """The paper's descent: against the tangential part of the Laplacian."""

    def __init__(self, stiffness: sparse.csr_array, free: IntArray) -> None:
        self._stiffness = stiffness
        self._free = free
        self._step = EXPLICIT_STEP / float(stiffness.diagonal()[free].max(initial=1.0))

    def displacement(self, directions: FloatArray) -> FloatArray:
        force = _tangential((self._stiffness @ directions)[self._free], directions[self._free])
        return -self._step * force


class _ImplicitStep:
    """The same descent, implicit in the displacement; holds the factorised matrix."""

    def __init__(self, stiffness: sparse.csr_array, component: Component, free: IntArray) -> None:
        areas = vertex_areas(component.vertices, component.faces)[free]
        mass = areas / areas.mean()  # so that a step of 1 moves neighbours together
        matrix = sparse.diags_array(mass) + IMPLICIT_STEP * stiffness[free][:, free]
        self._stiffness, self._free = stiffness, free
        self._solver = splu(
            matrix.tocsc(),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )

    def displacement(self, directions: FloatArray) -> FloatArray:
        here = directions[self._free]
        force = _tangential((self._stiffness @ directions)[self._free], here)
        return _tangential(self._solver.solve(-IMPLICIT_STEP * force), here)


def _tangential(vectors: FloatArray, directions: FloatArray) -> FloatArray:
    """Remove the components (n, 3) along the sphere's normal."""
    along = np.einsum("na,na->n", vectors, directions)
    tangential: FloatArray = vectors - along[:, None] * directions
    return tangential


def _energy(stiffness: sparse.csr_array, directions: FloatArray) -> float:
    return 0.5 * float(np.einsum("va,va->", directions, stiffness @ directions))


def _lowered(
    stiffness: sparse.csr_array,
    directions: FloatArray,
    displacement: FloatArray,
    free: IntArray,
    energy: float,
) -> FloatArray | None:
    """Take the largest of the step and its halves that does not raise the energy."""
    for halving in range(MOST_HALVINGS):
        moved = directions.copy()
        moved[free] += 0.5**halving * displacement
        lengths = np.linalg.norm(moved[free], axis=1, keepdims=True)
        if lengths.min(initial=1.0) > 0.0:
            moved[free] /= lengths
            if _energy(stiffness, moved) <= energy:
                return moved
    return None
