"""The same distribution of shapes on another triangulation: finer, coarser, or one that is given.

Every new point lies on a triangle of the model's mean and follows its corners with the barycentric
coordinates that it has there, in every shape: the new model is the image of the old one under a
linear map, exactly. Points of an opening's rim stay on that rim.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from ostiform.arrays import FloatArray, IntArray, frozen_floats, frozen_ints
from ostiform.domain import Template, TemplateLevel
from ostiform.errors import InputError, TopologyError
from ostiform.model.pca import principal_modes, project, reconstruct, weighted_size
from ostiform.model.types import ModelMesh, ShapeModel, StoredModel
from ostiform.surface import (
    boundary_loops,
    closest_points,
    isotropic_remeshed,
    surface_tree,
    vertex_areas,
)


def resampled(model: ShapeModel, n_points: int) -> ShapeModel:
    """Return the model on a new, even triangulation of its mean.

    The mean is remeshed with nearly equilateral triangles of one size; rims and seams are kept as
    curves. The weights are the area shares of the new points: the old density of weight on the
    mean, carried over.

    Parameters
    ----------
    model : ShapeModel
    n_points : int
        Reached to within 2 %.

    Raises
    ------
    InputError
        If the model has no triangles, or `n_points` is below 4.
    ConvergenceError
        If the points are far too few for the rims and seams.
    """
    if not len(model.mesh.faces):
        raise InputError("a resampled model: expected a model with triangles, found none")
    curves: dict[frozenset[int], IntArray] = {}
    for loop in model.mesh.loops.values():
        curves.setdefault(frozenset(loop.tolist()), loop)
    remeshed = isotropic_remeshed(
        model.mean,
        model.mesh.faces,
        n_vertices=n_points,
        curves=tuple(curves.values()),
        labels=model.mesh.face_part,
    )
    return _on_mesh(model, remeshed.vertices, remeshed.faces, remeshed.labels)


def resampled_onto(model: ShapeModel, vertices: FloatArray, faces: IntArray) -> ShapeModel:
    """Return the model on a given triangulation that lies on or near its mean.

    Every vertex goes to the closest point of the mean, a rim vertex to the closest point of the
    model's rim. A triangle belongs to the part that its centroid is nearest to; where two parts
    meet, the seam runs along the edges of the given mesh.

    Parameters
    ----------
    model : ShapeModel
    vertices : (Q, 3) float64, mm
        In the model's frame; every one used by a triangle.
    faces : (F, 3) int64
        Counter-clockwise seen from outside.

    Raises
    ------
    InputError
        If an index is out of range, a vertex has no triangle, the openings of a part are not as
        many as the model's, or two vertices fall on one point so that no area is left to them.
    TopologyError
        If the mesh is not an oriented manifold.
    """
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
    tree = surface_tree(model.mean, model.mesh.faces)
    nearest = closest_points(tree, given[triangles].mean(axis=1))
    return _on_mesh(model, given, triangles, model.mesh.face_part[nearest.faces])


def at_level(stored: StoredModel, level: int) -> StoredModel:
    """Return the model on one of the nested coarser triangulations of its template.

    The points are some of the model's own; their weights are their area shares on the coarser
    mesh of the mean. The scores are those of the same shapes in the new modes.

    Parameters
    ----------
    stored : StoredModel
    level : int
        From 0, the coarsest.

    Raises
    ------
    InputError
        If there is no template or it has no such level.
    """
    template = stored.template
    n_levels = 0 if template is None else len(template.levels)
    if template is None or not 0 <= level < n_levels:
        raise InputError(
            "level of a model: expected a model whose template has the level, from 0 to "
            f"{n_levels - 1}, found {level}"
            if n_levels
            else "level of a model: expected a template with coarser levels, found none; use "
            "resampled instead"
        )
    coarse = _level_template(template, level)
    index = template.levels[level].index
    model = stored.model
    mesh = ModelMesh(coarse.faces, coarse.face_part, coarse.part, coarse.parts, coarse.loops)
    mean = model.mean[index]
    weights = _carried_weights(model, mean, mesh.faces, _density(model)[index])
    new = _image(model, mean, model.modes[:, index], weights, mesh)
    shapes = reconstruct(model, stored.scores)[:, index]
    return StoredModel(new, project(new, shapes), stored.ids, coarse)


def _on_mesh(
    model: ShapeModel, vertices: FloatArray, faces: IntArray, face_part: IntArray
) -> ShapeModel:
    mesh = _named_mesh(model, vertices, faces, face_part)
    places = _places(model, vertices, mesh)
    mean = places.carried(model.mean)
    modes = np.stack([places.carried(mode) for mode in model.modes]) if len(model.modes) else None
    weights = _carried_weights(model, mean, faces, places.carried(_density(model)))
    return _image(
        model, mean, np.empty((0, *mean.shape)) if modes is None else modes, weights, mesh
    )


def _image(
    model: ShapeModel, mean: FloatArray, modes: FloatArray, weights: FloatArray, mesh: ModelMesh
) -> ShapeModel:
    """Return the model of the same scores with the images (K, Q, 3) of its modes."""
    spread = np.sqrt(model.variances)[:, None, None]
    new_modes, variances = principal_modes(modes * spread, weights, weighted_size(mean, weights))
    return ShapeModel(
        mean=mean,
        modes=new_modes,
        variances=variances,
        weights=weights,
        mesh=mesh,
        residual_variance=model.residual_variance,
        sample_count=model.sample_count,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Places:
    """Where new points lie on a model: each a convex combination of three of its points."""

    corners: IntArray  # (Q, 3)
    shares: FloatArray  # (Q, 3)

    def carried(self, values: FloatArray) -> FloatArray:
        """Return values (P, ...) at the new points (Q, ...)."""
        shares = self.shares.reshape(*self.shares.shape, *(1,) * (values.ndim - 1))
        result: FloatArray = (values[self.corners] * shares).sum(axis=1)
        return result


def _places(model: ShapeModel, vertices: FloatArray, mesh: ModelMesh) -> _Places:
    found = closest_points(surface_tree(model.mean, model.mesh.faces), vertices)
    corners = np.array(model.mesh.faces[found.faces])  # (Q, 3)
    shares = np.array(found.barycentric)
    rims = {frozenset(loop.tolist()) for loop in boundary_loops(model.mesh.faces)}
    for name, loop in model.mesh.loops.items():
        if frozenset(loop.tolist()) not in rims:
            continue
        new = mesh.loops[name]
        start, share = _along(model.mean[loop], vertices[new])
        following = np.roll(loop, -1)
        corners[new] = np.stack([loop[start], following[start], loop[start]], axis=1)
        shares[new] = np.stack([1.0 - share, share, np.zeros(len(new))], axis=1)
    return _Places(corners, shares)


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
    model: ShapeModel, vertices: FloatArray, faces: IntArray, face_part: IntArray
) -> ModelMesh:
    """Name the boundaries of every part of a mesh as the model's are named."""
    part = np.full(len(vertices), len(model.mesh.parts))
    np.minimum.at(part, faces.ravel(), np.repeat(face_part, 3))
    loops: dict[str, IntArray] = {}
    for number, name in enumerate(model.mesh.parts):
        try:
            found = boundary_loops(faces[face_part == number])
        except TopologyError as error:
            raise TopologyError(f"part {name} of a mesh to resample onto: {error}") from None
        own = {key: v for key, v in model.mesh.loops.items() if key.startswith(f"{name}.")}
        if len(found) != len(own):
            raise InputError(
                f"part {name} of a mesh to resample onto: expected {len(own)} openings "
                f"({', '.join(own) or 'a closed surface'}), found {len(found)}"
            )
        loops.update(_matched(model.mean, own, vertices, found))
    ordered = {name: loops[name] for name in model.mesh.loops if name in loops}
    for name, loop in ordered.items():  # a seam point carries the first part of its seam
        part[loop] = model.mesh.part[model.mesh.loops[name][0]]
    return ModelMesh(faces, face_part, part, model.mesh.parts, ordered)


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


def _density(model: ShapeModel) -> FloatArray:
    """Return the weight per area (P,) of a model's points on its mean, 1 / mm^2."""
    areas = vertex_areas(model.mean, model.mesh.faces)
    used = areas > 0.0
    density = np.full(len(areas), 1.0 / max(float(areas.sum()), np.finfo(np.float64).tiny))
    density[used] = model.weights[used] / areas[used]
    return density


def _carried_weights(
    model: ShapeModel, mean: FloatArray, faces: IntArray, density: FloatArray
) -> FloatArray:
    weights = density * vertex_areas(mean, faces)
    if (weights <= 0.0).any():
        raise InputError(
            "a resampled model: expected every new point to have some area on the mean of the "
            f"{len(model.mean)}-point model, found {int((weights <= 0.0).sum())} without; give a "
            "mesh that lies nearer to the mean"
        )
    shares: FloatArray = weights / weights.sum()
    return shares


def _level_template(template: Template, level: int) -> Template:
    chosen = template.levels[level]
    place = np.full(len(template.points), -1, dtype=np.int64)
    place[chosen.index] = np.arange(len(chosen.index))
    return Template(
        points=template.points[chosen.index],
        sphere=template.sphere[chosen.index],
        part=template.part[chosen.index],
        faces=chosen.faces,
        face_part=chosen.face_part,
        parts=template.parts,
        curve=template.curve[chosen.index],
        curves=template.curves,
        loops={name: place[loop][place[loop] >= 0] for name, loop in template.loops.items()},
        levels=tuple(
            TemplateLevel(place[coarser.index], coarser.faces, coarser.face_part)
            for coarser in template.levels[:level]
        ),
    )
