"""What VTK's readers find in meshes, apart in a process of their own, is what ours find."""

import json
import subprocess
import sys

import numpy as np
import pytest

from ostiform.errors import InputError
from ostiform.surface import read_mesh

FEWEST = 640
MADE_BY_VTK = {"RGB", "Normals", "TCoords", "GroupIds"}
"""Arrays of VTK's readers that are no numbers of the file, or several of its columns in one."""
ROUNDING = 1.2e-7
"""VTK reads STL, OBJ and PLY as float32."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("variants")
    subprocess.run([sys.executable, "-m", "tests.oracles.vtk_variants", folder], check=True)
    return folder


def in_order(triangles):
    """Return triangles that begin with their lowest corner, sorted, and the order that sorts."""
    first = triangles.argmin(axis=1)[:, None]
    turned = np.take_along_axis(triangles, (first + np.arange(3)) % 3, axis=1)
    order = np.lexsort(turned.T[::-1])
    return turned[order], order


def test_meshes_of_every_choice_are_read_as_vtk_does(folder):
    names = json.loads((folder / "variants.json").read_text("utf-8"))
    assert len(names) >= FEWEST
    n_arrays = 0
    for name in names:
        mesh = read_mesh(folder / name)
        other = dict(np.load((folder / name).with_suffix(".npz")))
        points, triangles = other.pop("points"), other.pop("triangles")
        where = {"err_msg": name, "rtol": ROUNDING if name[:3] not in ("vtp", "vtu") else 0.0}
        if name[:3] in ("stl", "obj"):  # VTK gives each corner of a seam a point of its own
            np.testing.assert_allclose(mesh.vertices[mesh.faces], points[triangles], **where)
            here = there = slice(None)
        else:
            np.testing.assert_allclose(mesh.vertices, points, **where)
            ours, here = in_order(mesh.faces)
            theirs, there = in_order(triangles)
            np.testing.assert_array_equal(ours, theirs, err_msg=name)
        assert mesh.space == (str(other.pop("space")) if "space" in other else mesh.space), name
        for key, values in other.items():
            group, _, array = key.partition(" ")
            if array in MADE_BY_VTK:
                continue
            found = mesh.point_data[array] if group == "point" else mesh.cell_data[array]
            assert found.dtype == values.dtype, (name, key)
            if group == "cell":
                found, values = found[here], values[there]
            np.testing.assert_allclose(found, values, **where)
            n_arrays += 1
    assert n_arrays > len(names)


def test_a_file_that_states_two_frames_is_refused(tmp_path):
    text = (
        "# vtk DataFile Version 4.2\n3D Slicer output. SPACE=RAS\nASCII\nDATASET POLYDATA\n"
        "FIELD FieldData 1\nSPACE 1 1 string\nLPS\nPOINTS 3 float\n0 0 0 1 0 0 0 1 0\n"
        "POLYGONS 1 4\n3 0 1 2\n"
    )
    (tmp_path / "a.vtk").write_text(text)
    with pytest.raises(InputError, match="SPACE=LPS or SPACE=RAS .* SPACE=LPS and SPACE=RAS"):
        read_mesh(tmp_path / "a.vtk")
