"""A fold-free map with rims and seams on their circles, from which every method starts."""

import time
from dataclasses import dataclass

import numpy as np

from ostiform.arrays import BoolArray, FloatArray, IntArray
from ostiform.domain import NORTH, Circle, Sphere
from ostiform.embedding.disc import pole_frame
from ostiform.embedding.opening import opened_disc
from ostiform.embedding.part_discs import part_discs
from ostiform.embedding.pose_fit import best_turn, posed_moments
from ostiform.embedding.rims import rims_turned
from ostiform.embedding.types import EmbeddingState
from ostiform.embedding.untangle import untangled
from ostiform.surface import Component, count_flipped, rotation_between, spherical_areas


@dataclass(frozen=True, slots=True, eq=False)
class StartingMap:
    """The start and the steps to it.

    Attributes
    ----------
    directions : (V, 3) float64
    folded : int
        Triangles still folded: 0 unless the untangling failed.
    degree : int
        How often the map covers the sphere, its holes filled: 1 for an embedding.
    states : tuple of EmbeddingState
        ``"tutte"``, ``"opened"``, ``"arc-length"``, ``"untangled"``.
    """

    directions: FloatArray
    folded: int
    degree: int
    states: tuple[EmbeddingState, ...]


def on_curves(component: Component) -> BoolArray:
    """Return which vertices (V,) lie on a rim or a seam."""
    on_curve = np.zeros(len(component.vertices), dtype=np.bool_)
    for curve in (*component.rims.values(), *component.seams.values()):
        on_curve[curve] = True
    return on_curve


def state(
    name: str, component: Component, directions: FloatArray, seconds: float
) -> EmbeddingState:
    """Return a step for the report, its folded triangles counted exactly."""
    return EmbeddingState(name, directions, count_flipped(directions, component.faces), seconds)


def snapped(component: Component, sphere: Sphere, directions: FloatArray) -> FloatArray:
    """Return the map with rim and seam vertices exactly on their circles, angles kept."""
    exact = directions.copy()
    for name, rim in component.rims.items():
        circle = sphere.rims[name]
        exact[rim] = circle.points(circle.angles(directions[rim]))
    for seam, curve in component.seams.items():
        circle = sphere.seams[seam]
        points = circle.points(circle.angles(directions[curve]))
        if abs(circle.radius - 0.5 * np.pi) < 1e-12 and abs(circle.center[2]) > 1.0 - 1e-12:
            points[:, 2] = 0.0  # the equator: exactly, not to round-off
            points /= np.linalg.norm(points, axis=1, keepdims=True)
        exact[curve] = points
    return exact


def starting_map(component: Component, sphere: Sphere, pose: FloatArray) -> StartingMap:
    """Map a component with at least one opening or seam to its sphere without folds.

    Part after part: hole-filled Tutte, holes carried to their circles, opened, rims at arc length
    (`opened_disc`); parts beyond a seam take the angles of the seam's vertices over. The few
    triangles that this folds are untangled with rims and seams held.

    Parameters
    ----------
    component : Component
        After hygiene.
    sphere : Sphere
    pose : (4, 4) float64
        Input to aligned coordinates: turns a map that has no hole to turn to.
    """
    clock = time.process_time()
    tutte, opened, arc_length = (np.zeros((len(component.vertices), 3)) for _ in range(3))
    placed = np.zeros(len(component.vertices), dtype=np.bool_)
    for part in part_discs(component, sphere):
        outer = None if part.parent is None else arc_length[part.vertices[part.disc.outer.loop]]
        result = opened_disc(part.disc, outer)
        turn = np.eye(3)
        if part.parent is None and not part.disc.holes:
            frame = pole_frame(part.disc.outer.circle)
            upright = rotation_between(sphere.up, NORTH)
            moments = posed_moments(part.disc.vertices, part.disc.faces, result.arc_length, pose)
            turn = frame.T @ best_turn(frame @ upright @ moments @ frame.T) @ frame
        new = ~placed[part.vertices]
        fresh = part.vertices[new]
        tutte[fresh] = result.tutte[new] @ turn.T
        opened[fresh] = result.opened[new] @ turn.T
        arc_length[fresh] = result.arc_length[new] @ turn.T
        placed[part.vertices] = True
    seconds = time.process_time() - clock
    states = [
        state("tutte", component, tutte, seconds),
        state("opened", component, opened, 0.0),
    ]
    clock = time.process_time()
    directions = snapped(component, sphere, arc_length)
    states.append(state("arc-length", component, directions, time.process_time() - clock))
    clock = time.process_time()
    is_fixed = on_curves(component)
    unfolded = untangled(directions, component.faces, is_fixed, max_rounds=4)
    if unfolded.folded:
        unfolded = rims_turned(
            component.vertices,
            component.faces,
            snapped(component, sphere, opened),
            _curves(component, sphere, directions),
            is_fixed,
        )
    states.append(state("untangled", component, unfolded.directions, time.process_time() - clock))
    degree = _degree(component, sphere, unfolded.directions)
    return StartingMap(unfolded.directions, unfolded.folded, degree, tuple(states))


def _curves(
    component: Component, sphere: Sphere, directions: FloatArray
) -> list[tuple[Circle, IntArray, FloatArray]]:
    """Circle, vertices and angles in a map of every rim and seam."""
    curves = [(sphere.rims[name], rim) for name, rim in component.rims.items()]
    curves += [(sphere.seams[seam], curve) for seam, curve in component.seams.items()]
    return [(circle, loop, circle.angles(directions[loop])) for circle, loop in curves]


def _degree(component: Component, sphere: Sphere, directions: FloatArray) -> int:
    """How often the triangles and the cones over the rims cover the sphere."""
    total = float(spherical_areas(directions, component.faces).sum())
    for name, rim in component.rims.items():
        fan = np.vstack([sphere.rims[name].center, directions[rim]])
        one = 1 + np.arange(len(rim))
        cone = np.stack([np.roll(one, -1), one, np.zeros(len(rim), dtype=np.int64)], axis=1)
        total += float(spherical_areas(fan, cone).sum())
    return round(total / (4.0 * np.pi))
