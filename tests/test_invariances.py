"""What a rigid motion, a change of scale and a new numbering change of a result, and what not.

Every test is one law, over random bodies, shapes, motions and numberings.
"""

from dataclasses import dataclass

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from ostiform.arrays import FloatArray, IntArray
from ostiform.correspondence import align, cut_off_eigenvalue, description_length
from ostiform.domain import spherical_delaunay
from ostiform.evaluation import divided_variance, surface_distances
from ostiform.model import ModelMesh, ShapeModel, fit_model
from ostiform.surface import (
    closest_points,
    corner_cotangents,
    cotangent_stiffness,
    edge_lengths,
    enclosed_volume,
    exact_orientations,
    face_areas,
    face_normals,
    locate,
    median_edge_length,
    normalised,
    sphere_locator,
    spherical_areas,
    spherical_fibonacci,
    surface_tree,
    uniform_laplacian,
    vertex_areas,
    vertex_normals,
    weighted_quantile,
)

N_VERTICES = 60
N_SHAPES = 6
RELATIVE = 1e-9
"""Of the largest value: round-off of a body some hundred diameters from the origin."""

laws = settings(max_examples=25, derandomize=True)
generators = st.integers(0, 2**32 - 1).map(np.random.default_rng)
factors = st.floats(0.01, 100.0)


@dataclass(frozen=True)
class Motion:
    """A rotation and a translation in mm."""

    rotation: FloatArray
    translation: FloatArray

    def __call__(self, points: FloatArray) -> FloatArray:
        return points @ self.rotation.T + self.translation


@dataclass(frozen=True)
class Body:
    """A closed surface: star-shaped, uneven triangles."""

    directions: FloatArray
    vertices: FloatArray
    faces: IntArray


def motion_from(rng: np.random.Generator) -> Motion:
    return Motion(Rotation.random(random_state=rng).as_matrix(), rng.uniform(-200.0, 200.0, 3))


def body_from(rng: np.random.Generator) -> Body:
    spread = spherical_fibonacci(N_VERTICES)
    directions = normalised(spread + 0.1 * rng.normal(size=spread.shape))
    radii = 30.0 * np.exp(0.3 * directions @ rng.normal(size=3))
    return Body(directions, radii[:, None] * directions, spherical_delaunay(directions))


def shapes_from(rng: np.random.Generator) -> tuple[FloatArray, FloatArray, IntArray]:
    """Give shapes (N, P, 3), weights (P,) and faces of a population."""
    body = body_from(rng)
    linear = np.eye(3) + 0.1 * rng.normal(size=(N_SHAPES, 3, 3))
    shapes = body.vertices @ linear + 0.3 * rng.normal(size=(N_SHAPES, N_VERTICES, 3))
    areas = vertex_areas(body.vertices, body.faces)
    return shapes, areas / areas.sum(), body.faces


def model_of(shapes: FloatArray, weights: FloatArray, faces: IntArray) -> ShapeModel:
    none = np.zeros(len(faces), dtype=np.int64)
    points = np.zeros(len(weights), dtype=np.int64)
    return fit_model(shapes, weights, ModelMesh(faces, none, points, ("A",), {}))


def numbering(rng: np.random.Generator, body: Body) -> tuple[IntArray, Body]:
    """Give an order of the vertices, and the body with its vertices in this order."""
    order = rng.permutation(N_VERTICES)
    return order, Body(body.directions[order], body.vertices[order], relabelled(order, body.faces))


def relabelled(order: IntArray, faces: IntArray) -> IntArray:
    return np.argsort(order)[faces]


def near(actual: FloatArray | float, expected: FloatArray | float) -> None:
    """Compare up to round-off of the largest value expected."""
    size = float(np.abs(expected).max())
    assert_allclose(actual, expected, rtol=0.0, atol=RELATIVE * size)


# Measures of a surface.


@laws
@given(generators)
def test_lengths_areas_and_volume_do_not_change_in_a_rigid_motion(rng):
    body, motion = body_from(rng), motion_from(rng)
    moved = motion(body.vertices)
    for measure in (edge_lengths, face_areas, vertex_areas, enclosed_volume):
        near(measure(moved, body.faces), measure(body.vertices, body.faces))


@laws
@given(generators, factors)
def test_lengths_areas_and_volume_grow_with_the_first_second_and_third_power_of_scale(rng, factor):
    body = body_from(rng)
    scaled = factor * body.vertices
    for measure, power in (
        (median_edge_length, 1),
        (face_areas, 2),
        (vertex_areas, 2),
        (enclosed_volume, 3),
    ):
        near(measure(scaled, body.faces), factor**power * measure(body.vertices, body.faces))


@laws
@given(generators)
def test_measures_of_vertices_and_faces_follow_their_numbering(rng):
    body = body_from(rng)
    order, other = numbering(rng, body)
    places = rng.permutation(len(body.faces))
    faces = other.faces[places]
    near(vertex_areas(other.vertices, faces), vertex_areas(body.vertices, body.faces)[order])
    near(vertex_normals(other.vertices, faces), vertex_normals(body.vertices, body.faces)[order])
    near(face_areas(other.vertices, faces), face_areas(body.vertices, body.faces)[places])
    near(enclosed_volume(other.vertices, faces), enclosed_volume(body.vertices, body.faces))


@laws
@given(generators, st.integers(1, 2))
def test_areas_and_volume_do_not_depend_on_the_first_corner_of_a_face(rng, turn):
    body = body_from(rng)
    turned = np.roll(body.faces, turn, axis=1)
    near(face_areas(body.vertices, turned), face_areas(body.vertices, body.faces))
    near(enclosed_volume(body.vertices, turned), enclosed_volume(body.vertices, body.faces))


@laws
@given(generators)
def test_volume_and_normals_change_sign_with_the_orientation(rng):
    body = body_from(rng)
    turned = body.faces[:, ::-1]
    near(enclosed_volume(body.vertices, turned), -enclosed_volume(body.vertices, body.faces))
    near(face_normals(body.vertices, turned), -face_normals(body.vertices, body.faces))


@laws
@given(generators, factors)
def test_normals_turn_with_the_surface_and_ignore_its_size_and_place(rng, factor):
    body, motion = body_from(rng), motion_from(rng)
    moved = motion(factor * body.vertices)
    for normals in (face_normals, vertex_normals):
        expected = normals(body.vertices, body.faces) @ motion.rotation.T
        assert_allclose(normals(moved, body.faces), expected, rtol=0.0, atol=1e-6)


# Operators.


@laws
@given(generators, factors)
def test_cotangents_and_stiffness_do_not_change_under_a_similarity(rng, factor):
    body, rotation = body_from(rng), motion_from(rng).rotation
    moved = factor * (body.vertices @ rotation.T)
    for operator in (
        corner_cotangents,
        lambda vertices, faces: cotangent_stiffness(vertices, faces).toarray(),
    ):
        near(operator(moved, body.faces), operator(body.vertices, body.faces))


@laws
@given(generators)
def test_operators_follow_the_numbering_of_vertices_and_ignore_that_of_faces(rng):
    body = body_from(rng)
    order, other = numbering(rng, body)
    faces = other.faces[rng.permutation(len(other.faces))]
    both = np.ix_(order, order)
    near(
        cotangent_stiffness(other.vertices, faces).toarray(),
        cotangent_stiffness(body.vertices, body.faces).toarray()[both],
    )
    near(
        uniform_laplacian(faces, N_VERTICES).toarray(),
        uniform_laplacian(body.faces, N_VERTICES).toarray()[both],
    )


# On the sphere.


@laws
@given(generators)
def test_spherical_areas_do_not_change_in_a_rotation(rng):
    body, rotation = body_from(rng), motion_from(rng).rotation
    near(
        spherical_areas(body.directions @ rotation.T, body.faces),
        spherical_areas(body.directions, body.faces),
    )


@laws
@given(generators)
def test_exact_orientations_follow_the_numbering_and_change_sign_with_it(rng):
    body = body_from(rng)
    _, other = numbering(rng, body)
    signs = exact_orientations(body.directions, body.faces)
    assert_array_equal(exact_orientations(other.directions, other.faces), signs)
    assert_array_equal(exact_orientations(body.directions, body.faces[:, ::-1]), -signs)


@laws
@given(generators)
def test_a_direction_is_located_alike_whatever_the_rotation_and_the_numbering(rng):
    body, rotation = body_from(rng), motion_from(rng).rotation
    queries = normalised(rng.normal(size=(40, 3)))
    faces, weights = locate(sphere_locator(body.directions, body.faces), queries)
    turned = sphere_locator(body.directions @ rotation.T, body.faces)
    there, same = locate(turned, queries @ rotation.T)
    assert_array_equal(there, faces)
    near(same, weights)
    _, other = numbering(rng, body)
    there, same = locate(sphere_locator(other.directions, other.faces), queries)
    assert_array_equal(there, faces)
    near(same, weights)


# Distances and quantiles.


@laws
@given(generators, factors)
def test_distances_do_not_change_in_a_common_motion_and_grow_with_scale(rng, factor):
    one, two, motion = body_from(rng), body_from(rng), motion_from(rng)
    before = surface_distances(one.vertices[None], one.faces, two.vertices, two.faces)[0]
    moved = [motion(factor * body.vertices) for body in (one, two)]
    after = surface_distances(moved[0][None], one.faces, moved[1], two.faces)[0]
    assert_allclose(after.mean, factor * before.mean, rtol=1e-6)
    assert_allclose(after.p95, factor * before.p95, rtol=1e-6)
    assert_allclose(after.maximum, factor * before.maximum, rtol=1e-6)


@laws
@given(generators)
def test_closest_points_move_with_the_surface_and_ignore_its_numbering(rng):
    body, motion = body_from(rng), motion_from(rng)
    queries = 40.0 * rng.normal(size=(30, 3))
    found = closest_points(surface_tree(body.vertices, body.faces), queries)
    _, other = numbering(rng, body)
    tree = surface_tree(motion(other.vertices), other.faces[rng.permutation(len(other.faces))])
    moved = closest_points(tree, motion(queries))
    assert_allclose(moved.distances, found.distances, rtol=0.0, atol=1e-9)
    assert_allclose(moved.points, motion(found.points), rtol=0.0, atol=1e-6)


@laws
@given(generators, st.floats(0.01, 0.99), factors, st.floats(-100.0, 100.0))
def test_a_quantile_follows_scale_and_shift_of_values_and_ignores_their_order(
    rng, share, factor, shift
):
    values, weights = rng.normal(size=20), rng.uniform(0.1, 1.0, size=20)
    expected = factor * weighted_quantile(values, weights, share) + shift
    order = rng.permutation(20)
    found = weighted_quantile(factor * values[order] + shift, weights[order], share)
    assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


@laws
@given(generators, st.floats(0.01, 0.99), factors)
def test_a_quantile_ignores_the_unit_of_weights_and_the_division_of_a_value(rng, share, factor):
    values, weights = rng.normal(size=20), rng.uniform(0.1, 1.0, size=20)
    expected = weighted_quantile(values, weights, share)
    assert weighted_quantile(values, factor * weights, share) == expected
    assert weighted_quantile(np.tile(values, 2), np.tile(weights / 2.0, 2), share) == expected


# Populations.


@laws
@given(generators)
def test_alignment_ignores_how_every_shape_was_moved(rng):
    shapes, weights, _ = shapes_from(rng)
    moved = np.array([motion_from(rng)(shape) for shape in shapes])
    before, after = (align(given, weights) for given in (shapes, moved))
    assert before.reference == after.reference
    near(after.aligned[after.reference], moved[after.reference])
    distances = [np.linalg.norm(found.aligned - found.mean, axis=2) for found in (before, after)]
    assert_allclose(distances[1], distances[0], rtol=0.0, atol=1e-4)


@laws
@given(generators, factors)
def test_alignment_grows_with_scale(rng, factor):
    shapes, weights, _ = shapes_from(rng)
    near(align(factor * shapes, weights).aligned, factor * align(shapes, weights).aligned)


@laws
@given(generators)
def test_alignment_follows_the_order_of_shapes_and_the_numbering_of_points(rng):
    shapes, weights, _ = shapes_from(rng)
    first, second = rng.permutation(N_SHAPES), rng.permutation(N_VERTICES)
    found = align(shapes[first][:, second], weights[second]).aligned
    near(found, align(shapes, weights).aligned[first][:, second])


@laws
@given(generators, factors)
def test_description_length_does_not_change_in_a_common_motion_nor_with_the_unit(rng, factor):
    shapes, weights, _ = shapes_from(rng)
    motion = motion_from(rng)
    lengths = [
        description_length(given, weights, cut_off_eigenvalue(noise, N_SHAPES, N_VERTICES))
        for given, noise in ((shapes, 0.2), (motion(factor * shapes), 0.2 * factor))
    ]
    assert_allclose(lengths[1], lengths[0], rtol=1e-6)


@laws
@given(generators)
def test_description_length_ignores_the_order_of_shapes_and_the_numbering_of_points(rng):
    shapes, weights, _ = shapes_from(rng)
    first, second = rng.permutation(N_SHAPES), rng.permutation(N_VERTICES)
    found = description_length(shapes[first][:, second], weights[second], 0.01)
    assert_allclose(found, description_length(shapes, weights, 0.01), rtol=RELATIVE)


@laws
@given(generators)
def test_description_length_ignores_the_division_of_a_point(rng):
    shapes, weights, _ = shapes_from(rng)
    doubled = np.concatenate([shapes, shapes], axis=1)
    halves = np.concatenate([weights, weights]) / 2.0
    found = description_length(doubled, halves, 0.01)
    assert_allclose(found, description_length(shapes, weights, 0.01), rtol=RELATIVE)


def covariance(modes: FloatArray, variances: FloatArray) -> FloatArray:
    flat = modes.reshape(len(modes), -1)
    return (flat.T * variances) @ flat


@laws
@given(generators)
def test_the_mean_and_modes_of_a_model_turn_with_the_shapes_and_its_variances_stay(rng):
    shapes, weights, faces = shapes_from(rng)
    motion = motion_from(rng)
    before, after = (model_of(given, weights, faces) for given in (shapes, motion(shapes)))
    near(after.mean, motion(before.mean))
    near(after.variances, before.variances)
    turned = before.modes @ motion.rotation.T
    near(covariance(after.modes, after.variances), covariance(turned, before.variances))


@laws
@given(generators, factors)
def test_the_variances_of_a_model_grow_with_the_square_of_scale(rng, factor):
    shapes, weights, faces = shapes_from(rng)
    before, after = (model_of(given, weights, faces) for given in (shapes, factor * shapes))
    near(after.variances, factor**2 * before.variances)
    near(after.mean, factor * before.mean)


@laws
@given(generators)
def test_a_model_ignores_the_order_of_shapes_and_follows_the_numbering_of_points(rng):
    shapes, weights, faces = shapes_from(rng)
    first, second = rng.permutation(N_SHAPES), rng.permutation(N_VERTICES)
    before = model_of(shapes, weights, faces)
    after = model_of(shapes[first][:, second], weights[second], relabelled(second, faces))
    near(after.mean, before.mean[second])
    near(after.variances, before.variances)
    renumbered = before.modes[:, second]
    near(covariance(after.modes, after.variances), covariance(renumbered, before.variances))


@laws
@given(generators, factors)
def test_variance_across_and_along_the_surface_turns_and_grows_with_the_shapes(rng, factor):
    shapes, weights, faces = shapes_from(rng)
    before = divided_variance(shapes, weights, faces)
    after = divided_variance(motion_from(rng)(factor * shapes), weights, faces)
    assert_allclose(after.normal, factor**2 * before.normal, rtol=1e-6)
    assert_allclose(after.tangential, factor**2 * before.tangential, rtol=1e-6)
