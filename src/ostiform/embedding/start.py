"""A fold-free map with rims and seams on their circles, from which every method starts."""

import time
from dataclasses import dataclass

import numpy as np

from ostiform.arrays import BoolArray, FloatArray
from ostiform.domain import Sphere
from ostiform.embedding.disc import pole_frame
from ostiform.embedding.opening import opened_disc
from ostiform.embedding.parts import part_discs
from ostiform.embedding.pose_fit import best_turn, posed_moments
from ostiform.embedding.types import EmbeddingState
from ostiform.embedding.untangle import untangled
from ostiform.surface import Component, count_flipped

__all__ = ["StartingMap", "on_curves", "snapped", "starting_map", "state"]


@dataclass(frozen=True, slots=True, eq=False)
class StartingMap:
    """The start and the steps to it.

    Attributes
    ----------
    directions : (V, 3) float64
    folded : int
        Triangles still folded: 0 unless the untangling failed.
    states : tuple of EmbeddingState
        ``"tutte"``, ``"opened"``, ``"arc-length"``, ``"untangled"``.
    """

    directions: FloatArray
    folded: int
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
            moments = posed_moments(part.disc.vertices, part.disc.faces, result.arc_length, pose)
            turn = frame.T @ best_turn(frame @ moments @ frame.T) @ frame
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
    result_ = untangled(directions, component.faces, on_curves(component))
    states.append(state("untangled", component, result_.directions, time.process_time() - clock))
    return StartingMap(result_.directions, result_.folded, tuple(states))
