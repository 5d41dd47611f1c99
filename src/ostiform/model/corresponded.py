"""Shapes in correspondence whatever brought them there: points, alignment and one mesh.

A `Correspondence` of this program also knows the sphere that its template was drawn on; shapes
whose correspondence was made elsewhere have no such sphere. Both are read from the same layout of
``correspondence.h5`` (design 7), of which the sphere is an optional part.
"""

from pathlib import Path
from typing import Annotated

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.correspondence import Correspondence
from ostiform.model.algebra import check_weights
from ostiform.model.hdf5 import (
    SHAPE_ARRAYS,
    check_schema,
    put_facts,
    put_ids,
    put_mesh,
    put_shapes,
    reading,
    take_loops,
    take_shapes,
    take_texts,
    writing,
)
from ostiform.model.mesh import ModelMesh, mesh_of_template
from ostiform.study import ShapeId
from ostiform.values import Axes, value


@value
class CorrespondedShapes:
    """N shapes that share the order of their P points, and the mesh on them.

    Attributes
    ----------
    ids : tuple of ShapeId
    points : (N, P, 3) float64, mm
        In each shape's own input coordinates.
    aligned : (N, P, 3) float64, mm
    transforms : (N, 4, 4) float64
        From input to aligned coordinates (column vectors).
    weights : (P,) float64
        Positive, sum 1.
    mesh : ModelMesh
        May have no triangles.
    """

    ids: Annotated[tuple[ShapeId, ...], Axes("N")]
    points: Annotated[FloatArray, Axes("N", "P", 3)]
    aligned: Annotated[FloatArray, Axes("N", "P", 3)]
    transforms: Annotated[FloatArray, Axes("N", 4, 4)]
    weights: Annotated[FloatArray, Axes("P")]
    mesh: Annotated[ModelMesh, Axes("P")]

    def __post_init__(self) -> None:
        """Check the weights."""
        check_weights(self.weights)


def corresponded_shapes(correspondence: Correspondence) -> CorrespondedShapes:
    """Return the shapes of a correspondence of this program, without its sphere."""
    arrays = {name: getattr(correspondence, name) for name in SHAPE_ARRAYS}
    mesh = mesh_of_template(correspondence.template)
    return CorrespondedShapes(ids=correspondence.ids, mesh=mesh, **arrays)


def write_corresponded_shapes(path: Path, shapes: CorrespondedShapes) -> None:
    """Write shapes in the layout of design section 7, without the optional sphere.

    Raises
    ------
    ArtifactError
        If the file cannot be written.
    InputError
        If an opening's name cannot be the name of a dataset.
    """
    with writing(path) as file:
        put_facts(file, shapes.mesh.parts)
        put_shapes(file, shapes)
        put_mesh(file, shapes.mesh)
        put_ids(file, shapes.ids)


def read_corresponded_shapes(path: Path) -> CorrespondedShapes:
    """Read the shapes of a ``correspondence.h5``, with or without the sphere.

    Raises
    ------
    ArtifactError
        If the file is missing, damaged or of another kind or schema.
    """
    with reading(path, "a correspondence of ostiform") as file:
        check_schema(file)
        return CorrespondedShapes(
            **take_shapes(file),
            mesh=ModelMesh(
                faces=np.asarray(file["faces"][:]).reshape(-1, 3),
                face_part=file["face_part"][:],
                part=file["part"][:],
                parts=take_texts(file.attrs["parts"]),
                loops=take_loops(file),
            ),
        )
