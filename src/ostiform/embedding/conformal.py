"""Where the openings lie when a component's holes are filled and mapped conformally (design 2)."""

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.optimize import least_squares

from ostiform.arrays import FloatArray, IntArray
from ostiform.domain import NORTH, Circle, ConformalHoles, Sphere
from ostiform.embedding.disc import (
    ComplexArray,
    Disc,
    arc_length_angles,
    cone_filled,
    disc_solution,
    pole_frame,
)
from ostiform.embedding.part_discs import PartDisc, part_discs, part_openings
from ostiform.embedding.pose_fit import best_turn, posed_moments
from ostiform.surface import Component, Seam, corner_cotangents, inverse_stereographic, vertex_areas

# A further seam's disc is shown at least and at most this wide, radians: the conformal radius of
# its hole is exponentially small, and openings within it would fall on one point.
NESTED_RADII = (np.radians(15.0), np.radians(45.0))

# Limits of a cotangent weight, 0.58 in an equilateral mesh.
WEIGHT_LIMITS = (0.05, 20.0)

# Limits of the circle of a single part's pole, radians, when the map is balanced.
POLE_RADII = (np.radians(2.0), np.radians(90.0))


def conformal_holes(component: Component, pole: str | None, pose: FloatArray) -> ConformalHoles:
    """Return the hole-filled conformal position and radius of every opening of a component.

    With a seam each half is a disc bounded by it and lies on its hemisphere, the first part in
    z < 0, at the same angles along the seam. Without, the pole's rim is about +z and the map is
    balanced: the Moebius transformation that keeps the rim on a circle about +z puts the mean
    direction of the surface, by area, at zero. The map is turned about z to agree best with the
    shape in its pose.

    Parameters
    ----------
    component : Component
    pole : str or None
        Full ostium name of a rim or a seam side; None for a closed component.
    pose : (4, 4) float64
        Input to aligned coordinates, column vectors.

    Returns
    -------
    ConformalHoles
        For every rim but a single part's pole, and every seam but the equator (by the name of
        its first side). Empty for a closed component.
    """
    if not component.rims and not component.seams:
        return ConformalHoles({}, {})
    discs = part_discs(component, _nominal_sphere(component, pole))
    map_ = np.zeros((len(component.vertices), 3))
    placed = np.zeros(len(component.vertices), dtype=np.bool_)
    directions: dict[str, FloatArray] = {}
    radii: dict[str, float] = {}
    nested: dict[str, Circle] = {}
    for part in discs:
        disc = part.disc
        outer = nested.get(disc.outer.name, disc.outer.circle)
        frame = pole_frame(outer)
        if part.parent is None:
            angles = -arc_length_angles(disc.vertices, disc.outer.loop)
        else:
            known = map_[part.vertices[disc.outer.loop]] @ frame.T
            angles = np.arctan2(known[:, 1], known[:, 0])
        zeta, apexes = _conformal_disc(disc, angles)
        if len(component.parts) == 1:
            zeta, apexes = _balanced(disc, zeta, apexes)
        else:
            scale = 1.0 / np.tan(0.5 * outer.radius)
            zeta, apexes = scale * zeta, scale * apexes
        new = ~placed[part.vertices]
        image = inverse_stereographic(zeta) @ frame
        map_[part.vertices[new]] = image[new]
        placed[part.vertices] = True
        centers = inverse_stereographic(apexes) @ frame
        for hole, center in zip(disc.holes, centers, strict=True):
            radius = float(np.mean(np.arccos(np.clip(image[hole.loop] @ center, -1.0, 1.0))))
            seam = _seam_of(component, part, hole.name)
            name = hole.name if seam is None else seam.first
            directions[name], radii[name] = center, max(radius, np.finfo(np.float64).tiny)
            if seam is not None:
                shown = float(np.clip(radius, *NESTED_RADII))
                other = seam.second if hole.name == seam.first else seam.first
                nested[other] = Circle(-center, np.pi - shown)
                ring = Circle(center, shown)
                map_[part.vertices[hole.loop]] = ring.points(ring.angles(image[hole.loop]))
    moments = posed_moments(component.vertices, component.faces, map_, pose)
    turn = best_turn(moments)
    turned = {name: turn @ center for name, center in directions.items()}
    along = moments[:, 2]  # where the surface lies as +z of the map grows
    return ConformalHoles(turned, radii, along / np.linalg.norm(along))


def _nominal_sphere(component: Component, pole: str | None) -> Sphere:
    """Stand-in circles: the equator for seams, polar circles for rims; only the pole's is used."""
    if pole is None and not component.seams:
        pole = max(component.rims, key=lambda name: len(component.rims[name]))
    half = Circle(NORTH, 0.5 * np.pi)
    return Sphere(
        component.name,
        component.parts,
        {name: half for name in component.rims},
        {seam: half for seam in component.seams},
        pole,
    )


def _seam_of(component: Component, part: PartDisc, name: str) -> Seam | None:
    return next(
        opening.seam for opening in part_openings(component, part.part) if opening.name == name
    )


def _conformal_disc(disc: Disc, outer_angles: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """Harmonic map of the hole-filled part to the unit disc: positions and apexes of the cones.

    The cotangent weights are kept positive, so that no position falls outside: an edge between
    obtuse triangles has a small weight instead of a negative one.
    """
    loops = [hole.loop for hole in disc.holes]
    filled, _ = cone_filled(disc.faces, len(disc.vertices), loops)
    apexes = [disc.vertices[loop].mean(axis=0) for loop in loops]
    vertices = np.vstack([disc.vertices, *apexes]) if apexes else disc.vertices
    border = np.exp(1j * outer_angles)
    zeta = disc_solution(_positive_stiffness(vertices, filled), disc.outer.loop, border)
    n = len(disc.vertices)
    return zeta[:n], zeta[n:]


def _positive_stiffness(vertices: FloatArray, faces: IntArray) -> sparse.csr_array:
    """Cotangent stiffness (V, V) with weights limited to `WEIGHT_LIMITS`."""
    cotangents = corner_cotangents(vertices, faces)  # (F, 3), at the corner opposite the edge
    start, end = np.roll(faces, -1, axis=1).ravel(), np.roll(faces, 1, axis=1).ravel()
    half = sparse.coo_array((0.5 * cotangents.ravel(), (start, end)), shape=(len(vertices),) * 2)
    weights = (half + half.T).tocsr()
    weights.data = np.clip(weights.data, *WEIGHT_LIMITS)
    return (sparse.diags_array(np.asarray(weights.sum(axis=1)).ravel()) - weights).tocsr()


@dataclass(frozen=True, slots=True)
class _DiscMove:
    """Disc automorphism ``(w - a) / (1 - conj(a) w)``, then the scale to the pole's circle."""

    shift: complex
    scale: float

    def apply(self, points: ComplexArray) -> ComplexArray:
        moved: ComplexArray = (
            self.scale * (points - self.shift) / (1.0 - np.conj(self.shift) * points)
        )
        return moved


def _balanced(
    disc: Disc, zeta: ComplexArray, apexes: ComplexArray
) -> tuple[ComplexArray, ComplexArray]:
    """Put the mean direction of the surface at zero, as far as the limits of the pole allow."""
    weights = vertex_areas(disc.vertices, disc.faces)
    weights = weights / weights.sum()
    low, high = (np.log(1.0 / np.tan(0.5 * radius)) for radius in reversed(POLE_RADII))

    def move(unknowns: FloatArray) -> _DiscMove:
        length = float(np.hypot(unknowns[0], unknowns[1]))
        ratio = 0.999 * np.tanh(length) / length if length > 1e-12 else 0.999
        share = 0.5 * (1.0 + np.tanh(unknowns[2]))
        return _DiscMove(
            complex(unknowns[0], unknowns[1]) * ratio, float(np.exp(low + (high - low) * share))
        )

    def imbalance(unknowns: FloatArray) -> FloatArray:
        mean: FloatArray = weights @ inverse_stereographic(move(unknowns).apply(zeta))
        return mean

    found = least_squares(imbalance, np.zeros(3), xtol=1e-6, ftol=1e-6, max_nfev=60)
    best = move(found.x)
    return best.apply(zeta), best.apply(apexes)
