"""Populations at the edges of what is allowed: closed shapes, several spheres, two shapes."""

from dataclasses import replace

import numpy as np
import pytest

from ostiform.correspondence import CorrespondenceSettings, correspond, place
from ostiform.correspondence.build import shared_metric_of_template
from ostiform.correspondence.fields import circle_table
from ostiform.correspondence.sampling import ShapeSampler
from ostiform.domain import BaseDomain, Sphere, Template
from ostiform.errors import InputError
from ostiform.surface import exact_orientations
from tests.oracles.warped_shapes import one_part_domain, triangulated, warped_family

SETTINGS = CorrespondenceSettings(levels=3, n_points=200, n_optimised=100, sweeps=3, per="shape")


def closed_domain(name="A"):
    return BaseDomain((Sphere(name, (name,), {}, {}, None),))


def trained_on(family, template, settings=SETTINGS):
    shared = shared_metric_of_template(
        family.samplers, family.ids, family.domain, template, settings
    )
    return correspond(family.samplers, family.ids, shared, settings)


def test_closed_shapes_have_no_boundary_control_points(rng):
    domain = closed_domain()
    family = warped_family(domain, 4, rng, n_vertices=400, warp=0.1)
    template = triangulated(domain, 200)
    optimal = trained_on(family, template)["optimal"]
    assert optimal.boundary.n_boundary == 0
    assert optimal.interior.n_interior == 4 + 16
    for directions in optimal.correspondence.directions:
        assert (exact_orientations(directions, template.faces) > 0).all()


def test_two_shapes_are_enough(rng):
    domain = one_part_domain()
    family = warped_family(domain, 2, rng, n_vertices=400, warp=0.1, twist=0.02)
    trained = trained_on(family, triangulated(domain, 200))
    assert len(trained["optimal"].correspondence.points) == 2


def test_two_components_are_warped_on_their_own_spheres(rng):
    first, second = one_part_domain(), closed_domain("B")
    families = [warped_family(d, 4, rng, n_vertices=400, warp=0.1) for d in (first, second)]
    domain = BaseDomain((first.spheres[0], second.spheres[0]))
    one, two = triangulated(first, 150), triangulated(second, 150)
    count = len(one.points)
    template = Template(
        points=np.vstack([one.points, two.points]),
        sphere=np.repeat([0, 1], [count, len(two.points)]),
        part=np.repeat([0, 1], [count, len(two.points)]),
        faces=np.vstack([one.faces, two.faces + count]),
        face_part=np.repeat([0, 1], [len(one.faces), len(two.faces)]),
        parts=("A", "B"),
        curve=np.concatenate([one.curve, two.curve]),
        curves=one.curves,
        loops=one.loops,
    )
    samplers = tuple(
        ShapeSampler((*a.components, *b.components))
        for a, b in zip(families[0].samplers, families[1].samplers, strict=True)
    )
    ids = families[0].ids
    shared = shared_metric_of_template(samplers, ids, domain, template, SETTINGS)
    optimal = correspond(samplers, ids, shared, SETTINGS)["optimal"]
    np.testing.assert_array_equal(np.bincount(optimal.interior.sphere), [20, 20])
    np.testing.assert_allclose(np.linalg.norm(optimal.correspondence.directions, axis=2), 1.0)
    placed = place(samplers[:2], ids[:2], optimal.frozen)
    assert placed.points.shape == (2, len(template.points), 3)


def test_points_of_rims_stay_on_the_rims_of_the_shapes(rng):
    domain = one_part_domain()
    family = warped_family(domain, 4, rng, n_vertices=400, warp=0.1, twist=0.03)
    template = triangulated(domain, 200)
    optimal = trained_on(family, template)["optimal"].correspondence
    slid = 0.0
    for number, circle in enumerate(domain.spheres[0].rims.values()):
        on_rim = template.curve == number
        cosines = optimal.directions[:, on_rim] @ circle.center
        np.testing.assert_allclose(cosines, np.cos(circle.radius), atol=1e-12)
        slid = max(slid, np.abs(optimal.directions[:, on_rim] - template.points[on_rim]).max())
    assert slid > 1e-3


def test_large_coordinates_do_not_change_the_result(rng):
    domain = one_part_domain()
    family = warped_family(domain, 3, rng, n_vertices=400, warp=0.1, twist=0.03)
    template = triangulated(domain, 200)
    shift = np.array([1000.0, -2000.0, 500.0])
    moved = tuple(
        ShapeSampler(tuple(_shifted(part, shift) for part in sampler.components))
        for sampler in family.samplers
    )
    here = trained_on(family, template)["optimal"].correspondence
    there = trained_on(replace(family, samplers=moved), template)["optimal"].correspondence
    np.testing.assert_allclose(there.points - shift, here.points, atol=1e-6)


def _shifted(part, shift):
    return replace(
        part, component=replace(part.component, vertices=part.component.vertices + shift)
    )


def test_circles_that_the_domain_lacks_are_refused():
    template = triangulated(one_part_domain(), 200)
    with pytest.raises(InputError, match=r"A\.top"):
        circle_table(closed_domain(), template)


def test_placing_nothing_is_refused(rng):
    domain = one_part_domain()
    family = warped_family(domain, 2, rng, n_vertices=400, warp=0.05, twist=0.02)
    trained = trained_on(family, triangulated(domain, 150))
    with pytest.raises(InputError, match="at least one shape"):
        place([], [], trained["optimal"].frozen)
