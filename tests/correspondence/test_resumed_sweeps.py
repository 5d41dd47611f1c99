"""A run taken up again at any sweep ends as the run without interruption did, bit for bit."""

from dataclasses import replace

import numpy as np
import pytest

from ostiform.correspondence import CorrespondenceSettings, correspond
from ostiform.correspondence.build import shared_metric_of_template
from ostiform.errors import InputError
from tests.oracles.warped_shapes import one_part_domain, triangulated, warped_family, with_level


@pytest.fixture(scope="module", params=["majorise", "batches", "conjugate-gradient"])
def run(request):
    """Return a function that goes on from checkpoints, and every one of the whole run."""
    domain = one_part_domain()
    family = warped_family(domain, 4, np.random.default_rng(3), n_vertices=400)
    template = with_level(triangulated(domain, 200), domain, 90)
    settings = CorrespondenceSettings(
        optimiser="majorise" if request.param == "batches" else request.param,
        batch=2 if request.param == "batches" else None,
        levels=3,
        n_points=200,
        n_optimised=80,
        sweeps=3,
        seed=5,
    )
    shared = shared_metric_of_template(family.samplers, family.ids, domain, template, settings)

    def go_on(resumed, save=None):
        return correspond(family.samplers, family.ids, shared, settings, resumed=resumed, save=save)

    states = []
    return go_on, go_on((), states.append), states


def known_after(states, count):
    """Return what is known after so many sweeps: the last state of every level."""
    return tuple({state.level: state for state in states[:count]}.values())


def test_every_sweep_is_saved_and_the_last_of_each_level_has_a_status(run):
    _, trained, states = run
    swept = [record for record in trained["optimal"].history if record.sweep > 0]
    assert [state.records[-1] for state in states] == swept
    ends = [state.status for state in known_after(states, len(states))]
    assert tuple(ends) == trained["optimal"].statuses
    # Three levels and, as the start is poor, the finest once more.
    assert sum(state.status is not None for state in states) == 4


def test_a_run_goes_on_from_every_sweep_to_the_same_result(run):
    go_on, trained, states = run
    for count in range(1, len(states) + 1):
        resumed = go_on(known_after(states, count))
        for kind, expected in trained.items():
            found = resumed[kind].correspondence
            np.testing.assert_array_equal(found.points, expected.correspondence.points)
            np.testing.assert_array_equal(found.aligned, expected.correspondence.aligned)
            np.testing.assert_array_equal(found.directions, expected.correspondence.directions)
            for own, other in zip(resumed[kind].warps.steps, expected.warps.steps, strict=True):
                np.testing.assert_array_equal(own.coefficients, other.coefficients)
        objectives = [record.objective for record in resumed["optimal"].history]
        assert objectives == [record.objective for record in trained["optimal"].history]
        assert resumed["optimal"].statuses == trained["optimal"].statuses


def test_a_run_that_goes_on_saves_only_what_is_new(run):
    go_on, _, states = run
    kept = []
    go_on(known_after(states, 2), kept.append)
    assert len(kept) == len(states) - 2


def test_levels_of_another_run_are_refused(run):
    go_on, _, states = run
    first = known_after(states, len(states))[0]
    fewer = replace(first.population, states=first.population.states[:-1])
    for wrong in (
        (replace(first, population=fewer),),
        (replace(first, level=2),),
        (replace(first, status=None), known_after(states, len(states))[1]),
    ):
        with pytest.raises(InputError, match="begin afresh"):
            go_on(wrong)
