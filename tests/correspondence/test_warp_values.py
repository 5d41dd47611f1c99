"""Warps as values: evaluated anywhere, they give what the run found."""

from dataclasses import replace

import numpy as np
import pytest

from ostiform.correspondence import CorrespondenceSettings, correspond, hierarchy, lloyd, place
from ostiform.correspondence.build import shared_metric_of_template
from ostiform.correspondence.warp import side_by_side
from ostiform.errors import InputError
from tests.oracles.warped_shapes import (
    one_part_domain,
    triangulated,
    two_part_domain,
    warped_family,
    with_level,
)

SETTINGS = CorrespondenceSettings(
    levels=3, n_points=300, n_optimised=100, per="shape", sweeps=4, noise_mm=0.3
)


def trained(family, settings=SETTINGS, count=None):
    domain = family.domain
    template = with_level(triangulated(domain, 300), domain, 120)
    samplers, ids = family.samplers[:count], family.ids[:count]
    shared = shared_metric_of_template(samplers, ids, domain, template, settings)
    return correspond(samplers, ids, shared, settings)


@pytest.fixture(scope="module", params=["majorise", "conjugate-gradient", "batches"])
def built(request):
    settings = SETTINGS
    if request.param == "conjugate-gradient":
        settings = replace(SETTINGS, optimiser="conjugate-gradient", levels=2, sweeps=2)
    if request.param == "batches":
        settings = replace(SETTINGS, batch=2)
    domain = one_part_domain() if request.param == "batches" else two_part_domain()
    family = warped_family(domain, 5, np.random.default_rng(3), n_vertices=600)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lloyd, "ENOUGH", 0.0)  # the points are moved wherever that helps at all
        return family, trained(family, settings)


def test_the_template_is_carried_to_the_directions_of_every_shape(built):
    family, models = built
    start = models["conformal"].correspondence.template
    assert np.abs(models["optimal"].correspondence.template.points - start.points).max() > 1e-4
    for model in models.values():
        template = model.correspondence.template
        for id, directions in zip(family.ids, model.correspondence.directions, strict=True):
            found = model.warps.of(id)(template.points, template.sphere)
            np.testing.assert_allclose(found, directions, atol=1e-9, rtol=0.0)


def test_a_warp_is_continuous_and_keeps_circles(built):
    family, models = built
    warp = models["optimal"].warps.at(0)
    rng = np.random.default_rng(1)
    points = rng.normal(size=(50, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    near = points + 1e-7 * rng.normal(size=points.shape)
    near /= np.linalg.norm(near, axis=1, keepdims=True)
    apart = np.linalg.norm(warp(points) - warp(near), axis=1)
    assert apart.max() < 1e-5
    for circle in family.domain.spheres[0].curves.values():
        around = circle.points(np.linspace(0.0, 6.0, 20))
        np.testing.assert_allclose(warp(around) @ circle.center, np.cos(circle.radius), atol=1e-12)


def test_directions_of_no_length_are_refused(built):
    with pytest.raises(InputError, match="unit vectors"):
        built[1]["optimal"].warps.at(0)(np.zeros((1, 3)))


def test_a_warp_of_no_shape_is_refused(built):
    with pytest.raises(InputError, match="warp of nobody/0"):
        built[1]["optimal"].warps.of("nobody/0")


def test_a_placed_shape_has_its_warp_too(built):
    family, models = built
    model = models["optimal"]
    placed = place(family.samplers[:2], family.ids[:2], model.frozen)
    template = model.correspondence.template
    for index in range(2):
        found = placed.warps.at(index)(template.points, template.sphere)
        np.testing.assert_allclose(found, placed.directions[index], atol=1e-9, rtol=0.0)
    both = side_by_side(model.warps, placed.warps)
    assert both.ids == (*family.ids, *family.ids[:2])
    found = both.at(len(family.ids))(template.points, template.sphere)
    np.testing.assert_array_equal(found, placed.warps.at(0)(template.points, template.sphere))
    first = both.at(0)(template.points, template.sphere)
    np.testing.assert_array_equal(first, model.warps.at(0)(template.points, template.sphere))


def test_levels_done_again_are_levels_of_further_shapes_too(monkeypatch):
    monkeypatch.setattr(hierarchy, "LONGEST", 0.0)
    family = warped_family(one_part_domain(), 5, np.random.default_rng(3), n_vertices=500)
    model = trained(family, replace(SETTINGS, levels=2, sweeps=2), count=4)["optimal"]
    assert len(model.frozen.levels) == 2 + hierarchy.REPEATS
    placed = place(family.samplers[4:], family.ids[4:], model.frozen)
    assert len(placed.warps.steps) == len(model.frozen.levels)
    fewer = replace(model.frozen, levels=model.frozen.levels[:2])
    assert (
        np.abs(place(family.samplers[4:], family.ids[4:], fewer).points - placed.points).max() > 0
    )


def test_shapes_are_placed_subject_by_subject_in_any_order(built):
    family, models = built
    frozen = models["optimal"].frozen
    order = [2, 0, 1]
    whole = place(family.samplers[:3], family.ids[:3], frozen)
    mixed = place([family.samplers[i] for i in order], [family.ids[i] for i in order], frozen)
    np.testing.assert_array_equal(mixed.points, whole.points[order])
    assert mixed.warps.ids == tuple(family.ids[index] for index in order)
