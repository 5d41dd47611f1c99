"""The same distribution of shapes on another triangulation: finer, coarser, or one that is given.

Every new point lies on a triangle of the model's mean and follows its corners with the barycentric
coordinates that it has there, in every shape: the new model is the image of the old one under a
linear map, exactly. Points of an opening's rim stay on that rim.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from ostiform.arrays import FloatArray, IntArray, frozen_floats, frozen_ints
from ostiform.errors import InputError, TopologyError
from ostiform.model.mesh import ModelMesh
from ostiform.surface import (
    boundary_loops,
    closest_points,
    isotropic_remeshed,
    surface_tree,
    vertex_areas,
)


@dataclass(frozen=True, slots=True, eq=False)
class Resampling:
    """Where new points lie on a model: each a convex combination of three of its points.

    Attributes
    ----------
    mesh : ModelMesh
        Of the new points.
    weights : (Q,) float64
        Area shares of the new points, sum 1.
    corners : (Q, 3) int64
    shares : (Q, 3) float64
    """

    mesh: ModelMesh
    weights: FloatArray
    corners: IntArray
    shares: FloatArray

    def carried(self, values: FloatArray) -> FloatArray:
        """Return values (P, ...) at the new points (Q, ...)."""
        shares = self.shares.reshape(*self.shares.shape, *(1,) * (values.ndim - 1))
        result: FloatArray = (values[self.corners] * shares).sum(axis=1)
        return result


def resampling(mean: FloatArray, mesh: ModelMesh, weights: FloatArray, n_points: int) -> Resampling:
    """Return a new, even triangulation of a mean shape (P, 3); see `ShapeModel.resampled`."""
    if not len(mesh.faces):
        raise InputError("a resampled model: expected a model with triangles, found none")
    curves: dict[frozenset[int], IntArray] = {}
    for loop in mesh.loops.values():
        curves.setdefault(frozenset(loop.tolist()), loop)
    remeshed = isotropic_remeshed(
        mean,
        mesh.faces,
        n_vertices=n_points,
        curves=tuple(curves.values()),
        labels=mesh.face_part,
    )
    new = _named_mesh(mean, mesh, remeshed.vertices, remeshed.faces, remeshed.labels)
    return _on_mesh(mean, mesh, weights, new, remeshed.vertices)


def resampling_onto(
    mean: FloatArray, mesh: ModelMesh, weights: FloatArray, vertices: FloatArray, faces: IntArray
) -> Resampling:
    """Return a given triangulation near a mean shape; see `ShapeModel.resampled_onto`."""
    given = frozen_floats(vertices, (None, 3), "vertices of a mesh to resample onto")
    triangles = frozen_ints(faces, (None, 3), "faces of a mesh to resample onto")
    if not len(triangles) or triangles.min() < 0 or triangles.max() >= len(given):
        raise InputError(
            f"faces of a mesh to resample onto: expected indices from 0 to {len(given) - 1}, found "
            + (f"{triangles.min()} to {triangles.max()}" if len(triangles) else "no triangle")
        )
    unused = len(given) - len(np.unique(triangles))
    if unused:
        raise InputError(
            "vertices of a mesh to resample onto: expected each in a triangle, found "
            f"{unused} in none: remove them"
        )
    nearest = closest_points(surface_tree(mean, mesh.faces), given[triangles].mean(axis=1))
    new = _named_mesh(mean, mesh, given, triangles, mesh.face_part[nearest.faces])
    return _on_mesh(mean, mesh, weights, new, given)


def _on_mesh(
    mean: FloatArray, mesh: ModelMesh, weights: FloatArray, new: ModelMesh, vertices: FloatArray
) -> Resampling:
    corners, shares = _places(mean, mesh, vertices, new)
    found = Resampling(new, weights, corners, shares)
    density = found.carried(point_density(mean, mesh, weights))
    return replace(found, weights=carried_weights(found.carried(mean), new.faces, density))


def _places(
    mean: FloatArray, mesh: ModelMesh, vertices: FloatArray, new_mesh: ModelMesh
) -> tuple[IntArray, FloatArray]:
    """Return the corners (Q, 3) that new points lie between, and their shares (Q, 3)."""
    found = closest_points(surface_tree(mean, mesh.faces), vertices)
    corners = np.array(mesh.faces[found.faces])
    shares = np.array(found.barycentric)
    rims = {frozenset(loop.tolist()) for loop in boundary_loops(mesh.faces)}
    for name, loop in mesh.loops.items():
        if frozenset(loop.tolist()) not in rims:
            continue
        new = new_mesh.loops[name]
        start, share = _along(mean[loop], vertices[new])
        following = np.roll(loop, -1)
        corners[new] = np.stack([loop[start], following[start], loop[start]], axis=1)
        shares[new] = np.stack([1.0 - share, share, np.zeros(len(new))], axis=1)
    return corners, shares


def _along(curve: FloatArray, points: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the edge (n,) of a closed curve (m, 3) nearest to each point, and how far along."""
    step = np.roll(curve, -1, axis=0) - curve  # (m, 3)
    squared = np.maximum((step**2).sum(axis=1), np.finfo(np.float64).tiny)
    offset = points[:, None] - curve  # (n, m, 3)
    share = np.clip((offset * step).sum(axis=2) / squared, 0.0, 1.0)  # (n, m)
    distance = ((offset - share[:, :, None] * step) ** 2).sum(axis=2)
    nearest: IntArray = distance.argmin(axis=1)
    return nearest, share[np.arange(len(points)), nearest]


def _named_mesh(
    mean: FloatArray,
    mesh: ModelMesh,
    vertices: FloatArray,
    faces: IntArray,
    face_part: IntArray,
) -> ModelMesh:
    """Name the boundaries of every part of a mesh as the model's are named."""
    part = np.full(len(vertices), len(mesh.parts))
    np.minimum.at(part, faces.ravel(), np.repeat(face_part, 3))
    loops: dict[str, IntArray] = {}
    for number, name in enumerate(mesh.parts):
        try:
            found = boundary_loops(faces[face_part == number])
        except TopologyError as error:
            raise TopologyError(f"part {name} of a mesh to resample onto: {error}") from None
        own = {key: v for key, v in mesh.loops.items() if key.startswith(f"{name}.")}
        if len(found) != len(own):
            raise InputError(
                f"part {name} of a mesh to resample onto: expected {len(own)} openings "
                f"({', '.join(own) or 'a closed surface'}), found {len(found)}"
            )
        loops.update(_matched(mean, own, vertices, found))
    ordered = {name: loops[name] for name in mesh.loops if name in loops}
    for name, loop in ordered.items():  # a seam point carries the first part of its seam
        part[loop] = mesh.part[mesh.loops[name][0]]
    return ModelMesh(faces, face_part, part, mesh.parts, ordered)


def _matched(
    mean: FloatArray,
    named: Mapping[str, IntArray],
    vertices: FloatArray,
    found: Sequence[IntArray],
) -> dict[str, IntArray]:
    """Give each loop found the name of the model's that it lies nearest to, one to one."""
    if not found:
        return {}
    cost = np.array(
        [
            [
                float(np.linalg.norm(vertices[new].mean(axis=0) - mean[own].mean(axis=0)))
                for new in found
            ]
            for own in named.values()
        ]
    )
    _, chosen = linear_sum_assignment(cost)
    return {name: found[int(index)] for name, index in zip(named, chosen, strict=True)}


def point_density(mean: FloatArray, mesh: ModelMesh, weights: FloatArray) -> FloatArray:
    """Return the weight per area (P,) of a model's points on its mean, 1 / mm^2."""
    areas = vertex_areas(mean, mesh.faces)
    used = areas > 0.0
    density = np.full(len(areas), 1.0 / max(float(areas.sum()), np.finfo(np.float64).tiny))
    density[used] = weights[used] / areas[used]
    return density


def carried_weights(mean: FloatArray, faces: IntArray, density: FloatArray) -> FloatArray:
    """Return the weights (Q,) of points with a density (Q,) of weight on a mean shape.

    Raises
    ------
    InputError
        If a point has no area.
    """
    weights = density * vertex_areas(mean, faces)
    if (weights <= 0.0).any():
        raise InputError(
            "a resampled model: expected every new point to have some area on the mean, found "
            f"{int((weights <= 0.0).sum())} without; give a mesh that lies nearer to the mean"
        )
    shares: FloatArray = weights / weights.sum()
    return shares
