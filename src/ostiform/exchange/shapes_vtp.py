"""Corresponded shapes as VTP with who, when and what scores as field data."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ostiform.model import CorrespondedShapes, StoredModel, SurfaceField
from ostiform.surface import write_surface


def write_shape_vtp(
    path: Path,
    shapes: CorrespondedShapes,
    index: int,
    stored: StoredModel,
    aligned: bool = False,
    fields: Sequence[SurfaceField] = (),
) -> None:
    """Write one shape in correspondence with its identity and its scores.

    Field data: the texts ``subject`` and ``phase``, ``time`` (fraction of the cycle),
    ``scores_mm`` (K,) where the model knows the shape, ``transform`` (16 numbers by row, input to
    aligned coordinates) and ``parts`` (names, comma-separated). Point data: ``area_share``,
    ``distance_from_mean_mm`` of the aligned point, and the fields. Cell data: ``part``.

    Parameters
    ----------
    path : Path
        Ends in ``.vtp``.
    shapes : CorrespondedShapes
    index : int
    stored : StoredModel
        Of the same shapes and mesh, in any order.
    aligned : bool
        Whether to write the aligned shape; else in its input coordinates.
    fields : sequence of SurfaceField
        Of the same shapes.

    Raises
    ------
    InputError
        If the mesh has no triangles.
    ArtifactError
        If the file cannot be written.
    """
    id = shapes.ids[index]
    known = {(item.subject, item.phase): place for place, item in enumerate(stored.ids)}
    place = known.get((id.subject, id.phase))
    write_surface(
        path,
        (shapes.aligned if aligned else shapes.points)[index],
        shapes.mesh.faces,
        point_data={
            **{field.name: field.values[index] for field in fields},
            "area_share": shapes.weights,
            "distance_from_mean_mm": np.linalg.norm(
                shapes.aligned[index] - stored.model.mean, axis=1
            ),
        },
        cell_data={"part": shapes.mesh.face_part},
        field_data={
            "subject": id.subject,
            "phase": id.phase,
            "time": np.array([id.time]),
            **({} if place is None else {"scores_mm": stored.scores[place]}),
            "transform": shapes.transforms[index].reshape(-1),
            "parts": ",".join(shapes.mesh.parts),
        },
    )
