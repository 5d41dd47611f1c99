"""The certificate passes a perfect map and notices every planted defect."""

from dataclasses import replace

import numpy as np
import pytest

from ostiform.domain import Circle, Sphere
from ostiform.embedding import certify, population_problems
from ostiform.errors import InputError
from ostiform.surface import Component, inverse_stereographic, rotation_between, stereographic
from tests.oracles.spherical_domains import SEAM, circle, domain_of_circles, left_atrium, left_heart


def twisted(directions, border, outer, angle):
    """Turn the sphere about a circle: by nothing on it, by `angle` beyond the polar angle `outer`.

    A full turn is a Dehn twist: a homeomorphism that moves no rim.
    """
    polar = np.arccos(np.clip(directions @ border.center, -1.0, 1.0))
    share = np.clip((polar - border.radius) / (outer - border.radius), 0.0, 1.0)
    c, s = np.cos(angle * share)[:, None], np.sin(angle * share)[:, None]
    axis = border.center
    along = (directions @ axis)[:, None] * axis
    return along + c * (directions - along) + s * np.cross(axis, directions)


def test_the_identity_of_a_domain_is_certified():
    for component, sphere, directions in (left_atrium(), left_heart()):
        certificate = certify(component, sphere, directions)
        assert certificate.is_valid, certificate.problems
        assert (certificate.flipped, certificate.degenerate) == (0, 0)
        assert certificate.area_defect < 1e-12
        assert certificate.rim_error < 1e-12
        assert all(abs(angle) < np.radians(30) for angle in certificate.twist.values())


def test_a_closed_surface_and_one_opening_are_certified():
    closed = domain_of_circles({}, count=400)
    single = domain_of_circles({"A.only": circle(20, 50, 25)}, count=400, pole="A.only")
    assert certify(*closed).problems == ()
    assert certify(*closed).hole_order == ()
    assert certify(*single).problems == ()


def test_a_planted_flip_is_counted():
    component, sphere, directions = left_atrium()
    curves = np.concatenate(list(component.rims.values()))
    free = np.setdiff1d(np.arange(len(directions)), curves)
    vertex = int(free[100])
    fan = component.faces[(component.faces == vertex).any(axis=1)]
    ring = np.setdiff1d(fan, [vertex])
    moved = directions.copy()
    beyond = moved[vertex] + 2.5 * (moved[ring[0]] - moved[vertex])
    moved[vertex] = beyond / np.linalg.norm(beyond)
    certificate = certify(component, sphere, moved)
    assert certificate.flipped > 0
    assert any("flipped" in sentence for sentence in certificate.problems)
    # A fold covers some of the domain three times with signs that cancel: the area cannot tell.
    assert certificate.area_defect < 1e-12


def test_a_degenerate_triangle_is_counted():
    component, sphere, directions = left_atrium()
    curves = np.concatenate(list(component.rims.values()))
    inner = component.faces[~np.isin(component.faces, curves).any(axis=1)]
    moved = directions.copy()
    moved[inner[50][0]] = moved[inner[50][1]]
    certificate = certify(component, sphere, moved)
    assert certificate.degenerate > 0
    assert not certificate.is_valid


def test_a_map_that_covers_the_domain_twice_is_noticed_by_its_area():
    # z -> z^2 about the pole winds every curve twice; an annulus about the axis without branch.
    rims = {"A.north": circle(0, 0, 40), "A.south": circle(180, 0, 40)}
    component, sphere, directions = domain_of_circles(rims, count=3000, pole="A.north")
    doubled = inverse_stereographic(
        stereographic(directions) ** 2 / np.abs(stereographic(directions))
    )
    certificate = certify(component, sphere, doubled)
    assert certificate.flipped == 0
    assert certificate.area_defect > 0.5
    assert any("cover the domain once" in sentence for sentence in certificate.problems)


def test_a_rim_off_its_circle_is_measured():
    component, sphere, directions = left_atrium()
    rim = component.rims["A.b"]
    moved = directions.copy()
    away = moved[rim[3]] + 0.01 * (moved[rim[3]] - sphere.rims["A.b"].center)
    moved[rim[3]] = away / np.linalg.norm(away)
    certificate = certify(component, sphere, moved)
    assert certificate.rim_error > 1e-4
    assert any(
        sentence.startswith("A.b: expected its vertices on") for sentence in certificate.problems
    )


def test_a_rim_that_turns_back_is_noticed():
    component, sphere, directions = left_atrium()
    rim = component.rims["A.b"]
    moved = directions.copy()
    moved[rim[[3, 4]]] = moved[rim[[4, 3]]]
    certificate = certify(component, sphere, moved)
    assert any("run backwards" in sentence for sentence in certificate.problems)


def test_a_seam_with_its_parts_exchanged_is_noticed():
    component, sphere, directions = left_heart()
    exchanged = Component(
        component.name,
        component.parts,
        component.vertices,
        component.faces,
        1 - component.face_part,
        component.rims,
        component.seams,
    )
    problems = certify(exchanged, sphere, directions).problems
    assert any("on the left of every edge" in sentence for sentence in problems)
    assert any("reach over it" in sentence for sentence in problems)


def test_openings_in_another_order_are_noticed_in_the_population():
    first = certify(*left_atrium())
    component, sphere, directions = left_atrium()
    swapped = replace(
        sphere, rims={**sphere.rims, "A.a": sphere.rims["A.b"], "A.b": sphere.rims["A.a"]}
    )
    exchanged = Component(
        component.name,
        component.parts,
        component.vertices,
        component.faces,
        component.face_part,
        {**component.rims, "A.a": component.rims["A.b"], "A.b": component.rims["A.a"]},
        {},
    )
    other = certify(exchanged, swapped, directions)
    assert other.is_valid
    assert first.hole_order == ("A.a", "A.b", "A.c")
    assert other.hole_order == ("A.a", "A.c", "A.b")
    problems = population_problems([first, other, first])
    assert problems[0] == problems[2] == ()
    assert "expected the openings in the order A.a, A.b, A.c" in problems[1][0]


@pytest.mark.parametrize("turns", [-1, 1, 2])
@pytest.mark.parametrize("name", ["A.b", "A.mitral"])
def test_a_dehn_twist_changes_the_twist_of_its_tube_only_by_whole_turns(name, turns):
    component, sphere, directions = left_atrium(count=6000)
    border = sphere.rims[name]
    plain = certify(component, sphere, directions)
    turned = twisted(directions, border, border.radius + np.radians(25), 2.0 * np.pi * turns)
    np.testing.assert_allclose(
        turned[component.rims[name]], directions[component.rims[name]], atol=1e-12
    )
    certificate = certify(component, sphere, turned)
    change = {n: certificate.twist[n] - plain.twist[n] for n in plain.twist}
    np.testing.assert_allclose(change.pop(name), 2.0 * np.pi * turns, atol=0.5)
    # The twisted ring shears the rings of its neighbours, which is less than another turn.
    np.testing.assert_allclose(list(change.values()), 0.0, atol=np.radians(80))
    problems = population_problems([plain, plain, certificate])
    assert problems[0] == problems[1] == ()
    assert len(problems[2]) == 1
    assert problems[2][0].startswith(f"{name}: expected its tube twisted within 90 degrees")


def test_a_dehn_twist_of_a_seam_shows_on_the_side_it_is_on():
    component, sphere, directions = left_heart(count=6000)
    outside = directions[:, 2] < 0.0
    turned = directions.copy()
    below = Circle(np.array([0.0, 0.0, 1.0]), 0.5 * np.pi)
    turned[outside] = twisted(directions[outside], below, 0.5 * np.pi + np.radians(20), 2.0 * np.pi)
    plain, certificate = certify(component, sphere, directions), certify(component, sphere, turned)
    change = {name: certificate.twist[name] - plain.twist[name] for name in plain.twist}
    assert set(change) == {"LV.mitral", "LA.mitral", "LV.aortic", "LA.a", "LA.b"}
    np.testing.assert_allclose(change.pop("LV.mitral"), 2.0 * np.pi, atol=0.5)
    # The twisted ring shears the rings of its neighbours, which is less than another turn.
    np.testing.assert_allclose(list(change.values()), 0.0, atol=np.radians(80))


def test_the_certificate_does_not_depend_on_where_the_domain_lies():
    component, sphere, directions = left_atrium()
    rotation = rotation_between(np.array([0.0, 0.0, 1.0]), np.array([0.3, -0.8, 0.5]))
    rims = {n: Circle(rotation @ c.center, c.radius) for n, c in sphere.rims.items()}
    turned = Sphere(sphere.name, sphere.parts, rims, {}, sphere.pole)
    one, two = (
        certify(component, sphere, directions),
        certify(component, turned, directions @ rotation.T),
    )
    assert two.problems == ()
    assert one.hole_order == two.hole_order
    np.testing.assert_allclose(list(one.twist.values()), list(two.twist.values()), atol=1e-9)


def test_an_empty_population_has_no_problems():
    assert population_problems([]) == ()


def test_a_tube_without_a_base_has_no_twist():
    # Everything collapsed into the ring of one circle: no vertex beyond it.
    rims = {"A.north": circle(0, 0, 40), "A.south": circle(180, 0, 40)}
    component, sphere, directions = domain_of_circles(rims, count=400, pole="A.north")
    squeezed = directions.copy()
    squeezed[:, 2] = np.cos(np.radians(41))
    squeezed[:, :2] *= np.sin(np.radians(41)) / np.linalg.norm(squeezed[:, :2], axis=1)[:, None]
    certificate = certify(component, sphere, squeezed)
    assert np.isnan(certificate.twist["A.north"])
    assert any("its twist is unknown" in sentence for sentence in certificate.problems)
    problems = population_problems([certify(component, sphere, directions), certificate])
    assert any("A.north: expected its tube twisted" in sentence for sentence in problems[1])


def test_directions_or_circles_of_another_component_are_refused():
    component, sphere, directions = left_atrium()
    with pytest.raises(InputError, match="expected directions of shape"):
        certify(component, sphere, directions[:-1])
    with pytest.raises(InputError, match="expected circles for the rims"):
        certify(component, replace(sphere, rims={}), directions)
    heart, heart_sphere, heart_directions = left_heart()
    with pytest.raises(InputError, match="1 seams"):
        certify(heart, replace(heart_sphere, seams={}), heart_directions)
    assert SEAM in heart.seams
