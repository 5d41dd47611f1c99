"""Meshes of deformed implicit bodies, each on its own grid, opened along exact curves.

The surface {f(phi^-1(x)) = 0} is contoured in world space on a randomly turned and shifted grid,
so that no two shapes share vertices; every vertex also knows its material point, with which the
mesh is cut, relaxed and projected exactly (`relaxation`).
"""

import numpy as np
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from ostiform.arrays import BoolArray, FloatArray, IntArray
from ostiform.demo.deformation import Deformation
from ostiform.demo.implicit import Anatomy
from ostiform.demo.relaxation import Sheet, project_to_surface, relaxed
from ostiform.demo.splitting import split_along
from ostiform.errors import TopologyError
from ostiform.surface import (
    Surface,
    boundary_loops,
    edge_faces,
    enclosed_volume,
    euler_characteristic,
    unique_edges,
    zero_set,
)

_GRID_PER_EDGE = 0.97
"""Grid spacing over mean edge: a contour whose vertices near grid nodes are merged has about
1.08 vertices per squared spacing, an equilateral mesh 1.15 per squared edge."""
_MERGE_SHARE = 0.3
"""Contour vertices within this share of the spacing of a node are merged into one."""
_BAND_NODES = 2
_ATTEMPTS = 6


def canonical_points(anatomy: Anatomy, spacing_mm: float) -> FloatArray:
    """Return points (n, 3) on the material surface, mm, no further apart than the spacing.

    Their images say where a shape lies in space; they are vertices of no shape.
    """
    low, high = anatomy.bounds()
    counts = np.ceil((high - low) / spacing_mm).astype(np.int64) + 1
    axes = [low[k] + spacing_mm * np.arange(counts[k]) for k in range(3)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)  # (nx, ny, nz, 3)
    found = []
    for slab in nodes:
        points = slab.reshape(-1, 3)
        value, gradient = anatomy.level(points)
        near = np.abs(value) < spacing_mm
        squared = np.einsum("ij,ij->i", gradient[near], gradient[near])
        found.append(points[near] - (value[near] / squared)[:, None] * gradient[near])
    return np.concatenate(found)


def extract(
    anatomy: Anatomy,
    deformation: Deformation,
    edge_mm: float,
    rng: np.random.Generator,
    canonical: FloatArray,
) -> dict[str, Surface]:
    """Return the parts of a deformed body as surfaces with named loops.

    Parameters
    ----------
    anatomy : Anatomy
    deformation : Deformation
        From material to world coordinates.
    edge_mm : float
        Aimed mean edge length, mm.
    rng : numpy.random.Generator
        Turns and shifts the grid.
    canonical : (n, 3) float64, mm
        `canonical_points` of the anatomy, about one edge apart.

    Returns
    -------
    dict of str to Surface
        In the order of `Anatomy.seeds`. Vertices lie on the true surface, those of rims and
        seams also on the cutting surfaces; both sides of a seam hold the same positions.

    Raises
    ------
    TopologyError
        If no grid gives surfaces of sphere topology with the named openings.
    """
    world = deformation.forward(canonical)
    failures = []
    for _ in range(_ATTEMPTS):
        try:
            sheet = _contour(anatomy, deformation, world, edge_mm, rng)
            for index in range(len(anatomy.cuts)):
                sheet = split_along(sheet, anatomy, index, edge_mm)
            sheet = relaxed(_kept_parts(sheet, anatomy), anatomy, deformation, edge_mm)
            return {part: _part_surface(sheet, anatomy, part) for part in anatomy.seeds}
        except TopologyError as error:
            failures.append(str(error))
    raise TopologyError(
        f"implicit body: expected parts {', '.join(anatomy.seeds)} with their openings from one of "
        f"{_ATTEMPTS} grids, found: {failures[-1]}; use a smaller edge than {edge_mm:.3g} mm"
    )


def _contour(
    anatomy: Anatomy,
    deformation: Deformation,
    world: FloatArray,
    edge_mm: float,
    rng: np.random.Generator,
) -> Sheet:
    spacing = _GRID_PER_EDGE * edge_mm
    turn = _random_rotation(rng)
    local = world @ turn / spacing  # (n, 3), node units
    low = np.floor(local.min(axis=0)) - _BAND_NODES - 2.0 + rng.uniform(size=3)
    shape = tuple(np.ceil(local.max(axis=0) - low).astype(np.int64) + _BAND_NODES + 3)
    band = np.zeros(shape, dtype=bool)
    band[tuple(np.rint(local - low).astype(np.int64).T)] = True
    band = ndimage.binary_dilation(band, np.ones((3, 3, 3), dtype=bool))
    band = ndimage.binary_dilation(band)

    nodes = np.argwhere(band)
    material = deformation.inverse(((nodes + low) * spacing) @ turn.T)
    level = np.zeros(shape)
    level[band] = anatomy.level(material)[0]
    _fill_signs(level, band)

    vertices, faces = _merged_at_nodes(*zero_set(level), shape)
    points = ((vertices + low) * spacing) @ turn.T
    material = project_to_surface(anatomy, deformation.inverse(points), steps=2)
    _check_closed(faces)
    if enclosed_volume(points, faces) < 0.0:
        faces = faces[:, [0, 2, 1]]
    none = np.full(len(material), -1, dtype=np.int64)
    return Sheet(material, faces, none, np.zeros(len(faces), dtype=np.int64))


def _fill_signs(level: FloatArray, band: BoolArray) -> None:
    # Nodes outside the band take the sign of the band that they touch.
    regions, count = ndimage.label(~band)
    signs = np.zeros(count + 1)
    for axis in range(3):
        for a, b in ((slice(None, -1), slice(1, None)), (slice(1, None), slice(None, -1))):
            here = tuple(a if k == axis else slice(None) for k in range(3))
            there = tuple(b if k == axis else slice(None) for k in range(3))
            touching = band[here] & ~band[there]
            np.add.at(signs, regions[there][touching], np.sign(level[here][touching]))
    outside = np.where(signs < 0.0, -1.0, 1.0) * 1e3
    level[~band] = outside[regions[~band]]


def _merged_at_nodes(
    vertices: FloatArray, faces: IntArray, shape: tuple[int, ...]
) -> tuple[FloatArray, IntArray]:
    # Contour vertices lie on grid edges; those close to the same node become one vertex.
    node = np.rint(vertices)
    close = np.abs(vertices - node).max(axis=1) < _MERGE_SHARE
    key = np.arange(len(vertices)) + int(np.prod(shape))
    key[close] = np.ravel_multi_index(tuple(node[close].astype(np.int64).T), shape)
    _, label = np.unique(key, return_inverse=True)
    count = np.bincount(label)
    merged = np.stack([np.bincount(label, vertices[:, k]) / count for k in range(3)], axis=1)
    faces = label[faces]
    distinct = (
        (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    )
    faces = faces[distinct]
    # Two faces of the same three vertices are a fold pressed flat by the merging.
    n, ordered = len(merged), np.sort(faces, axis=1)
    keys = (ordered[:, 0] * n + ordered[:, 1]) * n + ordered[:, 2]
    _, label, count = np.unique(keys, return_inverse=True, return_counts=True)
    faces = faces[count[label] == 1]
    used, relabelled = np.unique(faces, return_inverse=True)
    return merged[used], relabelled.reshape(-1, 3)


def _check_closed(faces: IntArray) -> None:
    _, _, count = unique_edges(faces)
    if (count != 2).any():
        raise TopologyError(
            f"the contour has {int((count != 2).sum())} edges that do not join two faces"
        )


def _kept_parts(sheet: Sheet, anatomy: Anatomy) -> Sheet:
    """Return the faces connected to the parts' seeds without crossing a curve, side = part."""
    faces = sheet.faces
    edges, sides = edge_faces(faces)
    left, right = sides.T
    start, end = sheet.curve[edges].T
    passable = (right >= 0) & (
        (start < 0) | (start != end) | (sheet.side[left] == sheet.side[right])
    )
    left, right = left[passable], right[passable]
    links = coo_matrix((np.ones(len(left)), (left, right)), shape=(len(faces), len(faces)))
    _, label = connected_components(links, directed=False)
    centers = sheet.material[faces].mean(axis=1)
    part = np.full(len(faces), -1, dtype=np.int64)
    for index, seed in enumerate(anatomy.seeds.values()):
        nearest = int(((centers - seed) ** 2).sum(axis=1).argmin())
        part[label == label[nearest]] = index
    kept = part >= 0
    used, relabelled = np.unique(faces[kept], return_inverse=True)
    return Sheet(sheet.material[used], relabelled.reshape(-1, 3), sheet.curve[used], part[kept])


def _part_surface(sheet: Sheet, anatomy: Anatomy, part: str) -> Surface:
    index = list(anatomy.seeds).index(part)
    used, relabelled = np.unique(sheet.faces[sheet.side == index], return_inverse=True)
    faces = relabelled.reshape(-1, 3)
    if not len(faces):
        raise TopologyError(f"{part} is not divided from the other parts")
    curve = sheet.curve[used]
    wanted = {anatomy.cuts.index(cut): ostium for ostium, _, cut in anatomy.part_cuts(part)}
    loops: dict[str, IntArray] = {}
    for loop in boundary_loops(faces):
        on = np.unique(curve[loop])
        if len(on) != 1 or int(on[0]) not in wanted or wanted[int(on[0])] in loops:
            raise TopologyError(f"an opening of {part} does not run along one cut")
        loops[wanted[int(on[0])]] = loop
    if len(loops) != len(wanted):
        raise TopologyError(f"{part} has {len(loops)} of {len(wanted)} openings")
    if euler_characteristic(faces) != 2 - len(loops):
        raise TopologyError(f"{part} is not a sphere with {len(loops)} openings")
    ordered = {ostium: loops[ostium] for ostium in wanted.values()}
    return Surface(sheet.world[used], faces, ordered)


def _random_rotation(rng: np.random.Generator) -> FloatArray:
    w, x, y, z = (q := rng.normal(size=4)) / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
