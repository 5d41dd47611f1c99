"""Near-equilateral triangles on a deformed implicit body: edge flips and tangential smoothing.

All moves are made on material points, so vertices stay on the true surface and on their curves.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.compiled import kernel
from ostiform.demo.deformation import Deformation
from ostiform.demo.implicit import Anatomy
from ostiform.demo.inversion import solve3
from ostiform.surface import edge_faces, half_edges, twin_half_edges

PROJECTION_STEPS = 8
"""Newton squares the error: eight steps end at round-off from any start within half an edge."""
_PROJECTED_MM = 1e-12
_SWEEPS = (2, 3, 3)
"""Sweeps between removals of vertices of three faces."""
_DAMPING = 0.8


@dataclass(frozen=True, slots=True, eq=False)
class Sheet:
    """A mesh under construction.

    Attributes
    ----------
    material : (V, 3) float64, mm
        Material point of each vertex.
    faces : (F, 3) int64
    curve : (V,) int64
        Index of the cut whose curve a vertex lies on, or -1.
    side : (F,) int64
        Which side or part a face belongs to; edges between sides are kept.
    world : (V, 3) float64, mm
        Positions, once known.
    """

    material: FloatArray
    faces: IntArray
    curve: IntArray
    side: IntArray
    world: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))


def project_to_surface(
    anatomy: Anatomy, points: FloatArray, steps: int = PROJECTION_STEPS
) -> FloatArray:
    """Return material points (n, 3) moved onto {f = 0} by Newton's method along the gradient."""
    points = points.copy()
    for _ in range(steps):
        value, gradient = anatomy.level(points)
        if np.abs(value).max(initial=0.0) < _PROJECTED_MM:
            break
        points -= (value / np.einsum("ij,ij->i", gradient, gradient))[:, None] * gradient
    return points


def project_to_curves(
    anatomy: Anatomy, points: FloatArray, curve: IntArray, steps: int = PROJECTION_STEPS
) -> FloatArray:
    """Return material points (n, 3) moved onto {f = 0} and the surface of cut `curve[i]`.

    Newton's method; each step is the shortest that meets both linearised constraints.
    """
    points = points.copy()
    for _ in range(steps):
        value, gradient = anatomy.level(points)
        height, slope = cut_slopes(anatomy, points, curve)
        if max(np.abs(value).max(initial=0.0), np.abs(height).max(initial=0.0)) < _PROJECTED_MM:
            break
        normal = np.einsum("ij,ij->i", gradient, gradient)
        mixed = np.einsum("ij,ij->i", gradient, slope)
        steep = np.einsum("ij,ij->i", slope, slope)
        determinant = normal * steep - mixed**2
        along = (steep * value - mixed * height) / determinant
        across = (normal * height - mixed * value) / determinant
        points -= along[:, None] * gradient + across[:, None] * slope
    return points


def cut_slopes(
    anatomy: Anatomy, points: FloatArray, curve: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Return the heights (n,) of points over the surfaces of their cuts, and gradients (n, 3)."""
    height, slope = np.zeros(len(points)), np.zeros_like(points)
    for index in np.unique(curve):
        on = curve == index
        height[on], slope[on] = anatomy.cuts[index].height(points[on])
    return height, slope


def relaxed(sheet: Sheet, anatomy: Anatomy, deformation: Deformation, edge_mm: float) -> Sheet:
    """Return the sheet with flipped edges and evenly spread vertices, and its world positions."""
    for sweeps in _SWEEPS:
        sheet = _without_triple_vertices(_swept(sheet, anatomy, deformation, edge_mm, sweeps))
    material, free = sheet.material.copy(), sheet.curve < 0
    material[free] = project_to_surface(anatomy, material[free])
    material[~free] = project_to_curves(anatomy, material[~free], sheet.curve[~free])
    return replace(sheet, material=material, world=deformation.forward(material))


def _swept(
    sheet: Sheet, anatomy: Anatomy, deformation: Deformation, edge_mm: float, sweeps: int
) -> Sheet:
    # Flips, then every vertex towards the mean of its neighbours (on a curve: along it).
    material, faces, curve = sheet.material.copy(), sheet.faces.copy(), sheet.curve
    free = curve < 0
    neighbours = _neighbours(faces, sheet.side)
    chain = _curve_edges(faces, sheet.side)
    # Points move by less than an edge or two: one Jacobian serves to turn steps into material.
    world, jacobian = deformation.linearised(material)
    metric = np.einsum("nki,nkj->nij", jacobian, jacobian)
    for _ in range(sweeps):
        _flip_to_delaunay(faces, neighbours, world, curve)
        half = half_edges(faces)
        target = _means(np.concatenate([half[free[half[:, 0]]], chain]), world)
        step = solve3(jacobian, _DAMPING * (target - world))
        longest = np.sqrt((step**2).sum(axis=1))
        step *= np.minimum(1.0, 0.5 * edge_mm / np.maximum(longest, 1e-12))[:, None]
        _, gradient = anatomy.level(material)
        step -= _off_surface(metric, gradient, step)
        material += step
        material[free] = project_to_surface(anatomy, material[free], steps=1)
        material[~free] = project_to_curves(anatomy, material[~free], curve[~free], steps=2)
        world = deformation.forward(material)
    _flip_to_delaunay(faces, neighbours, world, curve)
    return Sheet(material, faces, curve, sheet.side, world)


def _without_triple_vertices(sheet: Sheet) -> Sheet:
    # An inner vertex of three faces makes slivers that no flip can mend: the three become one.
    faces, side = sheet.faces.copy(), sheet.side.copy()
    triple = np.flatnonzero((np.bincount(faces.ravel()) == 3) & (sheet.curve < 0))
    kept = np.ones(len(faces), dtype=bool)
    for vertex in triple.tolist():
        around = np.flatnonzero((faces == vertex).any(axis=1) & kept)
        corners = faces[around]
        place = (corners == vertex).argmax(axis=1)
        after = dict(
            zip(
                corners[np.arange(len(around)), (place + 1) % 3].tolist(),
                corners[np.arange(len(around)), (place + 2) % 3].tolist(),
                strict=True,
            )
        )
        first = next(iter(after))
        ring = [first, after[first], after[after[first]]]
        curves = set(sheet.curve[ring].tolist())
        if len(around) != 3 or (len(curves) == 1 and curves != {-1}):
            continue
        faces[around[0]] = ring
        kept[around[1:]] = False
    used, relabelled = np.unique(faces[kept], return_inverse=True)
    return Sheet(
        sheet.material[used],
        relabelled.reshape(-1, 3),
        sheet.curve[used],
        side[kept],
        sheet.world[used],
    )


def _off_surface(metric: FloatArray, gradient: FloatArray, step: FloatArray) -> FloatArray:
    # The part of a material step that leaves the surface along the world normal: its direction in
    # material space is (J^T J)^-1 grad f.
    normal = solve3(metric, gradient)
    share = np.einsum("ij,ij->i", gradient, step) / np.einsum("ij,ij->i", gradient, normal)
    outward: FloatArray = share[:, None] * normal
    return outward


def _curve_edges(faces: IntArray, side: IntArray) -> IntArray:
    # Both directions of the edges along open rims and between parts.
    edges, sides = edge_faces(faces)
    left, right = sides.T
    border = edges[(right < 0) | (side[left] != side[right])]
    return np.concatenate([border, border[:, ::-1]])


def _means(pairs: IntArray, values: FloatArray) -> FloatArray:
    count = np.bincount(pairs[:, 0], minlength=len(values))
    sums = [np.bincount(pairs[:, 0], values[pairs[:, 1], k], len(values)) for k in range(3)]
    return np.stack(sums, axis=1) / np.maximum(count, 1)[:, None]


def _neighbours(faces: IntArray, side: IntArray) -> IntArray:
    # Across the edge opposite each corner (F, 3): the face there, or -1 at a rim or another side.
    twins = twin_half_edges(faces, int(faces.max()) + 1).reshape(-1, 3)[:, [1, 2, 0]]
    found = np.where(twins >= 0, twins // 3, -1)
    return np.where(side[found] == side[:, None], found, -1)


@kernel
def _flip_to_delaunay(
    faces: IntArray, neighbours: IntArray, world: FloatArray, curve: IntArray
) -> int:
    """Flip edges in place until all are locally Delaunay, and return the number of flips.

    An edge is flipped when its opposite angles sum to more than pi, or when it joins two vertices
    of one curve through the interior; never when the new edge would do so, exists already, or
    would turn a triangle over.
    """
    stack = [(f, k) for f in range(len(faces)) for k in range(3) if neighbours[f, k] > f]
    flips = 0
    while len(stack) > 0 and flips < 6 * len(faces):
        f, k = stack.pop()
        g = neighbours[f, k]
        if g < 0:
            continue
        m = 0
        while neighbours[g, m] != f:
            m += 1
        c, a, b = faces[f, k], faces[f, (k + 1) % 3], faces[f, (k + 2) % 3]
        d = faces[g, m]
        chord = curve[a] >= 0 and curve[a] == curve[b]
        if not chord and _sine_of_sum(world, a, b, c, d) > -1e-9:
            continue
        if curve[c] >= 0 and curve[c] == curve[d]:
            continue
        if not _stays_upright(world, a, b, c, d) or _joined(faces, neighbours, f, c, d):
            continue
        # Faces f = (c, a, b), g = (d, b, a) become (c, a, d) and (d, b, c).
        bc, ca = neighbours[f, (k + 1) % 3], neighbours[f, (k + 2) % 3]
        ad, db = neighbours[g, (m + 1) % 3], neighbours[g, (m + 2) % 3]
        faces[f, 0], faces[f, 1], faces[f, 2] = c, a, d
        faces[g, 0], faces[g, 1], faces[g, 2] = d, b, c
        neighbours[f, 0], neighbours[f, 1], neighbours[f, 2] = ad, g, ca
        neighbours[g, 0], neighbours[g, 1], neighbours[g, 2] = bc, f, db
        for j in range(3):
            if ad >= 0 and neighbours[ad, j] == g:
                neighbours[ad, j] = f
                break
        for j in range(3):
            if bc >= 0 and neighbours[bc, j] == f:
                neighbours[bc, j] = g
                break
        flips += 1
        stack.append((f, 0))
        stack.append((f, 2))
        stack.append((g, 0))
        stack.append((g, 2))
    return flips


@kernel
def _sine_of_sum(world: FloatArray, a: int, b: int, c: int, d: int) -> float:
    # Sine of the sum of the angles at c and d opposite the edge a b.
    sine_c = _length(_normal(world, c, a, b))
    sine_d = _length(_normal(world, d, a, b))
    cosine_c = cosine_d = 0.0
    for j in range(3):
        cosine_c += (world[a, j] - world[c, j]) * (world[b, j] - world[c, j])
        cosine_d += (world[a, j] - world[d, j]) * (world[b, j] - world[d, j])
    scale = np.hypot(sine_c, cosine_c) * np.hypot(sine_d, cosine_d)
    return float((sine_c * cosine_d + cosine_c * sine_d) / scale)


@kernel
def _stays_upright(world: FloatArray, a: int, b: int, c: int, d: int) -> bool:
    one, two = _normal(world, a, b, c), _normal(world, b, a, d)
    first, second = _normal(world, c, a, d), _normal(world, d, b, c)
    up_first = up_second = 0.0
    for j in range(3):
        up_first += (one[j] + two[j]) * first[j]
        up_second += (one[j] + two[j]) * second[j]
    return up_first > 0.0 and up_second > 0.0


@kernel
def _normal(world: FloatArray, a: int, b: int, c: int) -> tuple[float, float, float]:
    ux, uy, uz = (
        world[b, 0] - world[a, 0],
        world[b, 1] - world[a, 1],
        world[b, 2] - world[a, 2],
    )
    vx, vy, vz = (
        world[c, 0] - world[a, 0],
        world[c, 1] - world[a, 1],
        world[c, 2] - world[a, 2],
    )
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx


@kernel
def _length(vector: tuple[float, float, float]) -> float:
    return float(np.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2))


@kernel
def _joined(faces: IntArray, neighbours: IntArray, start: int, c: int, d: int) -> bool:
    # Whether an edge joins c and d: walk round c in both directions.
    for direction in (1, 2):
        f = start
        while f >= 0:
            k = 0
            while faces[f, k] != c:
                k += 1
            if faces[f, (k + 1) % 3] == d or faces[f, (k + 2) % 3] == d:
                return True
            f = neighbours[f, (k + direction) % 3]
            if f == start:
                return False
    return False
