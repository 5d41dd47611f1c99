import numpy as np
import pytest

from ostiform.errors import TopologyError
from ostiform.surface import boundary_loops, enclosed_volume, genus
from ostiform.surface.fans import with_single_fans
from ostiform.surface.intersections import crossing_triangles
from ostiform.surface.loop_filling import filled_loops
from ostiform.surface.repair import MendedMesh, mended_mesh, outward_mesh
from tests.oracles.holed_spheres import holed_sphere, torus

HOLES = [((0, 0, 1), 0.5, 30), ((1, 0, 0), 0.3, 20)]


def mesh(vertices, faces):
    return MendedMesh(vertices, faces, np.arange(len(faces)), ())


def test_a_sound_mesh_is_returned_as_it_is():
    vertices, faces = holed_sphere(300, HOLES)
    mended = outward_mesh(mended_mesh(mesh(vertices, faces)))
    assert mended.repairs == ()
    np.testing.assert_array_equal(mended.faces, faces)
    np.testing.assert_array_equal(mended.source, np.arange(len(faces)))


def test_a_soup_becomes_the_surface_it_was(rng):
    vertices, faces = holed_sphere(300, HOLES)
    soup = vertices[faces].reshape(-1, 3)
    soup = soup + 1e-7 * rng.normal(size=soup.shape)  # float32 files are no better
    mended = mended_mesh(mesh(soup, np.arange(faces.size).reshape(-1, 3)))
    assert genus(mended.faces) == 0
    assert sorted(len(loop) for loop in boundary_loops(mended.faces)) == [20, 30]
    assert mended.repairs == (f"merged {faces.size - len(vertices)} vertices lying on others",)


def test_openings_that_touch_in_a_point_of_their_own_stay_apart():
    # Two discs side by side touch in one place with a vertex each: nothing is merged.
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0], [-1, 0, 0], [0, -1, 0.0]])
    mended = mended_mesh(mesh(vertices, np.array([[0, 1, 2], [3, 4, 5]])))
    assert mended.repairs == ()


def test_turned_triangles_are_those_in_the_minority():
    vertices, faces = holed_sphere(300, HOLES)
    messy = faces.copy()
    messy[:40] = messy[:40][:, [0, 2, 1]]
    mended = mended_mesh(mesh(vertices, messy))
    assert mended.repairs == ("turned 40 triangles to agree with the others",)
    np.testing.assert_array_equal(np.sort(mended.faces), np.sort(faces))
    assert enclosed_volume(vertices, mended.faces) > 0


def test_a_wall_is_refused_and_a_fin_dropped():
    vertices, faces = holed_sphere(300, HOLES)
    a, b = faces[0, :2]
    small = np.vstack([vertices, 1.05 * vertices[[a, b]].mean(axis=0)])
    mended = mended_mesh(mesh(small, np.vstack([faces, [[a, b, len(vertices)]]])))
    np.testing.assert_array_equal(mended.faces, faces)
    large = np.vstack([vertices, 9.0 * vertices[a]])
    with pytest.raises(TopologyError, match="found 1 edges with three or more"):
        mended_mesh(mesh(large, np.vstack([faces, [[a, b, len(vertices)]]])))


def test_openings_that_share_a_vertex_stay_two():
    vertices, faces = holed_sphere(2000, [((0, 0, 1), 0.5, 60)])
    rim = set(boundary_loops(faces)[0].tolist())
    for vertex in range(len(vertices)):
        around = {int(w) for f in faces[(faces == vertex).any(axis=1)] for w in f} - {vertex}
        if vertex not in rim and len(around & rim) == 1:
            break
    touching = faces[~(faces == vertex).any(axis=1)]
    parted = with_single_fans(vertices, touching)
    assert (parted.n_parted, parted.n_split) == (1, 0)
    assert sorted(len(loop) for loop in boundary_loops(parted.faces)) == [len(around), 59]
    assert genus(parted.faces) == 0


def test_sheets_that_touch_are_split():
    vertices, faces = holed_sphere(200, [])
    top, bottom = int(np.argmax(vertices[:, 2])), int(np.argmin(vertices[:, 2]))
    parted = with_single_fans(vertices, np.where(faces == bottom, top, faces))
    assert (parted.n_parted, parted.n_split) == (0, 1)
    assert genus(parted.faces) == 0
    np.testing.assert_array_equal(parted.vertices[-1], vertices[top])


@pytest.mark.parametrize("count", [3, 7, 30])
def test_a_filled_loop_leaves_the_surface_closed_and_the_rest_untouched(count):
    vertices, faces = holed_sphere(500, [((0, 0, 1), 0.3, count)])
    points, triangles = filled_loops(vertices, faces, boundary_loops(faces))
    np.testing.assert_array_equal(points[: len(vertices)], vertices)
    np.testing.assert_array_equal(triangles[: len(faces)], faces)
    assert boundary_loops(triangles) == ()
    assert genus(triangles) == 0
    assert enclosed_volume(points, triangles) == pytest.approx(4.19, abs=0.15)


def test_crossing_triangles_are_found_and_touching_ones_are_not():
    vertices, faces = holed_sphere(300, [])
    assert len(crossing_triangles(vertices, faces)) == 0
    two = np.vstack([vertices, vertices + [1.0, 0.13, 0.07]])
    both = np.vstack([faces, faces + len(vertices)])
    pairs = crossing_triangles(two, both)
    assert len(pairs) > 20
    assert (pairs[:, 0] < len(faces)).all()
    assert (pairs[:, 1] >= len(faces)).all()
    apart = np.vstack([vertices, vertices + [2.5, 0, 0]])
    assert len(crossing_triangles(apart, both)) == 0


def test_crossings_agree_with_brute_force(rng):
    corners = rng.normal(size=(60, 3, 3)) + 1.5 * rng.normal(size=(60, 1, 3))
    found = {tuple(pair) for pair in crossing_triangles(corners.reshape(-1, 3), _apart(60))}

    def pierced(a, b):
        for k in range(3):
            p, q = b[k], b[(k + 1) % 3]
            system = np.column_stack([a[1] - a[0], a[2] - a[0], p - q])
            u, v, t = np.linalg.solve(system, p - a[0])
            if u > 0 and v > 0 and u + v < 1 and 0 < t < 1:
                return True
        return False

    expected = {
        (i, j)
        for i in range(60)
        for j in range(i + 1, 60)
        if pierced(corners[i], corners[j]) or pierced(corners[j], corners[i])
    }
    assert expected
    assert found == expected


def _apart(count):
    return np.arange(3 * count).reshape(-1, 3)


def test_a_torus_keeps_its_handle():
    assert genus(mended_mesh(mesh(*torus(20, 12))).faces) == 1
