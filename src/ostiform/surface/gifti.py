"""Reader of GIfTI surfaces: millimetres in RAS."""

from typing import Any

import numpy as np

from ostiform.errors import InputError
from ostiform.surface.raw_mesh import RawMesh

_POINTS, _TRIANGLES = 1008, 1009


def read_gifti(content: bytes) -> RawMesh:
    """Return the surface of a GIfTI file, with the arrays of one value per vertex.

    Coordinates are taken as stored; where the file offers a transform to another space, a note
    says that it was not applied (as viewers do).
    """
    from nibabel.gifti.gifti import GiftiImage

    try:
        arrays: list[Any] = GiftiImage.from_bytes(content).darrays
    except Exception as error:
        # nibabel lets whatever its XML and array readers raise escape.
        raise InputError(f"expected a GIfTI file, found {error!r}"[:200]) from None
    found = {int(item.intent): item for item in arrays}
    if _POINTS not in found:
        raise InputError("expected a GIfTI file of a surface (.surf.gii), found no points in it")
    points = found[_POINTS]
    vertices = np.asarray(points.data, dtype=np.float64)
    notes: tuple[str, ...] = ()
    transform = points.coordsys.xform
    if transform is not None and np.abs(np.asarray(transform) - np.eye(4)).max() > 1e-6:
        notes = ("took the coordinates as stored, without the transform that the file offers",)
    faces = found[_TRIANGLES].data if _TRIANGLES in found else np.zeros((0, 3), dtype=np.int64)
    data = {
        str(item.meta.get("Name") or f"array {k}"): np.asarray(item.data)
        for k, item in enumerate(arrays)
        if item.intent not in (_POINTS, _TRIANGLES) and len(item.data) == len(vertices)
    }
    return RawMesh(vertices, np.asarray(faces), data, {}, "RAS", notes, "mm")
