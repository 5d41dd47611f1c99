"""PLY, STL and OBJ files read back as they were written."""

import numpy as np
import pytest

from ostiform.errors import InputError
from ostiform.surface import read_mesh
from ostiform.surface.write_plain import write_plain_mesh

TETRAHEDRON = np.array([[0.0, 0.0, 0.0], [1.0 / 3.0, 0.0, 0.0], [0.0, 20.0, 0.0], [0.0, 0.0, -3.5]])
FACES = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
SINGLE = 1e-6  # relative: STL holds single precision


@pytest.mark.parametrize(("suffix", "rtol"), [(".ply", 0.0), (".obj", 0.0), (".stl", SINGLE)])
def test_a_mesh_reads_back_as_written(tmp_path, suffix, rtol):
    path = tmp_path / "folder" / f"mesh{suffix}"
    write_plain_mesh(path, TETRAHEDRON, FACES)
    again = read_mesh(path)
    found, expected = again.vertices[again.faces], TETRAHEDRON[FACES]
    np.testing.assert_allclose(found, expected, rtol=rtol, atol=rtol)
    assert len(again.vertices) == 4


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".stl"])
def test_vtk_reads_the_same_triangles(tmp_path, suffix):
    import pyvista

    path = tmp_path / f"mesh{suffix}"
    write_plain_mesh(path, TETRAHEDRON, FACES)
    mesh = pyvista.read(path)
    corners = np.asarray(mesh.points)[mesh.regular_faces]
    np.testing.assert_allclose(corners, TETRAHEDRON[FACES], rtol=SINGLE, atol=SINGLE)


def test_equal_meshes_give_equal_bytes(tmp_path):
    for name in ("a.stl", "b.stl"):
        write_plain_mesh(tmp_path / name, TETRAHEDRON, FACES)
    assert (tmp_path / "a.stl").read_bytes() == (tmp_path / "b.stl").read_bytes()


def test_another_ending_is_refused(tmp_path):
    with pytest.raises(InputError, match="ending in .ply, .stl, .obj, found .gltf"):
        write_plain_mesh(tmp_path / "mesh.gltf", TETRAHEDRON, FACES)
