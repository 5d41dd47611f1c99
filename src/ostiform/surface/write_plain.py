"""Writers of the plain mesh formats that other programs open: PLY, STL and OBJ.

They hold positions and triangles only, in millimetres in the LPS frame.
"""

from pathlib import Path

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.atomic import atomically
from ostiform.errors import InputError
from ostiform.surface.operators import face_normals

PLAIN_SUFFIXES = (".ply", ".stl", ".obj")

_STL_TRIANGLE = np.dtype([("vectors", "<f4", (4, 3)), ("attribute", "<u2")])
_PLY_TRIANGLE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])


def write_plain_mesh(path: Path, vertices: FloatArray, faces: IntArray) -> None:
    """Write a mesh as binary PLY (double), binary STL (single precision) or OBJ, by the suffix.

    Equal meshes give equal bytes.

    Parameters
    ----------
    path : Path
        Ends in ``.ply``, ``.stl`` or ``.obj``; its folder is made.
    vertices : (V, 3) float64, mm
    faces : (F, 3) int64

    Raises
    ------
    InputError
        If the path ends otherwise.
    ArtifactError
        If the file cannot be written.
    """
    makers = {".ply": _ply_bytes, ".stl": _stl_bytes, ".obj": _obj_bytes}
    maker = makers.get(path.suffix.lower())
    if maker is None:
        raise InputError(
            f"{path}: expected a name ending in {', '.join(makers)}, found {path.suffix or 'none'}"
        )
    content = maker(vertices, faces)
    with atomically(path) as partial:
        partial.write_bytes(content)


def _ply_bytes(vertices: FloatArray, faces: IntArray) -> bytes:
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment millimetres, SPACE=LPS\n"
        f"element vertex {len(vertices)}\nproperty double x\nproperty double y\n"
        f"property double z\nelement face {len(faces)}\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    triangles = np.zeros(len(faces), dtype=_PLY_TRIANGLE)
    triangles["count"], triangles["corners"] = 3, faces
    return header.encode("ascii") + vertices.astype("<f8").tobytes() + triangles.tobytes()


def _stl_bytes(vertices: FloatArray, faces: IntArray) -> bytes:
    records = np.zeros(len(faces), dtype=_STL_TRIANGLE)
    records["vectors"][:, 0] = face_normals(vertices, faces)
    records["vectors"][:, 1:] = vertices[faces]
    header = b"binary STL, millimetres, SPACE=LPS".ljust(80, b" ")
    return header + len(faces).to_bytes(4, "little") + records.tobytes()


def _obj_bytes(vertices: FloatArray, faces: IntArray) -> bytes:
    lines = ["# millimetres, SPACE=LPS"]
    lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (faces + 1).tolist()]
    return ("\n".join(lines) + "\n").encode("ascii")
