import numpy as np
import pytest

from ostiform.errors import ConvergenceError, InputError, TopologyError
from ostiform.surface import (
    containing_triangles,
    locate,
    normalised,
    sphere_locator,
    triangle_determinants,
    twin_half_edges,
)
from tests.star_shapes import closed_domain, heart_domain, star_embedding, wavy

RECONSTRUCTION = 1e-13  # gnomonic coordinates from determinants of differences

HEART = star_embedding(heart_domain().spheres[0], wavy(0.1), 1500)
CLOSED = star_embedding(closed_domain().spheres[0], wavy(0.1), 300)


def mesh(embedding):
    return embedding.directions, embedding.component.faces


def combined(directions, faces, face, barycentric):
    return normalised(np.einsum("nk,nkd->nd", barycentric, directions[faces[face]]))


def test_every_query_lands_and_is_its_own_combination(rng):
    directions, faces = mesh(HEART)
    locator = sphere_locator(directions, faces)
    queries = normalised(rng.normal(size=(20_000, 3)))
    face, barycentric = locate(locator, queries)
    inside = containing_triangles(locator, queries) < locator.n_faces
    assert inside.mean() > 0.9
    assert ((barycentric >= 0) & (barycentric <= 1)).all()
    np.testing.assert_allclose(barycentric.sum(axis=1), 1.0, rtol=1e-14)
    found = combined(directions, faces, face, barycentric)
    np.testing.assert_allclose(found[inside], queries[inside], atol=RECONSTRUCTION)


def test_the_walk_finds_the_triangle_that_a_full_search_finds(rng):
    directions, faces = mesh(CLOSED)
    queries = normalised(rng.normal(size=(200, 3)))
    found = containing_triangles(sphere_locator(directions, faces), queries)
    for query, triangle in zip(queries, found, strict=True):
        corners = directions[faces]
        sides = [
            np.linalg.det(
                np.stack(
                    [corners[:, k], corners[:, (k + 1) % 3], np.tile(query, (len(faces), 1))], 1
                )
            )
            for k in range(3)
        ]
        assert np.argmax(np.min(sides, axis=0)) == triangle


def test_vertices_are_located_at_themselves():
    directions, faces = mesh(HEART)
    face, barycentric = locate(sphere_locator(directions, faces), directions)
    np.testing.assert_allclose(
        combined(directions, faces, face, barycentric), directions, atol=RECONSTRUCTION
    )
    np.testing.assert_allclose(barycentric.max(axis=1), 1.0, rtol=1e-9)


def test_queries_in_a_hole_are_moved_onto_the_rim():
    sphere = heart_domain().spheres[0]
    directions, faces = mesh(HEART)
    locator = sphere_locator(directions, faces)
    for name, circle in sphere.rims.items():
        rim = HEART.component.rims[name]
        middles = normalised(directions[rim] + directions[np.roll(rim, -1)])
        for share in (0.3, 1.0):  # well inside the hole, and in the sliver behind the chord
            queries = normalised((1 - share) * circle.center + share * middles)
            face, barycentric = locate(locator, queries)
            assert np.isin(faces[face], rim).sum(axis=1).min() == 2
            np.testing.assert_allclose(barycentric[~np.isin(faces[face], rim)], 0.0, atol=1e-12)
            np.testing.assert_allclose(np.sort(barycentric, axis=1)[:, 1:], 0.5, atol=1e-9)


def test_the_centre_of_a_hole_lands_too():
    centres = np.stack([circle.center for circle in heart_domain().spheres[0].rims.values()])
    locator = sphere_locator(*mesh(HEART))
    _, barycentric = locate(locator, centres)
    np.testing.assert_allclose(barycentric.sum(axis=1), 1.0)


def test_location_turns_with_the_sphere(rng):
    directions, faces = mesh(HEART)
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    rotation *= np.sign(np.linalg.det(rotation))
    queries = normalised(rng.normal(size=(500, 3)))
    face, barycentric = locate(sphere_locator(directions, faces), queries)
    turned_face, turned = locate(
        sphere_locator(directions @ rotation.T, faces), queries @ rotation.T
    )
    np.testing.assert_array_equal(turned_face, face)
    np.testing.assert_allclose(turned, barycentric, atol=1e-9)


def test_nothing_asked_is_nothing_found():
    face, barycentric = locate(sphere_locator(*mesh(CLOSED)), np.zeros((0, 3)))
    assert face.shape == (0,)
    assert barycentric.shape == (0, 3)


def test_a_folded_triangulation_is_reported_when_a_query_is_lost():
    directions, faces = mesh(CLOSED)
    mirrored = directions * [1.0, 1.0, -1.0]
    assert (triangle_determinants(mirrored, faces) < 0).all()
    with pytest.raises(ConvergenceError, match="folded"):
        locate(sphere_locator(mirrored, faces), np.array([[0.6, 0.0, 0.8]]))


def test_no_faces_cannot_be_searched():
    with pytest.raises(InputError, match="at least one triangle"):
        sphere_locator(np.eye(3), np.zeros((0, 3), dtype=np.int64))


def test_twins_run_the_other_way_and_name_the_edge_that_does_not():
    _, faces = mesh(HEART)
    twins = twin_half_edges(faces, faces.max() + 1)
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    inner = twins >= 0
    np.testing.assert_array_equal(start[twins[inner]], end[inner])
    np.testing.assert_array_equal(twins[twins[inner]], np.flatnonzero(inner))
    assert (~inner).sum() == sum(len(loop) for loop in HEART.component.rims.values())
    for broken in ([[0, 1, 2], [0, 1, 3]], [[0, 1, 2], [1, 0, 3], [1, 0, 4]]):
        with pytest.raises(TopologyError, match="same direction"):
            twin_half_edges(np.array(broken), 5)
