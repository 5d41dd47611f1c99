"""Procedural left atria, ventricles and left hearts of any vein length, and their openings.

Smooth unions of an ellipsoid and tubes, contoured on a grid and cut open by planes across the
tubes. Contoured as they are ("raw") they have slivers; relaxed they are nearly equilateral.
"""

from dataclasses import dataclass

import numpy as np
import pyvista as pv

from ostiform.arrays import BoolArray, FloatArray, IntArray
from ostiform.surface import Component, Seam, boundary_loops, without_unreferenced
from ostiform.surface.topology import connected_components


@dataclass(frozen=True)
class Tube:
    name: str
    start: FloatArray  # inside the body
    end: FloatArray  # where it is cut open
    radius: float
    bend: FloatArray  # displacement of its middle, mm
    is_open: bool = True

    @property
    def nodes(self) -> FloatArray:
        """Points of the centre line (9, 3): a parabola through start, middle + bend, end."""
        t = np.linspace(0.0, 1.0, 9)[:, None]
        straight = (1.0 - t) * self.start + t * self.end
        return straight + 4.0 * t * (1.0 - t) * self.bend

    @property
    def axis(self) -> FloatArray:
        direction = self.nodes[-1] - self.nodes[-2]
        return direction / np.linalg.norm(direction)


@dataclass(frozen=True)
class Body:
    center: FloatArray
    radii: FloatArray
    tubes: tuple[Tube, ...]
    blend: float = 3.0
    others: tuple[tuple[FloatArray, FloatArray], ...] = ()

    def level(self, points: FloatArray) -> FloatArray:
        """Approximate signed distance, negative inside, (n,) mm."""
        value = _ellipsoid(points, self.center, self.radii)
        for center, radii in self.others:
            value = _smooth_minimum(value, _ellipsoid(points, center, radii), self.blend)
        for tube in self.tubes:
            nodes = tube.nodes
            if tube.is_open:
                nodes = np.vstack([nodes, nodes[-1] + 2.0 * tube.radius * tube.axis])
            distance = np.full(len(points), np.inf)
            for one, two in zip(nodes[:-1], nodes[1:], strict=True):
                distance = np.minimum(distance, _segment(points, one, two))
            value = _smooth_minimum(value, distance - tube.radius, self.blend)
        return value


def atrium(vein_length: float, n_veins: int = 4, rng: np.random.Generator | None = None) -> Body:
    """An atrium with a mitral opening, veins of a length in radii, and a blind appendage, mm."""
    radii = np.array([23.0, 19.0, 20.0])
    directions = np.array(
        [
            [0.85, -0.55, -0.35],
            [0.85, 0.35, -0.55],
            [-0.85, -0.50, -0.45],
            [-0.85, 0.40, -0.50],
            [0.05, -0.9, -0.55],
            [0.0, 0.1, -1.0],
            [0.1, 0.95, 0.1],
        ]
    )[:n_veins]
    calibres = np.array([5.5, 5.0, 6.0, 4.5, 4.0, 5.0, 4.5])[:n_veins]
    lengths = np.full(n_veins, vein_length)
    bends = np.zeros((n_veins, 3))
    if rng is not None:
        radii = radii * rng.uniform(0.85, 1.2, 3)
        directions = directions + rng.normal(0.0, 0.12, directions.shape)
        calibres = calibres * rng.uniform(0.75, 1.25, n_veins)
        lengths = rng.uniform(1.5, vein_length, n_veins)
        bends = rng.normal(0.0, 0.8, (n_veins, 3)) * calibres[:, None]
    tubes = [
        Tube("mitral", np.array([0.0, 0, 8]), np.array([0.0, 0, 24]), 13.5, np.zeros(3)),
        _from_wall("appendage", np.array([-0.5, 0.85, 0.45]), radii, 6.0, 2.5, np.zeros(3), False),
    ]
    tubes += [
        _from_wall(f"PV{k + 1}", directions[k], radii, calibres[k], lengths[k], bends[k])
        for k in range(n_veins)
    ]
    return Body(np.zeros(3), radii, tuple(tubes))


def ventricle() -> Body:
    """A ventricle with a mitral and an aortic opening, the apex down, mm."""
    aortic = np.array([0.9, 0.0, 0.3])
    start = np.array([6.0, 0.0, 15.0])
    return Body(
        np.zeros(3),
        np.array([24.0, 22.0, 42.0]),
        (
            Tube("mitral", np.array([-5.0, 0, 12]), np.array([-5.0, 0, 34]), 14.5, np.zeros(3)),
            Tube("aortic", start, start + 32.0 * aortic, 10.0, np.zeros(3)),
        ),
        4.0,
    )


def left_heart(rng: np.random.Generator) -> Body:
    """A ventricle and an atrium joined through a mitral annulus in the plane z = 0, mm."""
    top = np.array([rng.uniform(-2, 2), rng.uniform(-2, 2), 20.0])
    atrial = np.array([rng.uniform(20, 25), rng.uniform(17, 21), rng.uniform(17, 21)])
    bottom = np.array([rng.uniform(-2, 2), 0.0, -32.0])
    ventricular = np.array([rng.uniform(20, 24), rng.uniform(20, 24), rng.uniform(34, 42)])
    directions = np.array(
        [[0.85, -0.55, 0.35], [0.85, 0.35, 0.55], [-0.85, -0.5, 0.45], [-0.85, 0.4, 0.5]]
    ) + rng.normal(0.0, 0.08, (4, 3))
    tubes = [
        Tube("annulus", np.array([0, 0, -8.0]), np.array([0, 0, 10.0]), 13.5, np.zeros(3), False)
    ]
    for k, direction in enumerate(directions):
        tube = _from_wall(
            f"PV{k + 1}", direction, atrial, rng.uniform(4.5, 6), rng.uniform(2, 4), np.zeros(3)
        )
        tubes.append(Tube(tube.name, tube.start + top, tube.end + top, tube.radius, tube.bend))
    start = np.array([10.0, 0.0, -22.0])
    aortic = np.array([1.0, 0.0, 0.1])
    tubes.append(Tube("aortic", start, start + 30.0 * aortic, 9.0, np.zeros(3)))
    return Body(bottom, ventricular, tuple(tubes), 5.0, ((top, atrial),))


def opened_component(body: Body, spacing: float, part: str = "LA", relax: int = 0) -> Component:
    """The body's surface as a component of one part, its tubes cut open."""
    vertices, faces = _contoured(body, spacing)
    if relax:
        vertices, faces = _merged_at_nodes(body, vertices, faces, spacing)
        vertices = _relaxed(body, vertices, faces, relax)
    for tube in body.tubes:
        if tube.is_open:
            height = (vertices - tube.end) @ tube.axis
            away = np.linalg.norm(vertices - tube.end - height[:, None] * tube.axis, axis=1)
            near = (away < 1.8 * tube.radius) & (height > -3.0 * spacing)
            vertices, faces, _ = _cut(
                vertices, faces, np.where(near, height, -1e3), tube.axis, spacing
            )
            vertices, faces = _largest(vertices, faces)
    if relax:
        vertices = _relaxed(body, vertices, faces, 5)
    rims = _named(body, vertices, boundary_loops(faces), part)
    return Component(part, (part,), vertices, faces, np.zeros(len(faces), dtype=np.int64), rims, {})


def joined_component(body: Body, spacing: float, relax: int = 0) -> Component:
    """The left heart cut open, with the mitral annulus (plane z = 0) as a seam."""
    whole = opened_component(body, spacing, "LV", relax)
    vertices = np.array(whole.vertices)
    height = vertices[:, 2].copy()
    inner = np.hypot(vertices[:, 0], vertices[:, 1]) < 21.0
    snap = inner & (np.abs(height) < 0.3 * spacing)
    vertices[snap, 2] = 0.0
    height[snap] = 0.0
    height[~inner] = np.where(height[~inner] < 0.0, -1e3, 1e3)
    vertices, faces, below = _split(vertices, np.array(whole.faces), height)
    face_part = np.where(below, 0, 1)
    if relax:
        pass
    upper = boundary_loops(faces[face_part == 1])
    loops = {tuple(sorted(loop.tolist())) for loop in boundary_loops(faces)}
    curve = [loop for loop in upper if tuple(sorted(loop.tolist())) not in loops]
    assert len(curve) == 1, len(curve)
    rims = {
        name.replace("LV.PV", "LA.PV"): loop
        for name, loop in _named(body, vertices, boundary_loops(faces), "LV").items()
    }
    seams = {Seam("LV.mitral", "LA.mitral"): curve[0]}
    return Component("LV+LA", ("LV", "LA"), vertices, faces, face_part, rims, seams)


def _from_wall(
    name: str,
    direction: FloatArray,
    radii: FloatArray,
    calibre: float,
    length: float,
    bend: FloatArray,
    is_open: bool = True,
) -> Tube:
    direction = direction / np.linalg.norm(direction)
    wall = 1.0 / np.sqrt(np.sum((direction / radii) ** 2))
    return Tube(
        name,
        direction * (wall - 6.0),
        direction * (wall + length * calibre),
        calibre,
        bend,
        is_open,
    )


def _ellipsoid(points: FloatArray, center: FloatArray, radii: FloatArray) -> FloatArray:
    scaled = (points - center) / radii
    k0 = np.linalg.norm(scaled, axis=1)
    k1 = np.linalg.norm(scaled / radii, axis=1)
    return k0 * (k0 - 1.0) / np.maximum(k1, 1e-9)


def _segment(points: FloatArray, one: FloatArray, two: FloatArray) -> FloatArray:
    along = two - one
    t = np.clip((points - one) @ along / (along @ along), 0.0, 1.0)
    return np.linalg.norm(points - one - t[:, None] * along, axis=1)


def _smooth_minimum(a: FloatArray, b: FloatArray, width: float) -> FloatArray:
    h = np.clip(0.5 + 0.5 * (b - a) / width, 0.0, 1.0)
    return b * (1.0 - h) + a * h - width * h * (1.0 - h)


def _contoured(body: Body, spacing: float) -> tuple[FloatArray, IntArray]:
    corners = [body.center - body.radii, body.center + body.radii]
    corners += [c + s * r for c, r in body.others for s in (-1.0, 1.0)]
    for tube in body.tubes:
        corners += [
            tube.nodes.min(axis=0) - 3 * tube.radius,
            tube.nodes.max(axis=0) + 3 * tube.radius,
        ]
    low, high = np.min(corners, axis=0) - 3 * spacing, np.max(corners, axis=0) + 3 * spacing
    counts = np.ceil((high - low) / spacing).astype(int) + 1
    grid = pv.ImageData(dimensions=counts, spacing=(spacing,) * 3, origin=low)
    values = body.level(np.asarray(grid.points, dtype=np.float64))
    surface = grid.contour([0.0], scalars=values, method="flying_edges")
    faces = np.asarray(surface.faces).reshape(-1, 4)[:, 1:].astype(np.int64)
    return _largest(np.asarray(surface.points, dtype=np.float64), _outward(surface, faces))


def _outward(surface: pv.PolyData, faces: IntArray) -> IntArray:
    points = np.asarray(surface.points, dtype=np.float64)
    a, b, c = (points[faces[:, k]] for k in range(3))
    volume = np.einsum("fi,fi->f", a, np.cross(b, c)).sum()
    return faces if volume > 0 else faces[:, [0, 2, 1]]


def _largest(vertices: FloatArray, faces: IntArray) -> tuple[FloatArray, IntArray]:
    labels = connected_components(faces)
    kept, faces = without_unreferenced(
        faces[labels == np.argmax(np.bincount(labels))], len(vertices)
    )
    index = np.full(len(vertices), -1, dtype=np.int64)
    index[kept] = np.arange(len(kept))
    if faces.max() >= len(kept):
        faces = index[faces]
    return vertices[kept], faces


def _merged_at_nodes(
    body: Body, vertices: FloatArray, faces: IntArray, spacing: float
) -> tuple[FloatArray, IntArray]:
    """Collapse short edges of a contour, one per vertex neighbourhood, where that is safe."""
    for _ in range(6):
        edges = np.unique(
            np.sort(np.vstack([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), 1), axis=0
        )
        lengths = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
        short = edges[lengths < 0.45 * spacing][np.argsort(lengths[lengths < 0.45 * spacing])]
        neighbours: list[set[int]] = [set() for _ in range(len(vertices))]
        for one, two in edges:
            neighbours[one].add(int(two))
            neighbours[two].add(int(one))
        merged = np.arange(len(vertices))
        touched = np.zeros(len(vertices), dtype=bool)
        for one, two in short:
            near = neighbours[one] | neighbours[two]
            if touched[list(near)].any() or len(neighbours[one] & neighbours[two]) != 2:
                continue
            if min(len(neighbours[v]) for v in neighbours[one] & neighbours[two]) <= 3:
                continue
            touched[list(near)] = True
            merged[two] = one
            vertices[one] = 0.5 * (vertices[one] + vertices[two])
        if (merged == np.arange(len(vertices))).all():
            break
        faces = merged[faces]
        distinct = (
            (faces[:, 0] != faces[:, 1])
            & (faces[:, 1] != faces[:, 2])
            & (faces[:, 2] != faces[:, 0])
        )
        vertices, faces = _largest(vertices, faces[distinct])
    return vertices, faces


def _relaxed(body: Body, vertices: FloatArray, faces: IntArray, steps: int) -> FloatArray:
    """Move vertices towards their neighbours' mean and back onto the surface; rims stay."""
    edges = np.vstack([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges = np.vstack([edges, edges[:, ::-1]])
    degree = np.bincount(edges[:, 0], minlength=len(vertices))
    free = np.ones(len(vertices), dtype=bool)
    for loop in boundary_loops(faces):
        free[loop] = False
    vertices = vertices.copy()
    delta = 1e-4
    for _ in range(steps):
        mean = np.stack(
            [np.bincount(edges[:, 0], vertices[edges[:, 1], k], len(vertices)) for k in range(3)], 1
        )
        vertices[free] += 0.5 * (mean / degree[:, None] - vertices)[free]
        value = body.level(vertices)
        gradient = np.stack(
            [(body.level(vertices + delta * axis) - value) / delta for axis in np.eye(3)], 1
        )
        squared = np.einsum("vi,vi->v", gradient, gradient)
        vertices[free] -= ((value / np.maximum(squared, 1e-2))[:, None] * gradient)[free]
    return vertices


def _cut(
    vertices: FloatArray, faces: IntArray, height: FloatArray, axis: FloatArray, spacing: float
) -> tuple[FloatArray, IntArray, BoolArray]:
    """Keep the faces below height 0, vertices near it moved onto it first."""
    snap = np.abs(height) < 0.3 * spacing
    vertices = np.where(snap[:, None], vertices - height[:, None] * axis, vertices)
    height = np.where(snap, 0.0, height)
    vertices, faces, below = _split(vertices, faces, height)
    kept, faces = vertices, faces[below]
    return kept, faces, below


def _split(
    vertices: FloatArray, faces: IntArray, height: FloatArray
) -> tuple[FloatArray, IntArray, BoolArray]:
    """Split the faces along height 0; return which are below."""
    sign = np.sign(height).astype(int)
    new: list[FloatArray] = []
    known: dict[tuple[int, int], int] = {}

    def crossing(i: int, j: int) -> int:
        key = (min(i, j), max(i, j))
        if key not in known:
            t = height[key[0]] / (height[key[0]] - height[key[1]])
            known[key] = len(vertices) + len(new)
            new.append(vertices[key[0]] + t * (vertices[key[1]] - vertices[key[0]]))
        return known[key]

    signs = sign[faces]
    crossed = (signs.max(axis=1) > 0) & (signs.min(axis=1) < 0)
    kept = [tuple(face) for face in faces[~crossed].tolist()]
    below = list(signs[~crossed].max(axis=1) <= 0)
    flat = (signs[~crossed] == 0).all(axis=1)
    for face in faces[crossed].tolist():
        sides: dict[bool, list[int]] = {True: [], False: []}
        for i, j in zip(face, face[1:] + face[:1], strict=True):
            if sign[i] <= 0:
                sides[True].append(i)
            if sign[i] >= 0:
                sides[False].append(i)
            if sign[i] * sign[j] < 0:
                middle = crossing(i, j)
                sides[True].append(middle)
                sides[False].append(middle)
        for side, polygon in sides.items():
            for k in range(1, len(polygon) - 1):
                kept.append((polygon[0], polygon[k], polygon[k + 1]))
                below.append(side)
    del flat
    points = np.vstack([vertices, np.array(new)]) if new else vertices
    return points, np.array(kept, dtype=np.int64), np.array(below)


def _named(
    body: Body, vertices: FloatArray, loops: tuple[IntArray, ...], part: str
) -> dict[str, IntArray]:
    named = {}
    open_tubes = [tube for tube in body.tubes if tube.is_open]
    for loop in loops:
        middle = vertices[loop].mean(axis=0)
        nearest = min(open_tubes, key=lambda tube: float(np.linalg.norm(tube.end - middle)))
        named[f"{part}.{nearest.name}"] = loop
    assert len(named) == len(loops) == len(open_tubes), (len(named), len(loops), len(open_tubes))
    return named
