"""The twist of a tube: how far a map turns the surface about an opening on the way to its base.

Two maps with the same circles can differ by whole turns of a tube (Dehn twists), which no rim
position, area or orientation shows: the angle swept along a path on the surface does.
"""

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from ostiform.arrays import BoolArray, FloatArray, IntArray
from ostiform.domain import Circle, Sphere
from ostiform.embedding.sides import faces_inside
from ostiform.surface import Component, unique_edges

# The base of a tube is put this far from its circle to the nearest other circle, so that the
# shortest paths end before they reach another rim.
BASE_SHARE = 0.95


def measured_twists(
    component: Component, sphere: Sphere, directions: FloatArray
) -> dict[str, float]:
    """Return the twist of every tube in radians, by full ostium name (design 3, step 4).

    The tube of a circle is the ring between it and the nearest other circle about its centre; the
    paths are the shortest on the surface, along edges, from each rim vertex to the ring's other
    end. Their images sweep an angle about the circle's centre; the mean over the rim is the
    twist. A straight tube mapped straight has none, a bend moves the paths to its inner side from
    both sides alike, and one Dehn twist adds 2 pi. A seam has two tubes, one on each side.

    Parameters
    ----------
    component : Component
    sphere : Sphere
    directions : (V, 3) float64
        Unit vectors.

    Returns
    -------
    twists : dict of str to float
        NaN for a tube that has no vertex beyond its ring.
    """
    edges = unique_edges(component.faces)[0]
    lengths = np.linalg.norm(
        component.vertices[edges[:, 1]] - component.vertices[edges[:, 0]], axis=1
    )
    everywhere = np.ones(len(component.vertices), dtype=np.bool_)
    twists = {}
    for name, rim in component.rims.items():
        base = _outer_base(sphere, name)
        reached = _polar_angle(sphere.rims[name], directions) > base
        swept = swept_angles(
            sphere.rims[name], directions, edges, lengths, rim, reached, everywhere
        )
        twists[name] = _mean(swept)
    for seam, curve in component.seams.items():
        circle = sphere.seams[seam]
        polar = _polar_angle(circle, directions)
        inside = faces_inside(component, seam)
        for name, faces, reached in (
            (seam.first, component.faces[~inside], polar > _outer_base(sphere, seam.first)),
            (seam.second, component.faces[inside], polar < _inner_base(sphere, seam.first)),
        ):
            allowed = np.zeros(len(component.vertices), dtype=np.bool_)
            allowed[faces] = True
            swept = swept_angles(circle, directions, edges, lengths, curve, reached, allowed)
            twists[name] = _mean(swept)
    return twists


def swept_angles(
    circle: Circle,
    directions: FloatArray,
    edges: IntArray,
    lengths: FloatArray,
    starts: IntArray,
    reached: BoolArray,
    allowed: BoolArray,
) -> FloatArray:
    """Return the angle each shortest path's image sweeps about a circle's centre.

    The image of an edge is a great-circle arc shorter than pi that does not pass through the
    centre, so it sweeps less than pi and the sum along a path is safe from branch cuts.

    Parameters
    ----------
    circle : Circle
    directions : (V, 3) float64
        Unit vectors.
    edges : (E, 2) int64
    lengths : (E,) float64, mm
        On the surface.
    starts : (n,) int64
        Where the paths start.
    reached : (V,) bool
        Where they may end.
    allowed : (V,) bool
        Where they may run.

    Returns
    -------
    swept : (n,) float64
        Radians, counter-clockwise seen from outside; NaN where no path exists.
    """
    n_vertices = len(directions)
    usable = allowed[edges].all(axis=1)
    # Least positive double: a zero length would read as a missing edge.
    weights = np.maximum(lengths[usable], np.finfo(np.float64).tiny)
    graph = sparse.coo_array(
        (weights, (edges[usable, 0], edges[usable, 1])), shape=(n_vertices, n_vertices)
    ).tocsr()
    ends = np.flatnonzero(reached & allowed)
    if not len(ends):
        return np.full(len(starts), np.nan)
    _, before, _ = dijkstra(
        graph, directed=False, indices=ends, return_predecessors=True, min_only=True
    )
    angles = circle.angles(directions)
    swept = np.zeros(len(starts))
    here = starts.copy()
    while True:
        following = before[here]
        moving = following >= 0
        if not moving.any():
            break
        turn = angles[following[moving]] - angles[here[moving]]
        swept[moving] += np.remainder(turn + np.pi, 2.0 * np.pi) - np.pi
        here[moving] = following[moving]
    return np.where((reached & allowed)[here], swept, np.nan)


def _mean(swept: FloatArray) -> float:
    found = np.isfinite(swept)
    return float(swept[found].mean()) if found.any() else float("nan")


def _polar_angle(circle: Circle, directions: FloatArray) -> FloatArray:
    angle: FloatArray = np.arccos(np.clip(directions @ circle.center, -1.0, 1.0))
    return angle


def _outer_base(sphere: Sphere, name: str) -> float:
    """Angle from a circle's centre at which the tube outside it ends."""
    circle = sphere.curves[name]
    gaps = []
    for other_name, other in sphere.curves.items():
        between = float(np.arccos(np.clip(circle.center @ other.center, -1.0, 1.0)))
        nearest = abs(between - other.radius)
        if other_name != name and nearest > circle.radius:
            gaps.append(nearest - circle.radius)
    gap = min(gaps, default=0.5 * (np.pi - circle.radius))
    return circle.radius + BASE_SHARE * gap


def _inner_base(sphere: Sphere, name: str) -> float:
    """Angle from a seam's centre at which the tube inside it ends."""
    circle = sphere.curves[name]
    farthest = []
    for other_name, other in sphere.curves.items():
        between = float(np.arccos(np.clip(circle.center @ other.center, -1.0, 1.0)))
        if other_name != name and between + other.radius < circle.radius:
            farthest.append(between + other.radius)
    outermost = max(farthest, default=0.5 * circle.radius)
    return circle.radius - BASE_SHARE * (circle.radius - outermost)
