"""Operators against closed forms, identities and theorems."""

import numpy as np
import pytest

from ostiform.surface import (
    corner_cotangents,
    cotangent_stiffness,
    edge_lengths,
    face_areas,
    face_normals,
    local_frames,
    median_edge_length,
    uniform_laplacian,
    unique_edges,
    vertex_areas,
)
from tests.oracles.spherical_domains import domain_of_circles, left_atrium

RIGHT_TRIANGLE = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 4.0, 0.0]])
ONE_FACE = np.array([[0, 1, 2]])


@pytest.fixture(scope="module")
def mesh():
    component, _, _ = left_atrium(count=600)
    return component.vertices * np.array([1.0, 1.3, 0.8]), component.faces


def test_a_right_triangle_has_the_textbook_values():
    np.testing.assert_allclose(face_areas(RIGHT_TRIANGLE, ONE_FACE), [6.0])
    np.testing.assert_allclose(face_normals(RIGHT_TRIANGLE, ONE_FACE), [[0.0, 0.0, 1.0]])
    np.testing.assert_allclose(
        corner_cotangents(RIGHT_TRIANGLE, ONE_FACE), [[0.0, 0.75, 4.0 / 3.0]], atol=1e-15
    )
    np.testing.assert_allclose(vertex_areas(RIGHT_TRIANGLE, ONE_FACE), [2.0, 2.0, 2.0])
    np.testing.assert_allclose(edge_lengths(RIGHT_TRIANGLE, ONE_FACE), [3.0, 4.0, 5.0])
    np.testing.assert_allclose(median_edge_length(RIGHT_TRIANGLE, ONE_FACE), 4.0)


def test_the_area_of_a_fine_sphere_is_four_pi():
    component, _, _ = domain_of_circles({}, count=4000)
    total = face_areas(component.vertices, component.faces).sum()
    np.testing.assert_allclose(total, 4.0 * np.pi, rtol=3e-3)  # inscribed: short by O(h^2)
    np.testing.assert_allclose(vertex_areas(component.vertices, component.faces).sum(), total)


def test_gradients_of_hat_functions_reproduce_a_linear_field(mesh, rng):
    vertices, faces = mesh
    slope = rng.normal(size=3)
    frames = local_frames(vertices, faces)
    derivative = frames.derivatives((vertices @ slope)[:, None], faces)[:, 0]  # (F, 2)
    np.testing.assert_allclose(derivative, frames.axes @ slope, atol=1e-12)
    np.testing.assert_allclose(frames.areas, face_areas(vertices, faces))


def test_frames_are_orthonormal_and_lie_in_the_face(mesh):
    vertices, faces = mesh
    axes = local_frames(vertices, faces).axes
    gram = np.einsum("fia,fja->fij", axes, axes)
    np.testing.assert_allclose(gram, np.broadcast_to(np.eye(2), gram.shape), atol=1e-12)
    normals = np.cross(axes[:, 0], axes[:, 1])
    np.testing.assert_allclose(normals, face_normals(vertices, faces), atol=1e-12)


def test_the_stiffness_is_the_integral_of_squared_gradients(mesh, rng):
    vertices, faces = mesh
    values = rng.normal(size=len(vertices))
    frames = local_frames(vertices, faces)
    gradient = frames.derivatives(values[:, None], faces)[:, 0]
    expected = frames.areas @ (gradient**2).sum(axis=1)
    np.testing.assert_allclose(values @ (cotangent_stiffness(vertices, faces) @ values), expected)


def test_constants_are_in_the_kernel_of_both_laplacians(mesh):
    vertices, faces = mesh
    ones = np.ones(len(vertices))
    np.testing.assert_allclose(cotangent_stiffness(vertices, faces) @ ones, 0.0, atol=1e-12)
    np.testing.assert_allclose(uniform_laplacian(faces, len(vertices)) @ ones, 0.0, atol=1e-12)


def test_the_uniform_laplacian_counts_neighbours(mesh):
    vertices, faces = mesh
    degree = np.bincount(unique_edges(faces)[0].ravel(), minlength=len(vertices))
    np.testing.assert_allclose(uniform_laplacian(faces, len(vertices)).diagonal(), degree)


@pytest.mark.parametrize("scale", [1e-3, 217.0])
def test_operators_scale_as_their_units_say(mesh, scale):
    vertices, faces = mesh
    np.testing.assert_allclose(
        face_areas(scale * vertices, faces), scale**2 * face_areas(vertices, faces)
    )
    difference = cotangent_stiffness(scale * vertices, faces) - cotangent_stiffness(vertices, faces)
    np.testing.assert_allclose(difference.data, 0.0, atol=1e-10)
    np.testing.assert_allclose(
        local_frames(scale * vertices, faces).gradients,
        local_frames(vertices, faces).gradients / scale,
    )


@pytest.mark.parametrize(
    "corners",
    [
        [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]],
        [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]],
        [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 2.0, 0.0]],
    ],
)
def test_triangles_without_area_have_finite_operators(corners):
    vertices = np.array(corners)
    assert np.isfinite(corner_cotangents(vertices, ONE_FACE)).all()
    assert np.isfinite(cotangent_stiffness(vertices, ONE_FACE).toarray()).all()
    frames = local_frames(vertices, ONE_FACE)
    assert np.isfinite(frames.gradients).all()
    np.testing.assert_allclose(frames.areas, 0.0)
    np.testing.assert_allclose(face_normals(vertices, ONE_FACE), 0.0)
