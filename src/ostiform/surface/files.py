"""Reading triangle meshes from files, and writing them."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.atomic import atomically
from ostiform.errors import InputError
from ostiform.surface.gifti import read_gifti
from ostiform.surface.legacy_vtk import read_legacy_vtk
from ostiform.surface.plain_formats import read_carp, read_obj, read_off, read_stl
from ostiform.surface.ply import read_ply
from ostiform.surface.raw_mesh import Array, RawMesh
from ostiform.surface.write_vtp import vtp_bytes
from ostiform.surface.xml_vtk import read_xml_vtk

_READERS: Mapping[str, Callable[[bytes], RawMesh]] = {
    ".vtp": read_xml_vtk,
    ".vtk": read_legacy_vtk,
    ".vtu": read_xml_vtk,
    ".ply": read_ply,
    ".stl": read_stl,
    ".obj": read_obj,
    ".off": read_off,
    ".gii": read_gifti,
}

_CARP = ".elem"
MESH_SUFFIXES = (*_READERS, _CARP)


def read_mesh(path: Path) -> RawMesh:
    """Read a triangle mesh from a VTP, VTK, VTU, PLY, STL, OBJ, OFF, GIfTI or openCARP file.

    Legacy VTK files may hold POLYDATA or an UNSTRUCTURED_GRID. Points and lines are ignored,
    triangle strips become triangles, other polygons fans of triangles (`RawMesh.notes` says so).
    The vertices of an STL file, which has no connectivity, are merged where their positions are
    exactly equal. The points of an openCARP ``.elem`` are in the ``.pts`` of its name. Nothing
    else is repaired.

    Raises
    ------
    InputError
        If the file is missing, empty, damaged, of another kind, or holds cells that are not
        flat, coordinates that are not finite, or no triangle.
    """
    return _with_triangles(path, read_cloud_or_mesh(path))


def read_cloud_or_mesh(path: Path) -> RawMesh:
    """Read what `read_mesh` does, or the points alone of a file that has no triangles."""
    suffix = path.suffix.lower()
    if suffix not in MESH_SUFFIXES:
        raise InputError(
            f"{path}: expected a mesh file ending in {', '.join(MESH_SUFFIXES)}, "
            f"found {suffix or 'no ending'}"
        )
    content = _content(path)
    try:
        with np.errstate(invalid="ignore", over="ignore"):  # refused by RawMesh
            if suffix == _CARP:
                mesh = read_carp(content, _content(path.with_suffix(".pts")))
            else:
                mesh = _READERS[suffix](content)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except (ValueError, OverflowError) as error:
        # Words that should be numbers are found by NumPy, deep inside a reader.
        raise InputError(
            f"{path}: expected numbers where the {suffix[1:].upper()} format has them, found other "
            f"text ({error}): export the file again"
        ) from None
    return without_duplicate_vertices(mesh) if suffix == ".stl" else mesh


def _content(path: Path) -> bytes:
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: expected a mesh file, found none: check the path") from None
    except OSError as error:
        raise InputError(
            f"{path}: expected a mesh file, found one that cannot be read ({error.strerror})"
        ) from None
    if not content:
        raise InputError(f"{path}: expected a mesh, found an empty file")
    return content


def without_duplicate_vertices(mesh: RawMesh) -> RawMesh:
    """Return the mesh with vertices of exactly equal positions merged, the first one kept."""
    _, first, inverse = np.unique(
        mesh.vertices + 0.0, axis=0, return_index=True, return_inverse=True
    )
    if len(first) == len(mesh.vertices):
        return mesh
    kept = np.sort(first)
    rank = np.searchsorted(kept, first)
    return replace(
        mesh,
        vertices=mesh.vertices[kept],
        faces=rank[inverse.reshape(-1)][mesh.faces],
        point_data={name: values[kept] for name, values in mesh.point_data.items()},
    )


def write_surface(
    path: Path,
    vertices: FloatArray,
    faces: IntArray,
    point_data: Mapping[str, Array] | None = None,
    cell_data: Mapping[str, Array] | None = None,
    field_data: Mapping[str, Array | str] | None = None,
) -> None:
    """Write a surface as VTP (float64, LPS, compressed), whole or not at all.

    Equal surfaces give equal bytes. The field array ``SPACE`` says LPS, as 3D Slicer does.

    Parameters
    ----------
    path : Path
        Ends in ``.vtp``; its folder is made.
    vertices : (V, 3) float64, mm
        In the LPS frame.
    faces : (F, 3) int64
    point_data, cell_data : mapping of str to array
        Arrays of V and F items.
    field_data : mapping of str to array or str
        Facts about the whole surface.

    Raises
    ------
    InputError
        If the path does not end in ``.vtp``, an array has the wrong length, or there is no
        triangle.
    ArtifactError
        If the file cannot be written.
    """
    if path.suffix.lower() != ".vtp":
        raise InputError(f"{path}: expected a name ending in .vtp, found {path.suffix or 'none'}")
    try:
        mesh = RawMesh(vertices, faces, point_data or {}, cell_data or {}, "LPS")
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    content = vtp_bytes(_with_triangles(path, mesh), field_data)
    with atomically(path) as partial:
        partial.write_bytes(content)


def _with_triangles(path: Path, mesh: RawMesh) -> RawMesh:
    if not len(mesh.faces):
        raise InputError(
            f"{path}: expected a surface of triangles, found {len(mesh.vertices)} points and no "
            "triangle"
        )
    return mesh
