"""Names that shapes were given, against what the geometry of the population says."""

from dataclasses import replace

import numpy as np
import pytest

from ostiform.study import named_population, parsed_settings
from ostiform.study.shape_names import MIRRORED
from tests.study.test_population import (
    POINTS,
    STUDY,
    atrium,
    rotations,
    survey,
    true_names,
)

SWAPPED = {"RSPV": "RIPV", "RIPV": "RSPV"}
MIRROR = np.diag([-1.0, 1.0, 1.0])


def pointed(item, names):
    """The survey with points of its own at its loops, as a Markups file gives them."""
    loops = item.parts["LA"].loops
    return replace(item, points={f"LA.{name}": loops[k].center for name, k in names.items()})


def capped(item, names):
    part = replace(item.parts["LA"], known=names)
    return replace(item, parts={"LA": part})


def swapped(names):
    return {SWAPPED.get(name, name): k for name, k in names.items()}


def population(give, wrong=("3",), count=6):
    """Turned atria of which some have the names of two veins swapped."""
    surveys, truth = [], {}
    for k, turn in enumerate(rotations(count)):
        own = atrium(k)
        names = true_names(own)
        item = survey(str(k), own, turn)
        surveys.append(give(item, swapped(names) if str(k) in wrong else names))
        truth[item.id] = names
    return surveys, truth


def settings(trust=None, text=STUDY):
    return parsed_settings(text if trust is None else f'{text}[ostia]\ntrust = "{trust}"\n')


@pytest.mark.parametrize("give", [pointed, capped])
def test_names_that_contradict_the_others_are_left_to_the_study(give):
    surveys, truth = population(give)
    found = named_population(settings(), surveys)
    assert set(found.problems) == {surveys[3].id}
    said = found.problems[surveys[3].id]
    own = truth[surveys[3].id]
    for name in SWAPPED:
        assert f"LA.{name} = loop {swapped(own)[name] + 1}" in said.split("by geometry")[0]
        assert f"LA.{name} = loop {own[name] + 1}" in said.split("by geometry")[1]
    given, seen = (float(piece.split(" mm")[0]) for piece in said.split("misfit ")[1:])
    assert 0.0 < 1.5 * seen < given
    assert 'ostia.trust = "names" or "geometry"' in said


@pytest.mark.parametrize("give", [pointed, capped])
def test_a_study_that_trusts_geometry_renames(give):
    surveys, truth = population(give)
    found = named_population(settings("geometry"), surveys)
    assert found.problems == {}
    for item in surveys:
        assert dict(found.names[item.id].names["LA"]) == truth[item.id]
    assert "named by geometry" in found.names[surveys[3].id].notes[-1]
    assert all(found.names[item.id].notes == () for item in surveys if item is not surveys[3])


def test_a_study_that_trusts_names_keeps_and_tells_them():
    surveys, truth = population(pointed)
    found = named_population(settings("names"), surveys)
    kept = found.names[surveys[3].id]
    assert dict(kept.names["LA"]) == swapped(truth[surveys[3].id])
    assert "kept as given" in kept.notes[-1]
    assert "misfit" in kept.notes[-1]


def test_the_first_shape_may_be_the_wrong_one():
    surveys, _ = population(pointed, wrong=("0",))
    assert set(named_population(settings(), surveys).problems) == {surveys[0].id}


def test_two_shapes_that_contradict_each_other_are_both_told():
    surveys, _ = population(pointed, wrong=("0",), count=2)
    assert set(named_population(settings(), surveys).problems) == {s.id for s in surveys}


def test_names_of_one_shape_are_compared_with_the_points_of_the_population():
    atria = [atrium(seed) for seed in range(5)]
    surveys = [survey(str(k), own) for k, own in enumerate(atria)]
    surveys[1] = pointed(surveys[1], swapped(true_names(atria[1])))
    found = named_population(settings(text=POINTS), surveys)
    assert set(found.problems) == {surveys[1].id}
    for item, own in zip(surveys, atria, strict=True):
        if item is not surveys[1]:
            assert dict(found.names[item.id].names["LA"]) == true_names(own)


def mirrored(seed):
    """A mirrored atrium with points of its own, which name its openings rightly."""
    own = atrium(seed)
    loops = survey("x", own).parts["LA"].loops
    points = {f"LA.{name}": MIRROR @ loops[k].center for name, k in true_names(own).items()}
    return replace(survey("m", own, MIRROR), points=points)


def told_mirrored(found):
    return {shape.subject for shape, named in found.names.items() if MIRRORED in named.notes}


def test_a_mirrored_shape_with_names_of_its_own_is_told():
    surveys, _ = population(pointed, wrong=())
    found = named_population(settings(), [*surveys, mirrored(9)])
    assert found.problems == {}
    assert told_mirrored(found) == {"m"}


def test_a_mirrored_shape_that_names_the_others_is_the_one_that_is_told():
    surveys, truth = population(lambda item, names: item, count=4)
    found = named_population(settings(), [mirrored(4), *surveys])
    assert told_mirrored(found) == {"m"}
    for item in surveys:
        assert dict(found.names[item.id].names["LA"]) == truth[item.id]


@pytest.mark.parametrize("seed", range(1, 9))
def test_a_mirrored_shape_among_turned_ones_that_differ_much_is_never_silent(seed):
    rng = np.random.default_rng(seed)

    def stretched(k):
        vertices, faces, holes = atrium(k)
        factors = rng.uniform(0.75, 1.3, 3)
        return vertices * factors, faces, holes

    sound = [stretched(k) for k in range(20, 24)]
    surveys = [survey(str(k), own) for k, own in enumerate(sound[:1])]
    surveys = [pointed(surveys[0], true_names(sound[0]))]
    surveys += [survey(str(k), own, rotations(9)[k]) for k, own in enumerate(sound[1:], start=1)]
    surveys.append(survey("m", stretched(24), rotations(9)[7] @ MIRROR))
    found = named_population(settings(), surveys)
    told = found.problems.get(surveys[-1].id) or " ".join(found.names[surveys[-1].id].notes)
    assert "mirror image" in told or "two ways to name them" in told
    for item in surveys[:-1]:
        assert not any("mirror" in note for note in found.names[item.id].notes)
