import numpy as np
import pytest

from ostiform.domain import triangle_quality
from ostiform.errors import ConvergenceError, InputError
from ostiform.surface import (
    RemeshRules,
    boundary_loops,
    connected_components,
    consistently_oriented,
    distances_to_surface,
    euler_characteristic,
    half_edges,
    isotropic_remeshed,
    non_manifold_edges,
    non_manifold_vertices,
    unique_edges,
    without_unreferenced,
)
from tests.star_shapes import closed_domain, cup_domain, heart_domain, star_embedding, wavy

HEART = star_embedding(heart_domain(8.0).spheres[0], wavy(0.2), 2500).component
HEART_CURVES = [*HEART.rims.values(), *HEART.seams.values()]


def assert_sound(remeshed, chi):
    faces = remeshed.faces
    assert euler_characteristic(faces) == chi
    assert len(non_manifold_edges(faces)) == 0
    assert len(non_manifold_vertices(faces)) == 0
    on_curve = np.full(len(remeshed.vertices), -1)
    for index, loop in enumerate((*remeshed.curves, *remeshed.rims)):
        on_curve[loop] = index
    edges, _, _ = unique_edges(faces)
    allowed = {
        frozenset(edge)
        for loop in (*remeshed.curves, *remeshed.rims)
        for edge in zip(loop.tolist(), np.roll(loop, -1).tolist(), strict=True)
    }
    joining = edges[(on_curve[edges] >= 0).all(axis=1)]
    assert {frozenset(edge) for edge in joining.tolist()} == allowed


def directed(faces):
    return {tuple(edge) for edge in half_edges(faces).tolist()}


def test_a_heart_keeps_its_curves_its_topology_and_its_shape():
    remeshed = isotropic_remeshed(
        HEART.vertices,
        HEART.faces,
        edge_mm=2.0,
        curves=HEART_CURVES,
        labels=HEART.face_part,
    )
    assert_sound(remeshed, euler_characteristic(HEART.faces))
    quality = triangle_quality(remeshed.vertices, remeshed.faces)
    assert quality.min_angle > 15
    assert quality.mean > 0.96
    diameter = np.linalg.norm(np.ptp(HEART.vertices, axis=0))
    there = distances_to_surface(remeshed.vertices, HEART.vertices, HEART.faces)
    back = distances_to_surface(HEART.vertices, remeshed.vertices, remeshed.faces)
    assert there.max() < 1e-9 * diameter  # new vertices lie on the input surface
    assert back.max() < 0.005 * diameter
    rims = {frozenset(loop.tolist()) for loop in boundary_loops(remeshed.faces)}
    given = [frozenset(loop.tolist()) for loop in remeshed.curves]
    assert rims == set(given[: len(HEART.rims)])
    lengths = np.linalg.norm(np.diff(remeshed.vertices[half_edges(remeshed.faces)], axis=1), axis=2)
    np.testing.assert_allclose(lengths.mean(), 2.0, rtol=0.1)


def test_curves_keep_their_direction_their_start_and_their_polyline():
    remeshed = isotropic_remeshed(
        HEART.vertices, HEART.faces, edge_mm=3.0, curves=HEART_CURVES, labels=HEART.face_part
    )
    edges = directed(remeshed.faces)
    for old, new in zip(HEART_CURVES, remeshed.curves, strict=True):
        assert set(zip(new.tolist(), np.roll(new, -1).tolist(), strict=True)) <= edges
        following = np.roll(old, -1)
        line = np.stack([old, following, following], axis=1)  # flat triangles: segments
        gaps = distances_to_surface(remeshed.vertices[new], HEART.vertices, line)
        assert gaps.max() < 1e-9
        spacing = np.linalg.norm(
            remeshed.vertices[new] - np.roll(remeshed.vertices[new], -1, axis=0), axis=1
        )
        assert spacing.max() < 2.0 * spacing.min()
        first = np.linalg.norm(remeshed.vertices[new] - HEART.vertices[old[0]], axis=1)
        assert first[0] <= 1.5 * first.min() + 1e-9


def test_labels_keep_their_area_on_either_side_of_a_seam():
    remeshed = isotropic_remeshed(
        HEART.vertices, HEART.faces, edge_mm=2.0, curves=HEART_CURVES, labels=HEART.face_part
    )

    def areas(vertices, faces, labels):
        corners = vertices[faces]
        double = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        return np.bincount(labels, np.linalg.norm(double, axis=1) / 2)

    np.testing.assert_allclose(
        areas(remeshed.vertices, remeshed.faces, remeshed.labels),
        areas(HEART.vertices, HEART.faces, HEART.face_part),
        rtol=0.01,
    )


@pytest.mark.parametrize("count", [400, 1500, 4000])
def test_the_wanted_number_of_vertices_is_reached(count):
    cup = star_embedding(cup_domain().spheres[0], wavy(0.2), 1500).component
    remeshed = isotropic_remeshed(cup.vertices, cup.faces, n_vertices=count)
    assert abs(len(remeshed.vertices) - count) <= 0.02 * count
    assert_sound(remeshed, 1)
    assert remeshed.curves == ()
    assert len(remeshed.rims) == 1


def test_a_closed_surface_is_remeshed_coarser_and_finer():
    ball = star_embedding(
        closed_domain().spheres[0], lambda u: np.full(len(u), 10.0), 600
    ).component
    for edge in (0.8, 4.0):
        remeshed = isotropic_remeshed(ball.vertices, ball.faces, edge_mm=edge)
        assert_sound(remeshed, 2)
        radii = np.linalg.norm(remeshed.vertices, axis=1)
        assert 9.8 < radii.min() <= radii.max() < 10.001


def test_sizes_grade_the_mesh():
    cup = star_embedding(cup_domain().spheres[0], lambda u: np.full(len(u), 10.0), 1500).component
    sizing = np.where(cup.vertices[:, 2] < 0, 2.0, 1.0)
    remeshed = isotropic_remeshed(cup.vertices, cup.faces, edge_mm=1.0, sizing=sizing)
    middles = remeshed.vertices[half_edges(remeshed.faces)].mean(axis=1)[:, 2]
    lengths = np.linalg.norm(np.diff(remeshed.vertices[half_edges(remeshed.faces)], axis=1), axis=2)
    fine, coarse = lengths[middles > 2].mean(), lengths[middles < -2].mean()
    assert 1.7 < coarse / fine < 2.3


def test_curve_vertices_stay_when_they_may_not_move():
    remeshed = isotropic_remeshed(
        HEART.vertices,
        HEART.faces,
        edge_mm=2.5,
        curves=HEART_CURVES,
        labels=HEART.face_part,
        rules=RemeshRules(move_curves=False),
    )
    for old, new in zip(HEART_CURVES, remeshed.curves, strict=True):
        np.testing.assert_array_equal(remeshed.vertices[new], HEART.vertices[old])
    assert_sound(remeshed, euler_characteristic(HEART.faces))


def test_remeshing_scales_with_the_surface_and_repeats_itself():
    cup = star_embedding(cup_domain().spheres[0], wavy(0.2), 800).component
    one = isotropic_remeshed(cup.vertices, cup.faces, edge_mm=4.0)
    again = isotropic_remeshed(cup.vertices, cup.faces, edge_mm=4.0)
    np.testing.assert_array_equal(one.vertices, again.vertices)
    doubled = isotropic_remeshed(2.0 * cup.vertices, cup.faces, edge_mm=8.0)
    np.testing.assert_array_equal(doubled.faces, one.faces)
    np.testing.assert_allclose(doubled.vertices, 2.0 * one.vertices, rtol=1e-9, atol=1e-9)


def test_inner_edges_that_join_two_rim_vertices_are_split():
    # A strip of one row of triangles round a cylinder: every inner edge joins its two rims.
    n = 12
    angle = 2 * np.pi * np.arange(n) / n
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(n)], axis=1)
    low, after = np.arange(n), np.roll(np.arange(n), -1)
    faces = np.concatenate(
        [np.stack([low, after, low + n], 1), np.stack([after, after + n, low + n], 1)]
    )
    remeshed = isotropic_remeshed(np.vstack([ring, ring + [0, 0, 0.6]]), faces, edge_mm=0.5)
    assert_sound(remeshed, 0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"edge_mm": None}, "either"),
        ({"n_vertices": 100}, "either"),
        ({"edge_mm": -1.0}, "positive"),
        ({"edge_mm": None, "n_vertices": 2}, "at least 4"),
        ({"curves": [np.array([0, 1])]}, "at least 3"),
        ({"curves": [HEART_CURVES[0], HEART_CURVES[0]]}, "crosses"),
        ({"curves": [HEART_CURVES[-1][::3]]}, "not edges"),
        ({"labels": np.zeros(3, dtype=np.int64)}, "one per face"),
        ({"labels": HEART.face_part}, "border"),
        ({"sizing": np.zeros(3)}, "one positive size"),
        ({"sizing": np.zeros(len(HEART.vertices))}, "one positive size"),
    ],
)
def test_unusable_wishes_are_refused(change, message):
    with pytest.raises(InputError, match=message):
        isotropic_remeshed(HEART.vertices, HEART.faces, **{"edge_mm": 2.0, **change})


def test_rules_out_of_range_are_refused():
    with pytest.raises(InputError, match="at least 3"):
        RemeshRules(fewest_on_curve=2)


def test_a_curve_edge_of_length_zero_is_refused():
    vertices = HEART.vertices.copy()
    loop = HEART_CURVES[0]
    vertices[loop[1]] = vertices[loop[0]]
    with pytest.raises(InputError, match="length zero"):
        isotropic_remeshed(vertices, HEART.faces, edge_mm=2.0)


def test_fewer_vertices_than_the_curves_need_are_reported():
    with pytest.raises(ConvergenceError, match="ask for more"):
        isotropic_remeshed(
            HEART.vertices,
            HEART.faces,
            n_vertices=50,
            rules=RemeshRules(move_curves=False),
        )


@pytest.mark.parametrize("number", [1, 6])
def test_a_real_left_atrium_is_remeshed_soundly(shared_data, number):
    pyvista = pytest.importorskip("pyvista")
    grid = pyvista.read(shared_data / "left-atria" / f"LA_with_fibers_{number}.vtk")
    faces = grid.cells.reshape(-1, 4)[:, 1:].astype(np.int64)
    label = connected_components(faces)
    faces = faces[label == np.bincount(label).argmax()]
    kept, faces = without_unreferenced(faces, grid.n_points)
    vertices, faces = np.asarray(grid.points, float)[kept], consistently_oriented(faces)
    remeshed = isotropic_remeshed(vertices, faces, n_vertices=2500)
    assert_sound(remeshed, euler_characteristic(faces))
    assert triangle_quality(remeshed.vertices, remeshed.faces).min_angle > 15
    worst = distances_to_surface(vertices, remeshed.vertices, remeshed.faces).max()
    assert worst < 0.01 * np.linalg.norm(np.ptp(vertices, axis=0))
