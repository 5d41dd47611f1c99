import numpy as np
import pytest
from scipy.spatial import ConvexHull

from ostiform.errors import TopologyError
from ostiform.surface import (
    boundary_loops,
    connected_components,
    consistently_oriented,
    edge_faces,
    enclosed_volume,
    euler_characteristic,
    genus,
    is_consistently_oriented,
    non_manifold_edges,
    non_manifold_vertices,
    oriented_outward,
    unique_edges,
    without_unreferenced,
)
from tests.oracles.holed_spheres import half_sphere, holed_sphere, torus

TETRAHEDRON = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
BOW_TIE = np.array([[0, 1, 2], [0, 3, 4]])
THREE_SHEETS = np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]])
MOEBIUS = np.array([[0, 1, 2], [1, 3, 2], [2, 3, 4], [3, 5, 4], [4, 5, 1], [5, 0, 1]])
FIVE_HOLES = [
    ((0, 0, 1), 0.6, 40),
    ((1, 0, -0.2), 0.2, 14),
    ((-1, 0.3, -0.1), 0.25, 16),
    ((0, -1, -0.3), 0.15, 12),
    ((0, 1, -0.3), 0.2, 14),
]


@pytest.fixture(scope="module")
def atrium():
    return holed_sphere(900, FIVE_HOLES)


def cyclic(loop):
    """The loop from its smallest vertex on, as a tuple."""
    start = int(np.argmin(loop))
    return tuple(np.roll(loop, -start).tolist())


def test_a_tetrahedron_is_a_sphere():
    assert euler_characteristic(TETRAHEDRON) == 2
    assert genus(TETRAHEDRON) == 0
    assert boundary_loops(TETRAHEDRON) == ()
    assert len(unique_edges(TETRAHEDRON)[0]) == 6


def test_a_torus_has_one_handle_with_or_without_openings():
    _, faces = torus(12, 8)
    assert (euler_characteristic(faces), genus(faces)) == (0, 1)
    opened = faces[1:]
    assert (len(boundary_loops(opened)), genus(opened)) == (1, 1)


def test_genus_is_summed_over_pieces():
    _, faces = torus(12, 8)
    assert (
        genus(np.vstack([faces, faces.max() + 1 + faces, 2 * faces.max() + 2 + TETRAHEDRON])) == 2
    )


def test_a_sphere_with_five_holes_has_five_loops_and_no_handle(atrium):
    _, faces = atrium
    assert sorted(len(loop) for loop in boundary_loops(faces)) == [12, 14, 14, 16, 40]
    assert euler_characteristic(faces) == -3
    assert genus(faces) == 0


def test_loops_run_with_the_surface_on_their_left():
    # Seen from +z the lower half lies outside the equator, so on the left is clockwise.
    vertices, faces = half_sphere(300, 30, side=-1)
    (loop,) = boundary_loops(faces)
    angle = np.unwrap(np.arctan2(vertices[loop, 1], vertices[loop, 0]))
    assert (np.diff(angle) < 0).all()
    vertices, faces = half_sphere(300, 30, side=1)
    (loop,) = boundary_loops(faces)
    angle = np.unwrap(np.arctan2(vertices[loop, 1], vertices[loop, 0]))
    assert (np.diff(angle) > 0).all()


def test_loops_follow_half_edges_of_the_faces(atrium):
    _, faces = atrium
    directed = {(int(face[k]), int(face[(k + 1) % 3])) for face in faces for k in range(3)}
    for loop in boundary_loops(faces):
        for u, v in zip(loop.tolist(), np.roll(loop, -1).tolist(), strict=True):
            assert (u, v) in directed
            assert (v, u) not in directed


def test_loops_do_not_depend_on_the_order_of_faces_or_corners(atrium, rng):
    _, faces = atrium
    shuffled = faces[rng.permutation(len(faces))]
    turns = rng.integers(0, 3, len(faces))
    shuffled = np.take_along_axis(shuffled, (np.arange(3) + turns[:, None]) % 3, axis=1)
    for one, two in zip(boundary_loops(faces), boundary_loops(shuffled), strict=True):
        np.testing.assert_array_equal(one, two)


def test_loops_follow_a_relabelling_of_the_vertices(atrium, rng):
    vertices, faces = atrium
    label = rng.permutation(len(vertices))
    relabelled = {cyclic(loop) for loop in boundary_loops(label[faces])}
    assert relabelled == {cyclic(label[loop]) for loop in boundary_loops(faces)}


def test_two_boundaries_that_meet_at_a_vertex_are_refused():
    with pytest.raises(TopologyError, match="1 vertices where two boundaries meet"):
        boundary_loops(BOW_TIE)


def test_three_faces_at_an_edge_are_refused():
    np.testing.assert_array_equal(non_manifold_edges(THREE_SHEETS), [[0, 1]])
    for operation in (boundary_loops, edge_faces, consistently_oriented):
        with pytest.raises(TopologyError, match="1 edges with three or more"):
            operation(THREE_SHEETS)


def test_loops_of_faces_oriented_differently_are_refused():
    with pytest.raises(TopologyError, match="orient the surface first"):
        boundary_loops(np.array([[0, 1, 2], [1, 2, 3]]))


def test_a_vertex_where_two_fans_meet_is_not_manifold():
    np.testing.assert_array_equal(non_manifold_vertices(BOW_TIE), [0])
    two_tetrahedra = np.vstack([TETRAHEDRON, np.where(TETRAHEDRON == 0, 0, TETRAHEDRON + 3)])
    np.testing.assert_array_equal(non_manifold_vertices(two_tetrahedra), [0])
    with pytest.raises(TopologyError, match="one fan of faces round every vertex"):
        genus(two_tetrahedra)


def test_ordinary_vertices_are_manifold(atrium):
    assert len(non_manifold_vertices(atrium[1])) == 0
    assert len(non_manifold_vertices(torus(9, 7)[1])) == 0


def test_manifoldness_does_not_depend_on_orientation(atrium, rng):
    _, faces = atrium
    flipped = faces.copy()
    some = rng.random(len(faces)) < 0.5
    flipped[some] = flipped[some][:, ::-1]
    assert len(non_manifold_vertices(flipped)) == 0


def test_pieces_are_joined_by_edges_and_labelled_by_first_face():
    faces = np.array([[5, 6, 7], [0, 1, 2], [1, 3, 2], [7, 8, 9], [6, 10, 7]])
    np.testing.assert_array_equal(connected_components(faces), [0, 1, 1, 2, 0])


def test_each_edge_knows_its_faces(atrium):
    _, faces = atrium
    edges, sides = edge_faces(faces)
    assert (sides[:, 0] >= 0).all()
    assert (sides[:, 1] < 0).sum() == sum(len(loop) for loop in boundary_loops(faces))
    for edge, pair in zip(edges[::50], sides[::50], strict=True):
        for face in pair[pair >= 0]:
            assert set(edge.tolist()) <= set(faces[face].tolist())


def test_orientation_is_restored_after_flipping_faces_at_random(atrium, rng):
    vertices, faces = atrium
    flipped = faces.copy()
    some = rng.random(len(faces)) < 0.5
    flipped[some] = flipped[some][:, [0, 2, 1]]
    assert not is_consistently_oriented(flipped)
    np.testing.assert_array_equal(
        oriented_outward(vertices, flipped), np.where(some[:, None], flipped[:, [0, 2, 1]], faces)
    )


def test_an_inside_out_surface_is_turned_and_a_good_one_kept(atrium):
    vertices, faces = atrium
    np.testing.assert_array_equal(oriented_outward(vertices, faces), faces)
    np.testing.assert_array_equal(oriented_outward(vertices, faces[:, [0, 2, 1]]), faces)


def test_each_piece_is_oriented_on_its_own():
    faces = np.vstack([TETRAHEDRON, (TETRAHEDRON + 4)[:, [0, 2, 1]]])
    vertices = np.vstack([CORNERS, CORNERS + 5.0])
    np.testing.assert_array_equal(
        oriented_outward(vertices, faces), np.vstack([TETRAHEDRON, TETRAHEDRON + 4])
    )


def test_a_moebius_band_is_refused():
    with pytest.raises(TopologyError, match="Moebius"):
        consistently_oriented(MOEBIUS)


def test_volume_of_an_opened_convex_surface_is_that_of_its_hull():
    # The holes are planar, so the cones that close them are flat.
    vertices, faces = holed_sphere(500, FIVE_HOLES[:2])
    hull = ConvexHull(vertices).volume
    np.testing.assert_allclose(enclosed_volume(vertices, faces), hull, rtol=1e-12)
    np.testing.assert_allclose(enclosed_volume(2 * vertices + 7, faces), 8 * hull, rtol=1e-12)
    np.testing.assert_allclose(enclosed_volume(vertices, faces[:, [0, 2, 1]]), -hull, rtol=1e-12)


def test_vertices_that_no_face_uses_are_dropped():
    kept, faces = without_unreferenced(np.array([[1, 4, 2]]), 6)
    np.testing.assert_array_equal(kept, [1, 2, 4])
    np.testing.assert_array_equal(faces, [[0, 2, 1]])


def test_a_mesh_without_faces_has_no_topology():
    empty = np.empty((0, 3), dtype=np.int64)
    assert boundary_loops(empty) == ()
    assert euler_characteristic(empty) == 0
    assert len(connected_components(empty)) == 0
    assert len(edge_faces(empty)[0]) == 0
