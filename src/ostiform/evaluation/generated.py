"""A generated population in its true correspondence: one mesh, carried by every deformation.

What a perfect correspondence would give. It takes seconds where the whole chain takes minutes, so
that questions about the model alone (how much do 20 subjects teach?) can be asked of as many
subjects as they need.
"""

from typing import Annotated

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.correspondence import align
from ostiform.demo import Deformation, Truth, canonical_points, extract
from ostiform.model import ModelMesh
from ostiform.study import ShapeId
from ostiform.surface import vertex_areas
from ostiform.values import Axes, value


@value
class TruePopulation:
    """Shapes whose points are the same material points.

    Attributes
    ----------
    ids : tuple of ShapeId
        The N shapes.
    points : (N, P, 3) float64, mm
        In input coordinates.
    aligned : (N, P, 3) float64, mm
        With one rigid transform per subject.
    weights : (P,) float64
        Area shares on the mean shape, sum 1.
    mesh : ModelMesh
    """

    ids: Annotated[tuple[ShapeId, ...], Axes("N")]
    points: Annotated[FloatArray, Axes("N", "P", 3)]
    aligned: Annotated[FloatArray, Axes("N", "P", 3)]
    weights: Annotated[FloatArray, Axes("P")]
    mesh: Annotated[ModelMesh, Axes("P")]


def true_population(truth: Truth, edge_mm: float) -> TruePopulation:
    """Return all shapes of a generated population at the vertices of one material mesh.

    Parameters
    ----------
    truth : Truth
    edge_mm : float
        Mean edge length of the mesh, mm.

    Raises
    ------
    TopologyError
        If the edge is too long to mesh the anatomy.
    """
    anatomy = truth.anatomy
    canonical = canonical_points(anatomy, edge_mm)
    rng = np.random.default_rng(truth.seed)
    parts = extract(anatomy, Deformation(()), edge_mm, rng, canonical)
    stacked = np.vstack([surface.vertices for surface in parts.values()])
    material, place = np.unique(stacked, axis=0, return_inverse=True)  # seams are stored once
    offsets = np.cumsum([0, *(len(surface.vertices) for surface in parts.values())])
    faces, face_part = [], []
    loops: dict[str, IntArray] = {}
    part = np.full(len(material), len(parts), dtype=np.int64)
    for index, (name, surface) in enumerate(parts.items()):
        own: IntArray = place[offsets[index] : offsets[index + 1]]
        faces.append(own[surface.faces])
        face_part.append(np.full(len(surface.faces), index))
        part[own] = np.minimum(part[own], index)
        loops |= {f"{name}.{ostium}": own[loop] for ostium, loop in surface.loops.items()}
    mesh = ModelMesh(np.vstack(faces), np.concatenate(face_part), part, tuple(parts), loops)
    points = np.stack([phi.forward(material) for phi in truth.deformations.values()])
    ids = tuple(truth.deformations)
    names = list(dict.fromkeys(id.subject for id in ids))
    areas = np.mean([vertex_areas(shape, mesh.faces) for shape in points], axis=0)
    weights = areas / areas.sum()
    groups = np.array([names.index(id.subject) for id in ids])
    return TruePopulation(
        ids, points, align(points, weights, "rigid", groups).aligned, weights, mesh
    )
