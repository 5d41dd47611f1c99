"""The targets of a fit, prepared for pairing: surfaces, points, contours and landmarks."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.errors import InputError
from ostiform.fitting.landmarks import Labelled, labelled
from ostiform.fitting.patches import Patch, curve_samples, even_samples, open_patch
from ostiform.fitting.prior import FitPrior
from ostiform.fitting.types import (
    CloudTarget,
    ContourTarget,
    LandmarkTarget,
    SurfaceTarget,
    Target,
)
from ostiform.surface import SurfaceTree, surface_tree, vertex_areas, vertex_normals

KINDS = ("surface", "rims", "points", "contours", "landmarks")
"""Kinds of data; each has a noise of its own."""

SURFACE, RIMS, POINTS, CONTOURS, LANDMARKS = range(5)
MOST_POINTS = 4000
"""Of a cloud; a larger one is thinned evenly along its list."""


@dataclass(frozen=True, slots=True, eq=False)
class PreparedSurface:
    """A target surface ready for pairing.

    Attributes
    ----------
    part : str or None
    tree : SurfaceTree
    normals : (V, 3) float64
    patch : Patch
    samples : (n, 3) float64, mm
        Even over the surface.
    sample_normals : (n, 3) float64
    sample_weight : float
        Of each, as a number of independent observations.
    rims : mapping of str to (m, 3) float64
        Curves of the openings, by full name in the model.
    sign : float
        -1 where the faces run the other way round than the model's.
    """

    part: str | None
    tree: SurfaceTree
    normals: FloatArray
    patch: Patch
    samples: FloatArray
    sample_normals: FloatArray
    sample_weight: float
    rims: Mapping[str, FloatArray]
    sign: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class PointSet:
    """Points without connectivity, of one kind, on one part or on any.

    Attributes
    ----------
    kind : int
        Index into `KINDS`.
    part : str or None
    points : (n, 3) float64, mm
    slices : (n,) int64 or None
        The slice that each was seen in, whose shift is unknown; None where there are no slices.
    rim : str or None
        The opening on whose rim the points lie; None for points of the surface.
    is_outline : bool
        Whether they go round a body: across an opening they lie on its flat cap.
    """

    kind: int
    part: str | None
    points: FloatArray
    slices: IntArray | None = None
    rim: str | None = None
    is_outline: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Data:
    """All targets of a fit, ready for pairing.

    Attributes
    ----------
    surfaces : tuple of PreparedSurface
    point_sets : tuple of PointSet
    labelled : Labelled
        All landmarks.
    patches : mapping of part (None for all) to Patch
        The model's triangles that targets are paired with.
    capped : mapping of part (None for all) to Patch
        The same with a fan from the centre of every opening, for outlines.
    point_weights : (P,) float64
        Of the model's points, as numbers of independent observations; sum P.
    """

    surfaces: tuple[PreparedSurface, ...]
    point_sets: tuple[PointSet, ...]
    labelled: Labelled
    patches: Mapping[str | None, Patch]
    point_weights: FloatArray
    capped: Mapping[str | None, Patch] = field(default_factory=dict)

    @property
    def is_labelled_only(self) -> bool:
        """Whether there are landmarks and nothing else."""
        return not self.surfaces and not self.point_sets


def prepared_data(prior: FitPrior, targets: Sequence[Target]) -> Data:
    """Prepare targets for pairing with a model.

    Raises
    ------
    InputError
        If a part, an opening or a landmark is not of the model.
    TopologyError
        If a surface is no consistently oriented manifold.
    """
    mesh = prior.model.mesh
    parts = {t.part for t in targets if not isinstance(t, LandmarkTarget)}
    patches = {part: open_patch(part_faces(prior, part), len(mesh.part)) for part in parts}
    surfaces = []
    point_sets = []
    for target in targets:
        if isinstance(target, SurfaceTarget):
            surfaces.append(_prepared_surface(prior, target))
        elif isinstance(target, CloudTarget):
            stride = -(-len(target.points) // MOST_POINTS)
            point_sets.append(PointSet(POINTS, target.part, target.points[::stride]))
        elif isinstance(target, ContourTarget):
            samples = [curve_samples(c, prior.edge) for c in target.curves if len(c)]
            point_sets.append(PointSet(CONTOURS, target.part, np.concatenate(samples)))
    landmarks = [t for t in targets if isinstance(t, LandmarkTarget)]
    return Data(
        surfaces=tuple(surfaces),
        point_sets=tuple(point_sets),
        labelled=labelled(prior, landmarks),
        patches=patches,
        point_weights=prior.model.weights * len(prior.model.mean),
    )


def part_faces(prior: FitPrior, part: str | None) -> IntArray:
    """Return the model's triangles (F, 3) of a part, or all.

    Raises
    ------
    InputError
        If the model has no such part.
    """
    mesh = prior.model.mesh
    if part is None:
        return mesh.faces
    if part not in mesh.parts:
        raise InputError(f"part of a target: expected one of {', '.join(mesh.parts)}, found {part}")
    faces: IntArray = mesh.faces[mesh.face_part == mesh.parts.index(part)]
    return faces


def _prepared_surface(prior: FitPrior, target: SurfaceTarget) -> PreparedSurface:
    known = prior.model.mesh.loops
    for name in target.loops:
        if name not in known:
            raise InputError(
                f"opening of a target: expected one of {', '.join(known)}, found {name}"
            )
    vertices, faces = target.vertices, target.faces
    count = len(prior.model.mean)
    chosen, barycentric = even_samples(vertices, faces, count)
    normals = vertex_normals(vertices, faces)
    across = np.einsum("nk,nki->ni", barycentric, normals[faces[chosen]])
    area = float(vertex_areas(vertices, faces).sum())
    if not area > 0.0:
        raise InputError("a surface to fit to: expected triangles with area, found none")
    return PreparedSurface(
        part=target.part,
        tree=surface_tree(vertices, faces),
        normals=normals,
        patch=open_patch(faces, len(vertices)),
        samples=np.einsum("nk,nki->ni", barycentric, vertices[faces[chosen]]),
        sample_normals=across,
        sample_weight=0.5 * min(area / prior.area, 1.0),
        rims={name: vertices[loop] for name, loop in target.loops.items()},
    )


def sparser(data: Data, count: int) -> Data:
    """Return data with at most about `count` samples of each target, weights scaled up."""
    surfaces = []
    for surface in data.surfaces:
        stride = max(len(surface.samples) // count, 1)
        surfaces.append(
            replace(
                surface,
                samples=surface.samples[::stride],
                sample_normals=surface.sample_normals[::stride],
                sample_weight=surface.sample_weight * stride,
            )
        )
    sets = tuple(_thinned(item, max(len(item.points) // count, 1)) for item in data.point_sets)
    return replace(data, surfaces=tuple(surfaces), point_sets=sets)


def _thinned(item: PointSet, stride: int) -> PointSet:
    slices = None if item.slices is None else item.slices[::stride]
    return replace(item, points=item.points[::stride], slices=slices)
