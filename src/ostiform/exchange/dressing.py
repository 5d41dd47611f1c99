"""Surfaces for particles: one shape's mesh carried to the others by the particles' displacement."""

import numpy as np
from scipy.interpolate import RBFInterpolator

from ostiform.arrays import FloatArray, IntArray
from ostiform.errors import InputError
from ostiform.exchange.vertex_order import DEFAULT_PART, OrderedShapes
from ostiform.model import ModelMesh
from ostiform.surface import oriented_outward


def medoid_shape(aligned: FloatArray) -> int:
    """Return the index of the shape (N, P, 3) nearest to the mean of all."""
    squared = ((aligned - aligned.mean(axis=0)) ** 2).sum(axis=(1, 2))
    return int(np.argmin(squared))


def dressed(
    particles: OrderedShapes, reference: int, vertices: FloatArray, faces: IntArray
) -> OrderedShapes:
    """Return shapes with the mesh of one of them, moved as the particles move.

    The displacement between the particles is interpolated by biharmonic splines (kernel r with a
    linear polynomial, the smoothest interpolant in space; Duchon 1977). It passes through every
    particle; between particles the surface is smooth rather than the input's.

    Parameters
    ----------
    particles : OrderedShapes
        At least 4 particles that do not lie in one plane.
    reference : int
        The shape that the mesh belongs to.
    vertices : (V, 3) float64, mm
        In the frame of that shape's particles.
    faces : (F, 3) int64

    Raises
    ------
    InputError
        If the particles lie in one plane or coincide.
    """
    anchors = particles.points[reference]
    shapes = []
    for points in particles.points:
        try:
            field = RBFInterpolator(anchors, points - anchors, kernel="linear", degree=1)
        except (np.linalg.LinAlgError, ValueError) as error:
            raise InputError(
                f"particles of {particles.ids[reference]}: expected distinct points that span "
                f"space, found that {error}"
            ) from None
        shapes.append(vertices + field(vertices))
    mesh = ModelMesh(
        faces=oriented_outward(vertices, faces),
        face_part=np.zeros(len(faces), dtype=np.int64),
        part=np.zeros(len(vertices), dtype=np.int64),
        parts=(DEFAULT_PART,),
        loops={},
    )
    note = (
        f"surfaces: the mesh of {particles.ids[reference]} moved by biharmonic splines through "
        f"{len(anchors)} particles"
    )
    return OrderedShapes(particles.ids, np.stack(shapes), mesh, (note,))
