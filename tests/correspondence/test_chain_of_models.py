"""The three models on shapes whose true correspondence is known."""

from dataclasses import replace

import numpy as np
import pytest

from ostiform.correspondence import (
    CorrespondenceSettings,
    correspond,
    hierarchy,
    place,
)
from ostiform.correspondence.build import shared_metric_of_template
from ostiform.correspondence.hierarchy import REPEATS, sweep_batches
from ostiform.correspondence.terms.description_length import description_length
from ostiform.errors import InputError
from ostiform.surface import exact_orientations
from tests.oracles.warped_shapes import (
    one_part_domain,
    triangulated,
    two_part_domain,
    warped_family,
    with_level,
)

SETTINGS = CorrespondenceSettings(n_points=500, n_optimised=150, per="shape", sweeps=10)
FEW_SWEEPS = replace(SETTINGS, levels=3, sweeps=4)


def models(domain, settings=SETTINGS, order=slice(None), count=8):
    family = warped_family(domain, count, np.random.default_rng(5), n_vertices=800)
    template = with_level(triangulated(domain, 500), domain, 180)
    samplers, ids = family.samplers[order], family.ids[order]
    shared = shared_metric_of_template(samplers, ids, domain, template, settings)
    return family, shared, correspond(samplers, ids, shared, settings)


@pytest.fixture(scope="module", params=[one_part_domain, two_part_domain])
def built(request):
    return models(request.param())


def test_optimising_repairs_a_poor_start(built):
    family, shared, trained = built
    error = {
        kind: family.error(shared.template, model.correspondence.directions, shared.weights)
        for kind, model in trained.items()
    }
    assert error["optimal"] < 0.85 * error["conformal"]


def test_every_model_is_more_concise_than_the_one_before(built):
    _, shared, trained = built
    lengths = [
        description_length(trained[kind].correspondence.aligned, shared.weights, shared.l_cut)
        for kind in ("conformal", "euclidean", "optimal")
    ]
    assert lengths[2] < lengths[1]
    assert lengths[2] < lengths[0]


def test_every_warp_is_a_homeomorphism_of_the_template(built):
    _, shared, trained = built
    for model in trained.values():
        for directions in model.correspondence.directions:
            assert (exact_orientations(directions, shared.template.faces) > 0).all()


def test_the_objective_never_rises_within_a_level(built):
    _, _, trained = built
    records = [r for r in trained["optimal"].history if r.level > 1]
    assert len(records) > 2
    for before, after in zip(records, records[1:], strict=False):
        if before.level == after.level and after.sweep > 1:
            assert after.objective < before.objective * (1.0 + 1e-3)


def test_control_points_grow_fourfold_per_part_and_level(built):
    _, shared, trained = built
    interior = trained["optimal"].interior
    n_parts = len(shared.template.parts)
    for level in (2, 3):
        np.testing.assert_array_equal(
            np.bincount(interior.part[interior.level == level], minlength=n_parts),
            np.full(n_parts, 4 ** (level - 1)),
        )
    boundary = trained["optimal"].boundary
    assert (boundary.curve >= 0).all()


def test_the_same_input_gives_the_same_result():
    (_, _, first), (_, _, second) = (models(one_part_domain(), FEW_SWEEPS) for _ in range(2))
    np.testing.assert_array_equal(
        first["optimal"].correspondence.points, second["optimal"].correspondence.points
    )


def test_the_order_of_the_shapes_does_not_matter():
    family, shared, trained = models(one_part_domain(), FEW_SWEEPS)
    _, _, turned = models(one_part_domain(), FEW_SWEEPS, order=slice(None, None, -1))
    difference = np.linalg.norm(
        trained["optimal"].correspondence.points - turned["optimal"].correspondence.points[::-1],
        axis=2,
    ).mean()
    error = family.error(
        shared.template, trained["optimal"].correspondence.directions, shared.weights
    )
    assert difference < 0.02 * error


def test_the_papers_optimiser_shortens_the_description_too():
    settings = replace(SETTINGS, optimiser="conjugate-gradient", levels=2, sweeps=3)
    _, shared, trained = models(one_part_domain(), settings, count=5)
    lengths = {
        kind: description_length(model.correspondence.aligned, shared.weights, shared.l_cut)
        for kind, model in trained.items()
    }
    assert lengths["optimal"] < lengths["conformal"]


def test_a_left_out_shape_is_placed_without_folds(built):
    family, shared, trained = built
    for kind, model in trained.items():
        placed = place(family.samplers[:1], family.ids[:1], model.frozen)
        assert placed.points.shape == (1, len(shared.template.points), 3)
        assert (exact_orientations(placed.directions[0], shared.template.faces) > 0).all()
        if kind == "conformal":
            np.testing.assert_array_equal(placed.directions[0], shared.template.points)


def test_a_population_of_one_is_refused():
    domain = one_part_domain()
    family = warped_family(domain, 2, np.random.default_rng(5), n_vertices=800)
    template = with_level(triangulated(domain, 500), domain, 180)
    with pytest.raises(InputError, match="at least 2 shapes"):
        shared_metric_of_template(family.samplers[:1], family.ids[:1], domain, template, SETTINGS)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("optimiser", "guess"),
        ("levels", 0),
        ("noise_mm", 0.0),
        ("alignment", "affine"),
        ("tolerance", -1.0),
    ],
)
def test_settings_that_cannot_be_used_are_refused(name, value):
    with pytest.raises(InputError, match=f"{name.replace('_', ' ')}: expected"):
        CorrespondenceSettings(**{name: value})


def placed_well(settings, warp):
    """The three models of shapes whose maps are warped little, and their shared."""
    domain = one_part_domain()
    family = warped_family(
        domain, 6, np.random.default_rng(5), n_vertices=600, warp=warp, twist=warp
    )
    template = with_level(triangulated(domain, 300), domain, 160)
    shared = shared_metric_of_template(family.samplers, family.ids, domain, template, settings)
    return shared, correspond(family.samplers, family.ids, shared, settings)


def test_while_the_description_is_too_long_coherence_is_weakened(monkeypatch):
    monkeypatch.setattr(hierarchy, "LONGEST", 0.0)
    settings = replace(SETTINGS, levels=2, sweeps=2)
    _, trained = placed_well(settings, 0.0)
    optimal = trained["optimal"]
    assert len(optimal.frozen.levels) == 2 + REPEATS
    assert [record.level for record in optimal.history][-1] == 2 + REPEATS
    assert len(optimal.statuses) == len(optimal.frozen.levels)
    strengths = [level.forms["coherence"].scale for level in optimal.frozen.levels[1:]]
    assert (np.diff(strengths) < 0.0).all()


def test_a_shorter_description_needs_no_weaker_coherence():
    settings = replace(SETTINGS, levels=2, sweeps=2)
    _, trained = placed_well(settings, 0.2)
    assert trained["optimal"].coherence == settings.coherence


def test_small_batches_end_where_whole_sweeps_do():
    settings = replace(SETTINGS, levels=3)
    shared, whole = placed_well(settings, 0.1)
    _, batched = placed_well(replace(settings, batch=3), 0.1)
    lengths = [
        description_length(trained["optimal"].correspondence.aligned, shared.weights, shared.l_cut)
        for trained in (whole, batched)
    ]
    np.testing.assert_allclose(lengths[1], lengths[0], rtol=0.02)
    points = [trained["optimal"].correspondence.points for trained in (whole, batched)]
    apart = np.linalg.norm(points[0] - points[1], axis=2).mean()
    travelled = np.linalg.norm(points[0] - whole["conformal"].correspondence.points, axis=2).mean()
    assert 0.0 < apart < 0.4 * travelled


def test_the_batches_of_a_sweep_hold_every_shape_once():
    rng = np.random.default_rng(0)
    batches = sweep_batches(10, 4, rng)
    assert [len(batch) for batch in batches] == [4, 3, 3]
    assert sorted(index for batch in batches for index in batch) == list(range(10))
    assert sweep_batches(10, 4, rng) != batches
    assert sweep_batches(10, None, rng) == (tuple(range(10)),)


def test_after_a_poor_start_the_finest_level_is_done_once_more_with_new_control_points(monkeypatch):
    monkeypatch.setattr(hierarchy, "LONGEST", np.inf)
    monkeypatch.setattr(hierarchy, "POOR_START", np.inf)
    settings = replace(SETTINGS, levels=2, sweeps=2)
    _, trained = placed_well(settings, 0.2)
    optimal = trained["optimal"]
    assert len(optimal.frozen.levels) == len(optimal.statuses) == 3
    before, after = (level.basis for level in optimal.frozen.levels[-2:])
    assert len(before) == len(after)
    assert np.abs(before.table - after.table).max() > 0.0
    assert optimal.coherence == settings.coherence
