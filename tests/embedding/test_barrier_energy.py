"""The barrier energy: closed forms, derivatives, references, step limits."""

import numpy as np
import pytest

from ostiform.embedding.energy import (
    EnergyWeights,
    energy_and_derivatives,
    energy_value,
    largest_step,
    tangent_bases,
)
from ostiform.embedding.newton import map_problem
from ostiform.embedding.reference import equilateral_reference, surface_reference
from ostiform.surface import face_areas, spherical_areas
from tests.oracles.holed_spheres import sphere_with_circles

WEIGHTS = EnergyWeights(0.3, 1.0, 0.7)


def _sphere(n_points):
    vertices, faces, _ = sphere_with_circles(n_points, [])
    return vertices, faces


def _perturbed_sphere(rng, amount=0.02):
    vertices, faces = _sphere(300)
    directions = vertices + amount * rng.normal(size=vertices.shape)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    surface = vertices * np.array([1.0, 1.3, 0.8])
    return surface, faces, directions


def _value(directions, faces, reference, epsilon, weights=WEIGHTS):
    return energy_value(
        directions, faces, reference.gradients, reference.areas, weights.as_array(), epsilon
    )


def _derivatives(directions, problem, epsilon, weights=WEIGHTS):
    bases = np.empty((len(directions), 2, 3))
    tangent_bases(directions, bases)
    gradient, hessian = np.zeros(problem.n_dofs), np.zeros(len(problem.rows))
    reference = problem.reference
    energy = energy_and_derivatives(
        directions,
        problem.faces,
        reference.gradients,
        reference.areas,
        weights.as_array(),
        epsilon,
        bases,
        problem.dofs,
        problem.slots,
        gradient,
        hessian,
    )
    return energy, gradient, hessian, bases


def test_an_isometry_of_small_triangles_has_the_least_energy():
    # I = 2 and d = 1 in every triangle: psi = w_D + w_M + w_A, up to the curvature of the sphere
    vertices, faces = _sphere(4000)
    area = float(spherical_areas(vertices, faces).sum())
    reference = surface_reference(vertices, faces, area)
    energy, least = _value(vertices, faces, reference, 0.0)
    np.testing.assert_allclose(energy, area * (0.3 + 1.0 + 0.7), rtol=2e-3)
    assert 0.9 < least < 1.1


def test_the_reference_does_not_depend_on_the_unit_of_length():
    vertices, faces = _sphere(300)
    small = surface_reference(vertices, faces, 12.0)
    large = surface_reference(1000.0 * vertices, faces, 12.0)
    np.testing.assert_allclose(large.areas, small.areas, rtol=1e-12)
    np.testing.assert_allclose(large.gradients, small.gradients, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(small.areas.sum(), 12.0, rtol=1e-12)


def test_scales_change_the_shares_of_the_area_and_not_its_sum():
    vertices, faces = _sphere(80)
    scales = np.where(np.arange(len(faces)) % 2, 2.0, 1.0)
    plain = surface_reference(vertices, faces, 12.0)
    scaled = surface_reference(vertices, faces, 12.0, scales)
    np.testing.assert_allclose(scaled.areas.sum(), 12.0, rtol=1e-12)
    ratio = scaled.areas / plain.areas
    np.testing.assert_allclose(ratio[1::2], 4.0 * ratio[0], rtol=1e-12)


def test_slivers_and_points_get_equilateral_references():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0.5, 1, 0], [0.5, 1e-3, 0], [0.5, 1e-3, 0.0]])
    faces = np.array([[0, 1, 2], [0, 1, 3], [3, 4, 3]])
    reference = surface_reference(vertices, faces, float(face_areas(vertices, faces).sum()))
    edges = np.sqrt(4.0 / np.sqrt(3.0) * reference.areas)
    np.testing.assert_allclose(edges[1], 2.0 / 3.0, rtol=1e-2)
    assert np.isfinite(reference.gradients).all()
    assert (reference.areas > 0.0).all()
    for triangle in (1, 2):
        lengths = np.linalg.norm(reference.gradients[triangle], axis=1)
        np.testing.assert_allclose(lengths, lengths[0], rtol=1e-12)


def test_equilateral_references_have_the_areas_asked_for():
    reference = equilateral_reference(np.array([1.0, 4.0]))
    # |gradient| of an equilateral triangle = 2 / (sqrt(3) edge)
    edges = 2.0 / np.sqrt(3.0) / np.linalg.norm(reference.gradients[:, 0], axis=1)
    np.testing.assert_allclose(np.sqrt(3.0) / 4.0 * edges**2, [1.0, 4.0], rtol=1e-12)


@pytest.mark.parametrize("epsilon", [0.0, 1e-2, 1.0])
def test_the_gradient_is_right_to_second_order(rng, epsilon):
    surface, faces, directions = _perturbed_sphere(rng)
    area = float(spherical_areas(directions, faces).sum())
    reference = surface_reference(surface, faces, area)
    problem = map_problem(faces, reference, np.zeros(len(directions), dtype=bool))
    energy, gradient, _, bases = _derivatives(directions, problem, epsilon)
    np.testing.assert_allclose(energy, _value(directions, faces, reference, epsilon)[0])
    step = rng.normal(size=(len(directions), 2))
    motion = step[:, :1] * bases[:, 0] + step[:, 1:] * bases[:, 1]
    sizes = np.array([1e-3, 5e-4, 2.5e-4])
    remainders = []
    for size in sizes:
        moved = directions + size * motion
        moved /= np.linalg.norm(moved, axis=1, keepdims=True)
        found = _value(moved, faces, reference, epsilon)[0]
        remainders.append(abs(found - energy - size * float(gradient @ step.ravel())))
    slope = np.polyfit(np.log(sizes), np.log(remainders), 1)[0]
    assert 1.9 < slope < 2.2


def test_the_hessian_is_positive_definite_and_near_that_of_the_energy(rng):
    surface, faces, directions = _perturbed_sphere(rng, 0.005)
    area = float(spherical_areas(directions, faces).sum())
    # at the minimum nothing is clamped: the projected Hessian is the Hessian, up to curvature
    vertices, _ = _sphere(300)
    reference = surface_reference(vertices, faces, area)
    problem = map_problem(faces, reference, np.zeros(len(vertices), dtype=bool))
    _, _, hessian, bases = _derivatives(vertices, problem, 0.0)
    dense = np.zeros((problem.n_dofs, problem.n_dofs))
    columns = np.repeat(np.arange(problem.n_dofs), np.diff(problem.starts))
    dense[problem.rows, columns] = hessian
    dense = dense + np.triu(dense, 1).T
    assert np.linalg.eigvalsh(dense).min() > 0.0
    step = rng.normal(size=(len(vertices), 2))
    motion = step[:, :1] * bases[:, 0] + step[:, 1:] * bases[:, 1]
    size = 1e-3
    values = []
    for sign in (-1.0, 0.0, 1.0):
        moved = vertices + sign * size * motion
        moved /= np.linalg.norm(moved, axis=1, keepdims=True)
        values.append(_value(moved, faces, reference, 0.0)[0])
    second = (values[0] - 2.0 * values[1] + values[2]) / size**2
    np.testing.assert_allclose(step.ravel() @ dense @ step.ravel(), second, rtol=0.1)


def test_the_exact_barrier_is_infinite_when_folded_and_the_regularised_one_is_not():
    vertices, faces = _sphere(80)
    area = float(spherical_areas(vertices, faces).sum())
    reference = surface_reference(vertices, faces, area)
    mirrored = vertices * np.array([1.0, 1.0, -1.0])
    assert _value(mirrored, faces, reference, 0.0)[0] == np.inf
    energy, least = _value(mirrored, faces, reference, 0.1)
    assert np.isfinite(energy)
    assert least < 0.0


def test_the_regularised_energy_tends_to_the_exact_one(rng):
    surface, faces, directions = _perturbed_sphere(rng)
    area = float(spherical_areas(directions, faces).sum())
    reference = surface_reference(surface, faces, area)
    exact = _value(directions, faces, reference, 0.0)[0]
    gaps = [exact - _value(directions, faces, reference, e)[0] for e in (1e-2, 1e-3)]
    np.testing.assert_allclose(gaps[0] / gaps[1], 100.0, rtol=0.05)


def test_the_largest_step_is_where_a_triangle_loses_its_area():
    corners = np.array([[0.0, 0.0, 1.0], [0.1, 0.0, 1.0], [0.0, 0.1, 1.0]])
    faces = np.array([[0, 1, 2]])
    motion = np.array([[0.05, 0.05, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    # the first corner reaches the line between the others at (0.05, 0.05): step one
    np.testing.assert_allclose(largest_step(corners, motion, faces), 1.0, rtol=0.05)
    assert largest_step(corners, -motion, faces) == np.inf
