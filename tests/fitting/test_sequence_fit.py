"""A beating model fitted to all phases at once: truth found, shifts found, intervals that hold."""

import numpy as np
import pytest

from ostiform.errors import InputError
from ostiform.fitting import (
    PhaseTarget,
    SequenceSettings,
    SliceContours,
    SurfaceTarget,
    cycle_at,
    fit_sequence,
    sequence_prior,
)
from ostiform.model import StoredModel
from tests.fitting.fitting_cases import rms
from tests.fitting.sequence_cases import drawn_cycle, sliced_phases

TIMES = np.array([0.0, 0.15, 0.3, 0.5, 0.7, 0.85])


@pytest.fixture(scope="module")
def beating(stored):
    return sequence_prior(stored)


@pytest.fixture(scope="module")
def case(beating):
    """A cycle of the prior, its phases in shifted slices, the shifts, and the fit."""
    rng = np.random.default_rng(5)
    truth = drawn_cycle(beating, rng, TIMES)
    phases, shifts = sliced_phases(beating, truth, TIMES, rng)
    return truth, phases, shifts, fit_sequence(beating, phases)


def errors(points, truth):
    """RMS errors by phase; where the heart lies is not known better than all slices' mean shift."""
    offset = (points - truth).mean(axis=(0, 1))
    return np.array([rms(p - offset, own) for p, own in zip(points, truth, strict=True)])


def test_all_phases_and_all_shifts_are_found(case):
    truth, _, shifts, fit = case
    assert errors(fit.points, truth).max() < 1.5
    stack = [found for found in fit.shifts if found.slice.startswith("sa")]
    apart = np.stack([found.shift - shifts[found.slice] for found in stack])
    assert np.sqrt(((apart - apart.mean(axis=0)) ** 2).mean()) < 0.3
    assert fit.notes == ()


def test_shifts_that_are_not_solved_for_cost_accuracy(case, beating):
    truth, phases, _, fit = case
    plain = fit_sequence(beating, phases, SequenceSettings(shift_sd_mm=0.0))
    assert plain.shifts == ()
    assert errors(fit.points, truth).mean() < 0.8 * errors(plain.points, truth).mean()


def test_a_phase_without_data_is_predicted_from_the_others(case, beating):
    truth, phases, _, _ = case
    fit = fit_sequence(beating, [phase for phase in phases if phase.name != "02"])
    predicted = cycle_at(beating, fit, TIMES)
    still = np.repeat(truth.mean(axis=0)[None], len(TIMES), axis=0)
    assert errors(predicted, truth)[2] < 0.9 * errors(still, truth)[2]


def test_whole_surfaces_in_every_phase_are_met(beating):
    rng = np.random.default_rng(6)
    truth = drawn_cycle(beating, rng, TIMES[:3])
    faces = beating.space.model.mesh.faces
    moved = truth + [100.0, -50.0, 20.0]
    phases = [
        PhaseTarget(float(t), (SurfaceTarget(points, faces, {}),), f"{k}")
        for k, (t, points) in enumerate(zip(TIMES, moved, strict=False))
    ]
    fit = fit_sequence(beating, phases)
    assert max(found.mean for found in fit.residues.values()) < 0.3
    assert fit.shifts == ()


def test_two_phases_at_one_time_are_refused(case, beating):
    _, phases, _, _ = case
    twice = [phases[0], PhaseTarget(1.0, phases[1].targets, "again")]
    with pytest.raises(InputError, match="phases 00 and again: expected different times"):
        fit_sequence(beating, twice)


def test_a_model_of_single_phases_has_no_cycle(stored):
    first = [k for k, id in enumerate(stored.ids) if id.time == 0.0]
    ids = tuple(stored.ids[k] for k in first)
    single = StoredModel(stored.model, stored.scores[first], ids, stored.template)
    with pytest.raises(InputError, match="several phases, found one phase per subject"):
        sequence_prior(single)


def test_a_slice_that_is_not_of_this_heart_is_told(case, beating):
    _, phases, _, _ = case
    wrong = [
        PhaseTarget(
            phase.time,
            tuple(
                SliceContours(item.slice, tuple(0.5 * c + [0.0, 0.0, 4.0] for c in item.curves))
                if item.slice == "sa 5"
                else item
                for item in phase.targets
            ),
            phase.name,
        )
        for phase in phases
    ]
    notes = " ".join(fit_sequence(beating, wrong).notes)
    assert "slice sa 5: its curves stay" in notes


def test_phases_of_two_hearts_are_told(case, beating):
    rng = np.random.default_rng(17)
    _, phases, _, _ = case
    other = 1.25 * drawn_cycle(beating, rng, TIMES) + [0.0, 12.0, 0.0]
    foreign, _ = sliced_phases(beating, other, TIMES, rng)
    notes = " ".join(fit_sequence(beating, [*phases[:3], *foreign[3:]]).notes)
    assert "all phases are of one patient" in notes
