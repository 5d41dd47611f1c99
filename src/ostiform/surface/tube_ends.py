"""Where a tube leaves the body of a surface, and cutting it there, wherever it ended before.

The rim of a vein lies where somebody cut; where the vein *leaves* the atrium is anatomy. The body
is the morphological opening of the solid by a ball wider than the tube: the union of all balls
inside that are at least so large. The height over it grows along the tube whatever the place and
the slant of its rim, so curves of one height are one place of the anatomy in every shape.
"""

from typing import Annotated

import igl
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from ostiform.arrays import FloatArray, IntArray
from ostiform.compiled import kernel
from ostiform.errors import TopologyError
from ostiform.surface.cutting import cut_along_zero
from ostiform.surface.queries import distances_to_surface
from ostiform.surface.topology import (
    boundary_loops,
    edge_faces,
    graph_labels,
    unique_edges,
    without_unreferenced,
)
from ostiform.surface.types import Surface
from ostiform.values import Axes, value

_NODES_PER_RADIUS = 5
"""Grid nodes along the radius of the smallest ball. Places of the cut on twelve generated atria, of
which the veins were cut by 0 to 12 mm, have a standard deviation of 0.3 to 0.5 mm with 5 and 8."""


@value
class Body:
    """The balls inside a closed surface that are wide enough to belong to its body.

    Attributes
    ----------
    centers : (n, 3) float64, mm
    radii : (n,) float64, mm
        Distance of each centre from the surface.
    """

    centers: Annotated[FloatArray, Axes("n", 3)]
    radii: Annotated[FloatArray, Axes("n")]


def body_inside(surface: Surface, radius: float) -> Body:
    """Return the balls of at least a radius, mm, inside a surface whose openings are closed."""
    vertices, faces = _capped(surface)
    low, step = vertices.min(axis=0), radius / _NODES_PER_RADIUS
    counts = np.ceil(np.ptp(vertices, axis=0) / step).astype(np.int64) + 1
    axes = [low[k] + step * np.arange(counts[k]) for k in range(3)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    nodes = nodes[np.abs(igl.fast_winding_number(vertices, faces, nodes)) > 0.5]
    room = distances_to_surface(nodes, vertices, faces)
    wide = room >= radius
    return Body(nodes[wide], room[wide])


def height_over_body(body: Body, points: FloatArray, radius: float) -> FloatArray | None:
    """Return the distance (n,) of points (n, 3) from the balls of at least a radius, mm.

    None where there is no such ball.
    """
    wide = body.radii >= radius
    if not wide.any():
        return None
    height: FloatArray = _distance_to_balls(points, body.centers[wide], body.radii[wide])
    return height


def _capped(surface: Surface) -> tuple[FloatArray, IntArray]:
    """Return a surface closed by a fan about the middle of every rim."""
    vertices, faces = [surface.vertices], [surface.faces]
    for count, loop in enumerate(surface.loops.values(), len(surface.vertices)):
        vertices.append(surface.vertices[loop].mean(axis=0, keepdims=True))
        faces.append(np.column_stack([np.roll(loop, -1), loop, np.full(len(loop), count)]))
    return np.concatenate(vertices), np.concatenate(faces)


@kernel
def _distance_to_balls(points: FloatArray, centers: FloatArray, radii: FloatArray) -> FloatArray:
    nearest = np.empty(len(points))
    for i in range(len(points)):
        least = np.inf
        for k in range(len(centers)):
            x = points[i, 0] - centers[k, 0]
            y = points[i, 1] - centers[k, 1]
            z = points[i, 2] - centers[k, 2]
            least = min(least, np.sqrt(x * x + y * y + z * z) - radii[k])
        nearest[i] = least
    return nearest


def distance_from_rims(surface: Surface, ostia: tuple[str, ...]) -> FloatArray:
    """Return how far the vertices of a surface lie from the rims of some ostia along the surface.

    For parts without a body, such as a vessel. Shortest ways go along edges and across them.

    Returns
    -------
    (V,) float64, mm
    """
    edges, sides = edge_faces(surface.faces)
    inner = sides[:, 1] >= 0
    # The corner of either face of an edge that is not on the edge.
    corners = surface.faces[sides[inner]].sum(axis=2) - edges[inner].sum(axis=1)[:, None]
    links = np.concatenate([edges, corners])
    lengths = np.linalg.norm(surface.vertices[links[:, 0]] - surface.vertices[links[:, 1]], axis=1)
    count = len(surface.vertices)
    graph = coo_array((lengths, (links[:, 0], links[:, 1])), shape=(count, count)).tocsr()
    rims = np.concatenate([surface.loops[name] for name in ostia])
    away: FloatArray = dijkstra(graph, directed=False, indices=rims, min_only=True)
    return away


def shortened(surface: Surface, ostium: str, height: FloatArray, level: float) -> Surface:
    """Cut the tube of an ostium where a height takes a level.

    Parameters
    ----------
    surface : Surface
    ostium : str
        Its rim lies above the level.
    height : (V,) float64
        Grows along the tube.
    level : float

    Returns
    -------
    Surface
        Without what lies above the level round the rim; the ostium's loop is the curve of the cut.

    Raises
    ------
    TopologyError
        If what lies above the level round this rim is no tube: it has another rim, or more than
        one curve at its foot.
    """
    rim = surface.loops[ostium]
    edges = unique_edges(surface.faces)[0]
    above = height > level
    joined = edges[above[edges].all(axis=1)]
    label = graph_labels(joined[:, 0], joined[:, 1], len(height))
    tube = above & (label == label[rim[0]])
    others = [name for name, loop in surface.loops.items() if name != ostium and tube[loop].any()]
    if not tube[rim].all() or others:
        found = f"one that {' and '.join(others)} share" if others else "its rim on both sides"
        raise TopologyError(
            f"{ostium}: expected a tube of its own from {level:.3g} mm off the body, found "
            f"{found}; take it from the cuts of the part or leave this shape out"
        )
    lowest = -np.finfo(np.float64).tiny
    cut = cut_along_zero(
        surface.vertices,
        surface.faces,
        np.where(tube, height - level, np.minimum(height - level, lowest)),
    )
    kept = cut.faces[cut.side < 0]
    relabelled, faces = without_unreferenced(kept, len(cut.vertices))
    return _with_loops(surface, ostium, cut.vertices[relabelled], faces, relabelled)


def _with_loops(
    surface: Surface, ostium: str, vertices: FloatArray, faces: IntArray, source: IntArray
) -> Surface:
    """Name the loops of a shortened surface, of which vertices (V',) come from `source`."""
    names = np.full(int(source.max(initial=0)) + 1, "", dtype=object)
    for name, loop in surface.loops.items():
        if name != ostium:
            names[loop[loop < len(names)]] = name
    found: dict[str, list[IntArray]] = {}
    for loop in boundary_loops(faces):
        found.setdefault(str(names[source[loop[0]]]) or ostium, []).append(loop)
    if any(len(loops) != 1 for loops in found.values()) or set(found) != set(surface.loops):
        raise TopologyError(
            f"{ostium}: expected its tube to leave the body in one closed curve, found "
            f"{len(found.get(ostium, []))}; take it from the cuts of the part or leave this shape "
            "out"
        )
    return Surface(vertices, faces, {name: found[name][0] for name in surface.loops})


def rim_radius(surface: Surface, ostium: str) -> float:
    """Return the radius, mm, of the circle as long as the rim of an ostium."""
    rim = surface.vertices[surface.loops[ostium]]
    perimeter = np.linalg.norm(rim - np.roll(rim, 1, axis=0), axis=1).sum()
    return float(perimeter / (2.0 * np.pi))
