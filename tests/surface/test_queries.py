import numpy as np
import pytest

from ostiform.errors import InputError
from ostiform.surface import (
    closest_points,
    distances_to_surface,
    moved_tree,
    surface_tree,
)
from tests.star_shapes import closed_domain, star_embedding

SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
SQUARE_FACES = np.array([[0, 1, 2], [0, 2, 3]])


def ball(radius, n=2000):
    one = star_embedding(closed_domain().spheres[0], lambda u: np.full(len(u), radius), n)
    return one.component.vertices, one.component.faces


def test_distances_from_a_square_are_known():
    points = np.array([[0.5, 0.5, 2.0], [2.0, 0.5, 0.0], [-3.0, -4.0, 0.0], [0.25, 0.75, 0.0]])
    np.testing.assert_allclose(
        distances_to_surface(points, SQUARE, SQUARE_FACES), [2.0, 1.0, 5.0, 0.0], atol=1e-14
    )


def test_closest_points_are_the_combination_of_their_corners(rng):
    vertices, faces = ball(10.0, 300)
    found = closest_points(surface_tree(vertices, faces), 12 * rng.normal(size=(500, 3)))
    points = np.einsum("nk,nkd->nd", found.barycentric, vertices[faces[found.faces]])
    np.testing.assert_allclose(points, found.points, atol=1e-9)
    assert (found.barycentric >= 0).all()


def test_the_tree_finds_what_a_dense_sampling_of_the_surface_finds(rng):
    vertices, faces = ball(10.0, 100)
    weights = rng.dirichlet([1, 1, 1], size=(len(faces), 400))
    cloud = np.einsum("fsk,fkd->fsd", weights, vertices[faces]).reshape(-1, 3)
    for point in 15 * rng.normal(size=(20, 3)):
        exact = distances_to_surface(point[None], vertices, faces)[0]
        sampled = np.linalg.norm(cloud - point, axis=1).min()
        assert exact - 1e-12 <= sampled <= exact + 0.2


def test_the_tree_finds_what_every_triangle_asked_alone_finds(rng):
    vertices, faces = ball(10.0, 300)
    vertices = vertices + rng.normal(size=vertices.shape)
    points = 12 * rng.normal(size=(200, 3))
    one_by_one = [distances_to_surface(points, vertices, face[None]) for face in faces]
    np.testing.assert_allclose(
        distances_to_surface(points, vertices, faces), np.min(one_by_one, axis=0), rtol=1e-12
    )


def test_distances_from_a_triangle_are_those_of_a_quadratic_programme(rng):
    for _ in range(50):
        corners, point = rng.normal(size=(3, 3)), 2.0 * rng.normal(size=(1, 3))
        if rng.random() < 0.3:
            corners[2] = corners[0] + rng.choice([0.0, 0.5, 2.0]) * (corners[1] - corners[0])
        # A dense walk along the edges, and the foot of the perpendicular where it lies inside.
        along = np.linspace(0.0, 1.0, 20001)[:, None]
        edges = [(1.0 - along) * corners[k - 1] + along * corners[k] for k in range(3)]
        least = np.linalg.norm(np.concatenate(edges) - point, axis=1).min()
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        if np.linalg.norm(normal) > 1e-9:
            normal /= np.linalg.norm(normal)
            height = float((point[0] - corners[0]) @ normal)
            foot = point[0] - height * normal
            sides = [
                np.cross(corners[k] - corners[k - 1], foot - corners[k - 1]) @ normal
                for k in range(3)
            ]
            if min(sides) >= 0.0:
                least = abs(height)
        found = distances_to_surface(point, corners, np.array([[0, 1, 2]]))
        np.testing.assert_allclose(found, least, atol=1e-4)


def test_a_moved_tree_and_a_guess_find_what_a_new_tree_finds(rng):
    vertices, faces = ball(10.0, 500)
    points = 12 * rng.normal(size=(300, 3))
    elsewhere = vertices * [1.2, 0.9, 1.1] + rng.normal(scale=0.3, size=vertices.shape)
    moved = moved_tree(surface_tree(vertices, faces), elsewhere)
    expected = closest_points(surface_tree(elsewhere, faces), points)
    guess = rng.integers(len(faces), size=len(points))
    for found in (closest_points(moved, points), closest_points(moved, points, guess)):
        np.testing.assert_allclose(found.distances, expected.distances, rtol=1e-13)
        np.testing.assert_allclose(found.points, expected.points, rtol=1e-12)


def test_distances_scale_with_the_surfaces(rng):
    vertices, faces = ball(10.0, 200)
    points = 15 * rng.normal(size=(50, 3))
    one = distances_to_surface(points, vertices, faces)
    np.testing.assert_allclose(distances_to_surface(7 * points, 7 * vertices, faces), 7 * one)


def test_triangles_without_area_are_met_at_a_corner():
    flat = surface_tree(np.zeros((3, 3)), np.array([[0, 1, 2]]))
    found = closest_points(flat, np.array([[3.0, 4.0, 0.0]]))
    np.testing.assert_allclose(found.distances, 5.0)
    np.testing.assert_allclose(found.barycentric.sum(), 1.0)


def test_no_queries_give_no_answers_and_no_faces_are_refused():
    assert len(closest_points(surface_tree(SQUARE, SQUARE_FACES), np.zeros((0, 3))).points) == 0
    with pytest.raises(InputError, match="at least one triangle"):
        surface_tree(SQUARE, np.zeros((0, 3), dtype=np.int64))
