"""The data as linear observations of the model's points, paired anew in every iteration.

An observation says that a point of the model's surface, seen along one to three directions, lies
at a point of the data. Surfaces pair both ways, each direction with half of the weight: points of
the model with the nearest point of the target along the target's normal, points of the target
with the nearest point of the model along the model's. Where the target ends, its edge attracts
nothing: pairs at a target's boundary are left out, and only boundaries that are openings of the
model pull, on the opening's rim and only across it.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ostiform.arrays import BoolArray, FloatArray, IntArray
from ostiform.errors import InputError
from ostiform.fitting.data import LANDMARKS, RIMS, SURFACE, Data, PointSet, PreparedSurface
from ostiform.fitting.landmarks import Labelled
from ostiform.fitting.patches import closest_on_curve, curve_samples
from ostiform.fitting.prior import FitPrior
from ostiform.surface import SurfaceTree, closest_points, surface_tree, vertex_normals


@dataclass(frozen=True, slots=True, eq=False)
class ModelSurface:
    """The model's surface at one moment of the fit, in the target's frame."""

    points: FloatArray
    normals: FloatArray
    trees: Mapping[str | None, SurfaceTree]
    capped: Mapping[str | None, SurfaceTree]


@dataclass(frozen=True, slots=True, eq=False)
class Observations:
    """Rows ``direction . (goal - point)`` of the linear problem, gathered into observations.

    Attributes
    ----------
    corners : (n, 3) int64
        The model's points that each row's point is interpolated from.
    barycentric : (n, 3) float64
    directions : (n, 3) float64
        Unit vectors in the target's frame.
    goals : (n, 3) float64, mm
    owner : (n,) int64
        The observation that each row belongs to.
    weight : (m,) float64
        Of each observation, as a number of independent ones.
    size : (m,) float64
        Number of its rows.
    kind : (m,) int64
        Index into `KINDS`.
    distance : (m,) float64, mm
        Between point and goal.
    slice : (m,) int64
        The slice that the goal was seen in; -1 for none.
    """

    corners: IntArray
    barycentric: FloatArray
    directions: FloatArray
    goals: FloatArray
    owner: IntArray
    weight: FloatArray
    size: FloatArray
    kind: IntArray
    distance: FloatArray
    slice: IntArray


def model_surface(prior: FitPrior, data: Data, points: FloatArray) -> ModelSurface:
    """Return the model's surface (Q, 3) with its search trees, one per part that is asked for."""
    vertices = np.ascontiguousarray(points[: len(prior.model.mean)])
    trees = {part: surface_tree(vertices, patch.faces) for part, patch in data.patches.items()}
    everything = np.ascontiguousarray(points)
    capped = {part: surface_tree(everything, patch.faces) for part, patch in data.capped.items()}
    return ModelSurface(points, vertex_normals(vertices, prior.model.mesh.faces), trees, capped)


class _Gatherer:
    """Collects blocks of observations of equal size."""

    def __init__(self) -> None:
        self.blocks: list[tuple[FloatArray | IntArray, ...]] = []
        self.count = 0

    def add(
        self,
        kind: int,
        corners: IntArray,
        barycentric: FloatArray,
        directions: FloatArray,
        goals: FloatArray,
        weight: FloatArray,
        distance: FloatArray,
        slices: IntArray | None = None,
    ) -> None:
        """Add n observations with directions (n, d, 3)."""
        n, d = directions.shape[:2]
        keep = np.flatnonzero(weight > 0.0)
        if not len(keep):
            return
        self.blocks.append(
            (
                np.repeat(corners[keep], d, axis=0),
                np.repeat(barycentric[keep], d, axis=0),
                directions[keep].reshape(-1, 3),
                np.repeat(goals[keep], d, axis=0),
                np.repeat(self.count + np.arange(len(keep)), d),
                weight[keep],
                np.full(len(keep), float(d)),
                np.full(len(keep), kind),
                distance[keep],
                np.full(len(keep), -1) if slices is None else slices[keep],
            )
        )
        self.count += len(keep)

    def gathered(self) -> Observations:
        """Return all together."""
        if not self.blocks:
            raise InputError(
                "a fit: expected data near the model's surface, found none; check the units, the "
                "frame and the pose"
            )
        joined = [np.concatenate([block[k] for block in self.blocks]) for k in range(10)]
        return Observations(
            joined[0].astype(np.int64),
            np.ascontiguousarray(joined[1]),
            np.ascontiguousarray(joined[2]),
            *joined[3:],
        )


def observations(
    prior: FitPrior, data: Data, model: ModelSurface, gated: bool, stride: int = 1
) -> Observations:
    """Pair the data with the model's surface as it lies.

    Parameters
    ----------
    prior : FitPrior
    data : Data
    model : ModelSurface
    gated : bool
        Whether surfaces pair only where their normals agree, and not across the model's own
        boundary: once the pose is known.
    stride : int
        Take every so manieth point of the model.
    """
    gather = _Gatherer()
    for surface in data.surfaces:
        _from_surface(gather, data, surface, model, gated)
        _from_model(gather, data, surface, model, gated, stride)
        for name, curve in surface.rims.items():
            _rims(gather, prior, model, name, curve)
    for item in data.point_sets:
        if item.rim is not None:
            rim = prior.model.mesh.loops[item.rim]
            _onto_rim(gather, item.kind, model, rim, item.points, 1.0, item.slices)
        elif item.is_outline:
            _from_outline(gather, data, item, model)
        else:
            _from_points(gather, data, item, model)
    _landmarks(gather, prior, data.labelled, model)
    return gather.gathered()


def _from_surface(
    gather: _Gatherer, data: Data, surface: PreparedSurface, model: ModelSurface, gated: bool
) -> None:
    patch = data.patches[surface.part]
    found = closest_points(model.trees[surface.part], surface.samples)
    corners = patch.faces[found.faces]
    normals = _unit(np.einsum("nk,nki->ni", found.barycentric, model.normals[corners]))
    weight = np.full(len(corners), surface.sample_weight)
    if gated:
        agree = surface.sign * np.einsum("ni,ni->n", normals, surface.sample_normals)
        weight = weight * np.maximum(agree, 0.0) * ~patch.ends_at(found)
    gather.add(
        SURFACE,
        corners,
        found.barycentric,
        normals[:, None],
        surface.samples,
        weight,
        found.distances,
    )


def _from_model(
    gather: _Gatherer,
    data: Data,
    surface: PreparedSurface,
    model: ModelSurface,
    gated: bool,
    stride: int,
) -> None:
    points = np.unique(data.patches[surface.part].faces)[::stride]
    found = closest_points(surface.tree, model.points[points])
    corners = surface.patch.faces[found.faces]
    normals = _unit(np.einsum("nk,nki->ni", found.barycentric, surface.normals[corners]))
    weight = 0.5 * stride * data.point_weights[points] * ~surface.patch.ends_at(found)
    if gated:
        agree = surface.sign * np.einsum("ni,ni->n", normals, model.normals[points])
        weight = weight * np.maximum(agree, 0.0)
    gather.add(
        SURFACE,
        np.repeat(points[:, None], 3, axis=1),
        np.tile([1.0, 0.0, 0.0], (len(points), 1)),
        normals[:, None],
        found.points,
        weight,
        found.distances,
    )


def _from_points(gather: _Gatherer, data: Data, item: PointSet, model: ModelSurface) -> None:
    patch = data.patches[item.part]
    found = closest_points(model.trees[item.part], item.points)
    corners = patch.faces[found.faces]
    normals = _unit(np.einsum("nk,nki->ni", found.barycentric, model.normals[corners]))
    # Beyond the model's own end the whole offset counts: there must be surface that reaches there.
    beyond = patch.ends_at(found) & (found.distances > 0.0)
    offset = (item.points - found.points) / np.maximum(found.distances, 1e-300)[:, None]
    directions = np.where(beyond[:, None], offset, normals)
    gather.add(
        item.kind,
        corners,
        found.barycentric,
        directions[:, None],
        item.points,
        np.ones(len(corners)),
        found.distances,
        item.slices,
    )


def _from_outline(gather: _Gatherer, data: Data, item: PointSet, model: ModelSurface) -> None:
    """Pair the outline of a body with the surface and the flat caps of its openings."""
    patch, tree = data.capped[item.part], model.capped[item.part]
    found = closest_points(tree, item.points)
    corners = patch.faces[found.faces]
    sides = model.points[corners]
    flat = np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0])
    on_wall: BoolArray = np.all(corners < len(model.normals), axis=1)
    smooth = model.normals[np.where(on_wall[:, None], corners, 0)]
    normals = np.einsum("nk,nki->ni", found.barycentric, smooth)
    gather.add(
        item.kind,
        corners,
        found.barycentric,
        _unit(np.where(on_wall[:, None], normals, flat))[:, None],
        item.points,
        np.ones(len(corners)),
        found.distances,
        item.slices,
    )


def _rims(
    gather: _Gatherer, prior: FitPrior, model: ModelSurface, name: str, curve: FloatArray
) -> None:
    rim = prior.model.mesh.loops[name]
    own = model.points[rim]
    edge, _, nearest = closest_on_curve(curve, own)
    tangent = np.roll(curve, -1, axis=0)[edge] - curve[edge]
    ones = np.tile([1.0, 0.0, 0.0], (len(rim), 1))
    gather.add(
        RIMS,
        np.repeat(rim[:, None], 3, axis=1),
        ones,
        _across(tangent),
        nearest,
        np.full(len(rim), 0.5),
        np.linalg.norm(nearest - own, axis=1),
    )
    closed = np.concatenate([curve, curve[:1]])
    length = float(np.linalg.norm(np.diff(closed, axis=0), axis=1).sum())
    _onto_rim(gather, RIMS, model, rim, curve_samples(closed, max(length / len(rim), 1e-12)), 0.5)


def _onto_rim(
    gather: _Gatherer,
    kind: int,
    model: ModelSurface,
    rim: IntArray,
    points: FloatArray,
    weight: float,
    slices: IntArray | None = None,
) -> None:
    own = model.points[rim]
    edge, fraction, nearest = closest_on_curve(own, points)
    following = np.roll(rim, -1)
    tangent = np.roll(own, -1, axis=0)[edge] - own[edge]
    gather.add(
        kind,
        np.stack([rim[edge], following[edge], rim[edge]], axis=1),
        np.stack([1.0 - fraction, fraction, np.zeros(len(edge))], axis=1),
        _across(tangent),
        points,
        np.full(len(points), weight),
        np.linalg.norm(nearest - points, axis=1),
        slices,
    )


def _landmarks(
    gather: _Gatherer, prior: FitPrior, landmarks: Labelled, model: ModelSurface
) -> None:
    if len(landmarks.points):
        n = len(landmarks.points)
        gather.add(
            LANDMARKS,
            np.repeat(landmarks.points[:, None], 3, axis=1),
            np.tile([1.0, 0.0, 0.0], (n, 1)),
            np.tile(np.eye(3), (n, 1, 1)),
            landmarks.positions,
            np.ones(n),
            np.linalg.norm(model.points[landmarks.points] - landmarks.positions, axis=1),
        )
    for name, positions in landmarks.on_rims.items():
        _onto_rim(gather, LANDMARKS, model, prior.model.mesh.loops[name], positions, 1.0)


def _unit(vectors: FloatArray) -> FloatArray:
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    unit: FloatArray = vectors / np.where(lengths > 0.0, lengths, 1.0)
    return unit


def _across(tangents: FloatArray) -> FloatArray:
    """Return two unit vectors (n, 2, 3) at right angles to each tangent and to each other."""
    along = _unit(tangents)
    helper = np.eye(3)[np.abs(along).argmin(axis=1)]
    first = _unit(np.cross(along, helper))
    return np.stack([first, np.cross(along, first)], axis=1)
