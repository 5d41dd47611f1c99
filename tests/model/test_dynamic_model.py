"""Who and when: the exact split of variation, the subjects' cycles, and new beating hearts."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ostiform.errors import InputError
from ostiform.model import (
    TrajectorySettings,
    beating_shape,
    between_share,
    cycle_shapes,
    fit_cycle_model,
    fit_dynamic_model,
    fit_model,
    fit_trajectories,
    fourier_design,
    interpolation_errors,
    mean_cycle,
    mesh_of_template,
    phase_prediction,
    phase_weights,
    project,
    random_cycles,
    reconstruct,
    resampled_cycle,
    subject_means,
    with_landmarks_aligned,
    within_shapes,
)
from ostiform.study import ShapeId
from tests.compare import assert_same_modes
from tests.populations import population, two_part_template

ROUNDING = 1e-9  # relative: products of a few hundred numbers


def fitted(shapes, settings=None):
    return fit_dynamic_model(
        shapes.aligned, shapes.ids, shapes.weights, mesh_of_template(shapes.template), settings
    )


def covariance(model):
    root = (model.modes * np.sqrt(model.variances)[:, None, None]).reshape(
        len(model.modes), model.mean.size
    )
    return root.T @ root


def unbalanced(seed=3):
    """Return a population in which subjects have 6, 4, 2 and 1 phases at uneven times."""
    shapes = population(4, 6, np.random.default_rng(seed), two_part_template(5, 8))
    kept = np.array([0, 1, 2, 3, 4, 5, 6, 8, 9, 11, 12, 15, 20])
    rng = np.random.default_rng(seed)
    ids = [shapes.ids[i] for i in kept]
    return replace(
        shapes,
        ids=tuple(replace(id, time=(id.time + 0.1 * rng.uniform()) % 1.0) for id in ids),
        **{
            name: getattr(shapes, name)[kept]
            for name in ("directions", "points", "aligned", "transforms")
        },
    )


def test_weights_are_half_the_way_to_the_neighbours_on_the_closed_cycle():
    ids = [ShapeId("a", "1", 0.0), ShapeId("b", "1", 0.3), ShapeId("a", "2", 0.5)]
    ids.append(ShapeId("a", "3", 0.7))
    # a: gaps 0.5, 0.2, 0.3 -> shares 0.4, 0.35, 0.25, each half; b: one phase, the other half.
    np.testing.assert_allclose(phase_weights(ids), [0.2, 0.5, 0.175, 0.125])


@given(st.lists(st.lists(st.floats(0.0, 0.999), min_size=1, max_size=9), min_size=1, max_size=5))
def test_every_subject_weighs_the_same_whatever_its_phases(times):
    ids = [ShapeId(f"{s}", f"{f}", t) for s, own in enumerate(times) for f, t in enumerate(own)]
    weights = phase_weights(ids)
    for s in range(len(times)):
        total = sum(w for w, id in zip(weights, ids, strict=True) if id.subject == str(s))
        np.testing.assert_allclose(total, 1.0 / len(times))


@pytest.mark.parametrize("make", [unbalanced, lambda: population(3, 4, np.random.default_rng(1))])
def test_between_and_within_are_exactly_the_total_as_matrices(make):
    shapes = make()
    model = fitted(shapes)
    share = phase_weights(shapes.ids)
    flat = shapes.aligned.reshape(len(share), -1)
    direct = (flat - share @ flat).T @ ((flat - share @ flat) * share[:, None])
    total = covariance(model.total)
    scale = np.abs(total).max()
    np.testing.assert_allclose(total, direct, atol=ROUNDING * scale)
    np.testing.assert_allclose(
        covariance(model.between) + covariance(model.within), total, atol=ROUNDING * scale
    )
    np.testing.assert_allclose(
        covariance(model.common) + covariance(model.departure),
        covariance(model.within),
        atol=ROUNDING * scale,
    )


def test_between_is_the_covariance_of_the_subjects_mean_shapes():
    shapes = unbalanced()
    model = fitted(shapes)
    means = subject_means(model).reshape(4, -1)
    deviations = means - means.mean(axis=0)
    np.testing.assert_allclose(
        covariance(model.between), deviations.T @ deviations / 4.0, atol=1e-9 * means.max()
    )
    share = phase_weights(shapes.ids) * 4.0
    first = np.array([id.subject == "subject 0" for id in shapes.ids])
    np.testing.assert_allclose(
        means[0].reshape(-1, 3), np.tensordot(share[first], shapes.aligned[first], axes=1)
    )


def test_with_equal_even_phases_the_total_is_the_pooled_analysis():
    shapes = population(4, 6, np.random.default_rng(2))
    model = fitted(shapes).total
    pooled = fit_model(shapes.aligned, shapes.weights, mesh_of_template(shapes.template))
    count = len(shapes.ids)
    np.testing.assert_allclose(
        model.variances, pooled.variances * (count - 1) / count, rtol=ROUNDING
    )
    np.testing.assert_allclose(model.mean, pooled.mean, atol=ROUNDING)
    assert_same_modes(model.modes, pooled.modes, pooled.variances, pooled.weights)


def test_with_equal_even_phases_the_common_motion_is_the_mean_over_subjects():
    shapes = population(4, 6, np.random.default_rng(2))
    model = fitted(shapes)
    moved = within_shapes(model).reshape(4, 6, -1)
    common = moved.mean(axis=0) - model.total.mean.ravel()  # (6, 3P)
    np.testing.assert_allclose(
        covariance(model.common), common.T @ common / 6.0, atol=ROUNDING * common.max()
    )


def test_a_single_subject_has_motion_only():
    model = fitted(population(1, 8, np.random.default_rng(4)))
    assert len(model.between.modes) == 0
    np.testing.assert_allclose(model.within.total_variance, model.total.total_variance)
    assert between_share(model).value == pytest.approx(0.0, abs=1e-12)
    assert between_share(model).low is None


def test_without_motion_everything_is_between_subjects():
    shapes = population(5, 1, np.random.default_rng(4))
    model = fitted(shapes)
    assert len(model.within.modes) == 0
    share = between_share(model)
    np.testing.assert_allclose([share.value, share.low, share.high], 1.0)
    assert model.trajectories.harmonics == 0
    with pytest.raises(InputError, match="at least 2 phases"):
        phase_prediction(model)


def test_the_corrected_variance_between_subjects_is_unbiased():
    """Subjects that do not differ: all of `between` is what averaging few noisy phases leaves."""
    rng = np.random.default_rng(6)
    template = two_part_template(5, 8)
    shapes = population(20, 4, rng, template)
    noise = rng.normal(size=shapes.aligned.shape)
    model = fitted(replace(shapes, aligned=40.0 * template.points + noise), FEW)
    assert model.effective_phases == pytest.approx(4.0)
    net = model.between_corrected.total_variance - model.clipped_variance
    trace = model.between.total_variance - model.within.total_variance / 4.0
    np.testing.assert_allclose(net, trace, rtol=1e-8)
    # Of 20 subjects the means vary by 3 (19 / 20) / 4 and the phases about them by 3 (3 / 4);
    # the standard error of the first is about 3 % over 40 points x 3 coordinates.
    np.testing.assert_allclose(model.between.total_variance, 3.0 * 19.0 / 80.0, rtol=0.1)
    assert model.between_corrected.total_variance < model.between.total_variance


FEW = TrajectorySettings(harmonics=(1,), smoothness=(1e-3,), stiffness=(1.0,))


def test_the_share_between_subjects_and_its_interval_are_in_the_unit_range():
    share = between_share(fitted(population(5, 4, np.random.default_rng(8))))
    assert 0.0 <= share.low <= share.value <= share.high <= 1.0


def test_the_interval_of_the_share_narrows_with_more_subjects():
    widths = [
        share.high - share.low
        for share in (
            between_share(
                fitted(population(n, 3, np.random.default_rng(8), two_part_template(5, 8)), FEW)
            )
            for n in (4, 25)
        )
    ]
    assert widths[1] < 0.5 * widths[0]


def band_limited(times, subjects=3, width=5, harmonics=2, seed=0):
    """Return positions on random closed curves of two harmonics, one list of times per subject."""
    rng = np.random.default_rng(seed)
    curves = rng.normal(size=(subjects, 2 * harmonics + 1, width))
    labels = [f"s{s}" for s in range(subjects) for _ in times[s]]
    moments = np.concatenate([np.asarray(own) for own in times])
    values = np.concatenate(
        [fourier_design(np.asarray(own), harmonics) @ curves[s] for s, own in enumerate(times)]
    )
    return values, labels, moments, curves


def test_curves_of_few_harmonics_are_found_from_uneven_phases(rng):
    times = [np.sort(rng.uniform(size=n)) for n in (9, 12, 15)]
    values, labels, moments, curves = band_limited(times)
    soft = TrajectorySettings(harmonics=(1, 2, 3), smoothness=(1e-12,), stiffness=(1.0,))
    found = fit_trajectories(values, labels, moments, soft)
    instants = np.linspace(0.0, 1.0, 50)
    for s in range(3):
        np.testing.assert_allclose(
            fourier_design(instants, found.harmonics) @ found.coefficients[s],
            fourier_design(instants, 2) @ curves[s],
            atol=1e-6,
        )


def test_curves_are_closed():
    shapes = population(3, 5, np.random.default_rng(1))
    model = fitted(shapes)
    start, end = resampled_cycle(model, "subject 1", np.array([0.0, 1.0]))
    np.testing.assert_allclose(start, end, atol=1e-9)


def dense_penalised_fit(values, labels, moments, choice):
    """Solve the stated objective as one dense system; return its matrix from data to fit."""
    harmonics, smoothness, stiffness = int(choice[0]), choice[1], choice[2]
    names = list(dict.fromkeys(labels))
    waves = fourier_design(moments, harmonics)[:, 1:]
    member = np.array([[label == name for name in names] for label in labels], dtype=float)
    own = np.einsum("ns,nh->nsh", member, waves).reshape(len(labels), -1)
    design = np.concatenate([member, waves, own], axis=1)
    powers = np.repeat(np.arange(1.0, harmonics + 1), 2) ** choice[3]
    common = len(labels) / len(names) * smoothness * powers
    penalty = np.concatenate(
        [np.zeros(len(names)), common, np.tile(stiffness * common, len(names))]
    )
    return design, penalty


@pytest.mark.parametrize("power", [4, 2])
def test_the_joint_fit_and_its_left_out_errors_equal_the_dense_solution(rng, power):
    times = [np.sort(rng.uniform(size=n)) for n in (7, 4, 3)]
    values, labels, moments, _ = band_limited(times)
    values = values + 0.1 * rng.normal(size=values.shape)
    choice = (3, 1e-2, 10.0, power)
    one = TrajectorySettings((3,), (1e-2,), (10.0,), (power,))
    found = fit_trajectories(values, labels, moments, one)
    assert {tuple(row) for row in found.choices} == {choice}
    design, penalty = dense_penalised_fit(values, labels, moments, choice)
    solution = np.linalg.solve(design.T @ design + np.diag(penalty), design.T @ values)
    curve = np.concatenate([solution[:1], solution[3:9] + solution[9:15]])
    np.testing.assert_allclose(found.coefficients[0], curve, atol=1e-9)
    errors = []
    for index in range(len(labels)):
        rest = np.arange(len(labels)) != index
        part = design[rest]
        again = np.linalg.solve(part.T @ part + np.diag(penalty), part.T @ values[rest])
        errors.append(np.linalg.norm(values[index] - design[index] @ again))
    np.testing.assert_allclose(found.left_out_errors, errors, rtol=1e-7)


def test_a_subject_with_one_phase_borrows_the_common_motion():
    times = [np.arange(10) / 10, np.arange(10) / 10, np.array([0.2])]
    values, labels, moments, curves = band_limited(times)
    shared = curves[0].copy()
    for s, own in enumerate(times):
        chosen = np.array(labels) == f"s{s}"
        values[chosen] = fourier_design(own, 2) @ shared + 3.0 * s
    found = fit_trajectories(values, labels, moments)
    predicted = fourier_design(np.array([0.7]), found.harmonics) @ found.coefficients[2]
    expected = fourier_design(np.array([0.7]), 2) @ shared + 6.0
    np.testing.assert_allclose(predicted, expected, atol=0.1)  # of a motion of several units
    assert np.isnan(found.left_out_errors[-1])


def test_straight_lines_between_neighbours_are_the_baseline():
    values = np.array([[0.0], [1.0], [5.0], [2.0]])
    times = np.array([0.0, 0.25, 0.5, 0.75])
    found = interpolation_errors(values, ["a"] * 4, times)
    np.testing.assert_allclose(found, [1.5, 1.5, 3.5, 0.5])
    assert np.isnan(interpolation_errors(values[:1], ["a"], times[:1])[0])


def test_trajectories_predict_left_out_phases_better_than_straight_lines():
    model = fitted(population(4, 8, np.random.default_rng(9)))
    found = phase_prediction(model)
    assert found.phases == 32
    assert found.trajectory < found.interpolation


def test_left_out_errors_are_millimetres_of_the_points():
    shapes = population(2, 6, np.random.default_rng(9))
    one = TrajectorySettings(harmonics=(2,), smoothness=(1e-3,), stiffness=(10.0,))
    small, large = (
        phase_prediction(fitted(replace(shapes, aligned=scale * shapes.aligned), one))
        for scale in (1.0, 3.0)
    )
    np.testing.assert_allclose(large.trajectory, 3.0 * small.trajectory, rtol=1e-8)
    np.testing.assert_allclose(large.interpolation, 3.0 * small.interpolation, rtol=1e-8)


def test_the_mean_cycle_is_the_mean_of_the_subjects_cycles():
    model = fitted(population(3, 5, np.random.default_rng(1)))
    times = np.linspace(0.0, 1.0, 7)
    each = [resampled_cycle(model, name, times) for name in model.subjects]
    np.testing.assert_allclose(mean_cycle(model, times), np.mean(each, axis=0), atol=1e-9)


def test_a_heart_with_no_scores_beats_as_the_mean():
    model = fitted(population(3, 6, np.random.default_rng(1)))
    times = np.linspace(0.0, 1.0, 5)
    np.testing.assert_allclose(
        beating_shape(model, np.zeros(2), times), mean_cycle(model, times), atol=0.05
    )


def test_a_heart_with_chosen_scores_has_them_on_average_over_its_cycle():
    model = fitted(population(4, 6, np.random.default_rng(1)))
    scores = np.sqrt(model.between.variances) * [2.0, -1.0, 0.5]
    times = np.arange(64) / 64
    average = beating_shape(model, scores, times).mean(axis=0)
    np.testing.assert_allclose(average, reconstruct(model.between, scores), atol=1e-9)


def test_the_modes_of_cycles_reproduce_every_subject_s_cycle():
    model = fitted(population(4, 6, np.random.default_rng(5)))
    cycles = fit_cycle_model(model)
    times = np.arange(40) / 40
    curves = np.stack([resampled_cycle(model, name, times) for name in model.subjects])
    centre = cycle_shapes(cycles, np.empty(0), times)
    np.testing.assert_allclose(centre, curves.mean(axis=0), atol=1e-9)
    # Over the cycle the mean product of two shapes is the product of their coefficients.
    modes = cycle_shapes(cycles, np.eye(len(cycles.modes)), times) - centre
    scores = np.einsum("stpi,mtpi,p->sm", curves - centre, modes, model.total.weights) / len(times)
    np.testing.assert_allclose(cycle_shapes(cycles, scores, times), curves, atol=1e-8)
    np.testing.assert_allclose(
        np.cov(scores.T), np.diag(cycles.variances), atol=1e-8 * cycles.variances[0]
    )


def test_random_hearts_vary_as_the_subjects_do():
    cycles = fit_cycle_model(fitted(population(4, 5, np.random.default_rng(5))))
    times = np.arange(8) / 8
    hearts = random_cycles(cycles, 400, times, np.random.default_rng(0), limit=np.inf)
    deviations = project(cycles.basis, hearts) - project(
        cycles.basis, cycle_shapes(cycles, np.empty(0), times)
    )
    variance = (deviations**2).sum(axis=2).mean()
    np.testing.assert_allclose(variance, cycles.variances.sum(), rtol=0.25)  # 400 draws, 3 modes
    again = random_cycles(cycles, 400, times, np.random.default_rng(0), limit=np.inf)
    np.testing.assert_array_equal(hearts, again)


def test_landmarks_in_time_are_brought_together():
    ids = [ShapeId("a", "1", 0.0), ShapeId("a", "2", 0.3), ShapeId("b", "1", 0.2)]
    ids += [ShapeId("b", "2", 0.5), ShapeId("b", "3", 0.75)]
    warped = with_landmarks_aligned(ids, {"a": [0.3], "b": [0.5]})
    np.testing.assert_allclose([id.time for id in warped], [0.0, 0.4, 0.16, 0.4, 0.7])
    assert [id.phase for id in warped] == [id.phase for id in ids]


@pytest.mark.parametrize(
    ("landmarks", "message"),
    [
        ({"a": [0.3]}, "found none"),
        ({"a": [0.3], "b": [0.2, 0.4]}, "as many as"),
        ({"a": [0.4, 0.3], "b": [0.2, 0.4]}, "increasing"),
        ({"a": [0.0], "b": [0.5]}, "increasing"),
        ({"a": [0.5], "b": [1.0]}, "increasing"),
    ],
)
def test_wrong_landmarks_in_time_are_refused(landmarks, message):
    ids = [ShapeId("a", "1", 0.0), ShapeId("b", "1", 0.2)]
    with pytest.raises(InputError, match=message):
        with_landmarks_aligned(ids, landmarks)


@pytest.mark.parametrize(
    "changes",
    [{"smoothness": (0.0,)}, {"stiffness": (-1.0,)}, {"harmonics": (-1,)}, {"powers": (0,)}],
)
def test_settings_that_are_not_positive_are_refused(changes):
    with pytest.raises(InputError, match="expected positive"):
        TrajectorySettings(**changes)


def test_settings_without_candidates_are_refused():
    with pytest.raises(InputError, match="at least one"):
        TrajectorySettings(smoothness=())


def test_dynamic_operations_refuse():
    one = population(1, 5, np.random.default_rng(1))
    model = fitted(one)
    with pytest.raises(InputError, match="found nobody"):
        resampled_cycle(model, "nobody", np.zeros(1))
    with pytest.raises(InputError, match="at least 2 subjects"):
        fit_cycle_model(model)
    with pytest.raises(InputError, match="at least 2 shapes"):
        fitted(population(1, 1, np.random.default_rng(1)))
    cycles = fit_cycle_model(fitted(population(2, 4, np.random.default_rng(1))))
    with pytest.raises(InputError, match="scores of a cycle"):
        cycle_shapes(cycles, np.zeros(9), np.zeros(1))


@settings(max_examples=5)
@given(st.integers(0, 100))
def test_shifting_the_start_of_the_cycle_shifts_the_trajectories(shift):
    shapes = population(2, 5, np.random.default_rng(3), two_part_template(5, 8))
    moved = replace(
        shapes, ids=tuple(replace(id, time=(id.time + shift / 100) % 1.0) for id in shapes.ids)
    )
    one = TrajectorySettings(harmonics=(2,), smoothness=(1e-3,), stiffness=(10.0,))
    times = np.array([0.1, 0.6])
    np.testing.assert_allclose(
        resampled_cycle(fitted(moved, one), "subject 1", times + shift / 100),
        resampled_cycle(fitted(shapes, one), "subject 1", times),
        atol=1e-8,
    )
