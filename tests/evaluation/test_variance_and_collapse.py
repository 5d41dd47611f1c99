"""Variance by direction, what the surfaces allow, and the alarm for collapse."""

from dataclasses import replace

import numpy as np
import pytest

from ostiform.errors import InputError
from ostiform.evaluation import (
    Coverage,
    Evaluation,
    OriginalMesh,
    divided_variance,
    evaluate_model,
    population_spread,
    signs_of_collapse,
    surface_variance,
    weight_drift,
)
from ostiform.evaluation import variance as variance_module
from ostiform.model import fit_model, mesh_of_template
from tests.populations import area_weights, ellipsoids, population, two_part_template

ROUNDING = 1e-10


def spheres(radii, turns=None):
    """Return spheres of radii (N,) mm, each turned about z by an angle (N,), and their faces."""
    template = two_part_template(33, 48)
    shapes = template.points * np.asarray(radii)[:, None, None]
    turns = np.zeros(len(shapes)) if turns is None else np.asarray(turns)
    cosine, sine, zero, one = np.cos(turns), np.sin(turns), 0 * turns, 1 + 0 * turns
    rotations = np.array(
        [[cosine, -sine, zero], [sine, cosine, zero], [zero, zero, one]]
    ).transpose(2, 0, 1)
    return shapes @ rotations.transpose(0, 2, 1), template


def test_spheres_of_several_radii_vary_along_their_normals_only():
    shapes, template = spheres([38.0, 40.0, 45.0])
    weights = area_weights(template.points, template.faces)
    found = divided_variance(shapes, weights, template.faces)
    expected = np.var([38.0, 40.0, 45.0], ddof=1)
    # The normal of a mesh is not quite that of the sphere at the rims.
    np.testing.assert_allclose(found.normal, expected, rtol=2e-3)
    np.testing.assert_allclose(found.total, expected, rtol=ROUNDING)


def test_spheres_turned_about_their_axis_vary_in_tangent_planes_only():
    turns = np.radians([-3.0, 1.0, 2.0])
    shapes, template = spheres([40.0] * 3, turns)
    weights = area_weights(template.points, template.faces)
    found = divided_variance(shapes, weights, template.faces)
    assert found.normal < 0.01 * found.tangential
    mean = shapes.mean(axis=0)
    total = ((shapes - mean) ** 2).sum(axis=(0, 2)) @ weights / 2.0
    np.testing.assert_allclose(found.total, total, rtol=ROUNDING)
    # Turning changes no surface: hardly any of this variance is demanded by the surfaces.
    assert surface_variance(shapes, weights, template.faces) < 0.02 * found.total


def test_the_two_parts_of_the_variance_are_that_of_the_model():
    shapes = population(3, 4, np.random.default_rng(1))
    model = fit_model(shapes.aligned, shapes.weights, mesh_of_template(shapes.template))
    found = divided_variance(shapes.aligned, shapes.weights, shapes.template.faces)
    np.testing.assert_allclose(found.total, model.total_variance, rtol=ROUNDING)


def test_the_variance_that_concentric_spheres_demand_is_that_of_their_radii():
    shapes, template = spheres([39.0, 40.0, 42.0])
    weights = area_weights(template.points, template.faces)
    found = surface_variance(shapes, weights, template.faces)
    # Chords lie within the sphere; at the rims the nearest point of a larger sphere is not radial.
    np.testing.assert_allclose(found, np.var([39.0, 40.0, 42.0], ddof=1), rtol=0.02)


def test_no_correspondence_varies_less_than_its_surfaces_demand(rng):
    for seed in range(3):
        shapes = population(3, 3, np.random.default_rng(seed))
        faces = shapes.template.faces
        total = divided_variance(shapes.aligned, shapes.weights, faces).total
        assert surface_variance(shapes.aligned, shapes.weights, faces) <= total


def test_some_pairs_of_many_give_nearly_the_variance_of_all(monkeypatch):
    shapes = population(6, 4, np.random.default_rng(3))
    arguments = shapes.aligned, shapes.weights, shapes.template.faces
    some = surface_variance(*arguments)
    monkeypatch.setattr(variance_module, "MOST_PAIRS", 10_000)
    np.testing.assert_allclose(some, surface_variance(*arguments), rtol=0.15)


def test_variance_of_one_shape_is_refused():
    shapes, template = spheres([40.0])
    weights = area_weights(template.points, template.faces)
    for function in (divided_variance, surface_variance):
        with pytest.raises(InputError, match="at least 2 shapes, found 1"):
            function(shapes, weights, template.faces)


def test_weights_that_are_the_area_shares_have_not_drifted():
    shapes, template = spheres([38.0, 45.0])
    weights = area_weights(template.points, template.faces)
    np.testing.assert_allclose(weight_drift(shapes, weights, template.faces), 0.0, atol=ROUNDING)


def test_weights_on_points_without_area_have_drifted_by_what_they_hold():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 5, 0]])
    weights = np.array([0.2, 0.2, 0.2, 0.4])  # the last point belongs to no triangle
    drift = weight_drift(points[None], weights, np.array([[0, 1, 2]]))
    np.testing.assert_allclose(drift, 0.4, rtol=ROUNDING)


def squeezed(points, latitude, share):
    """Return unit vectors whose part beyond a latitude is squeezed towards it."""
    angle = np.arcsin(points[:, 2])
    moved = np.where(np.abs(angle) > latitude, np.sign(angle) * latitude, angle)
    new = (1.0 - share) * angle + share * moved
    lift = np.cos(new) / np.cos(angle)
    return np.column_stack([points[:, :2] * lift[:, None], np.sin(new)])


@pytest.fixture(scope="module")
def evaluated():
    """Return ellipsoids that differ beyond 20 degrees of latitude most, evaluated two ways.

    Once sampled evenly; once with the points drawn to the belt where the shapes agree.
    """
    template = two_part_template(33, 48)
    shapes = population(4, 3, np.random.default_rng(2), template)
    axes = np.column_stack([np.full((12, 2), 40.0), np.linspace(36.0, 60.0, 12)])
    originals = [OriginalMesh(shape, template.faces) for shape in ellipsoids(template.points, axes)]

    def of(directions) -> Evaluation:
        points = ellipsoids(directions, axes)
        weights = area_weights(ellipsoids(template.points, axes).mean(axis=0), template.faces)
        still = np.broadcast_to(np.eye(4), (12, 4, 4))
        own = replace(shapes, points=points, aligned=points, transforms=still, weights=weights)
        even = ellipsoids(template.points, axes)
        start = replace(own, points=even, aligned=even)
        model = fit_model(points, weights, mesh_of_template(template))
        return evaluate_model("optimal", model, (own, start), originals, 0.01, 0)

    return of(template.points), of(squeezed(template.points, np.radians(20.0), 0.9))


def test_an_even_sampling_is_no_collapse(evaluated):
    even, _ = evaluated
    assert signs_of_collapse(even, even) == ()


def test_points_that_flee_to_where_the_shapes_agree_are_a_collapse_by_every_sign(evaluated):
    even, collapsed = evaluated
    assert collapsed.compactness.total < 0.5 * even.compactness.total  # more compact indeed
    signs = signs_of_collapse(collapsed, even)
    assert len(signs) == 3
    for sign, part in zip(signs, ("along the normals", "% of the area", "covered"), strict=True):
        assert part in sign
        assert "found" in sign


def test_every_sign_of_collapse_is_seen_alone(evaluated):
    even, collapsed = evaluated
    sound, bad = even.spread, collapsed.spread
    one = replace(even, spread=replace(sound, variance=bad.variance))
    assert ["along the normals" in sign for sign in signs_of_collapse(one, even)] == [True]
    two = replace(even, spread=replace(sound, weight_drift=bad.weight_drift))
    assert ["% of the area" in sign for sign in signs_of_collapse(two, even)] == [True]
    three = replace(even, coverage=collapsed.coverage)
    assert ["covered" in sign for sign in signs_of_collapse(three, even)] == [True]


def test_an_evaluation_of_an_earlier_version_is_judged_by_its_coverage(evaluated):
    even, collapsed = evaluated
    old = replace(collapsed, spread=None)
    assert len(signs_of_collapse(old, even)) == 1


def test_a_start_that_covers_exactly_is_no_reason_for_an_alarm(evaluated):
    even, _ = evaluated
    exact = tuple(
        Coverage(0.0, 0.0, item.diameter, item.smallest_share, 1.0) for item in even.coverage
    )
    rounded = tuple(replace(item, p95=1e-9) for item in exact)
    assert signs_of_collapse(replace(even, coverage=rounded), replace(even, coverage=exact)) == ()


def test_the_spread_of_a_population_gathers_its_parts():
    shapes, template = spheres([38.0, 40.0, 45.0])
    weights = area_weights(template.points, template.faces)
    found = population_spread(shapes, shapes, weights, template.faces)
    assert found.variance == divided_variance(shapes, weights, template.faces)
    assert found.surface_variance == surface_variance(shapes, weights, template.faces)
    assert found.weight_drift == weight_drift(shapes, weights, template.faces)
