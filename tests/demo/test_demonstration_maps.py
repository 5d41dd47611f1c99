"""The maps of space behind generated populations: inverses, derivatives, orientation."""

import numpy as np
import pytest

from ostiform.demo.deformation import Deformation
from ostiform.demo.demonstration import demonstration_truth
from ostiform.demo.implicit import Anatomy, Cut, Ellipsoid, Tube
from ostiform.demo.inversion import newton_inverse, solve3
from ostiform.demo.leftheart import left_heart
from ostiform.demo.relaxation import project_to_curves, project_to_surface
from ostiform.demo.spacemaps import Affine, Axial, Bumps, TubeWarp
from ostiform.errors import ConvergenceError, InputError

INVERSE_MM = 1e-9
"""The accuracy promised for inverses; measured 3e-13."""
TAYLOR_SLOPE = 1.9
"""The remainder of a first-order expansion falls with the square of the step; splines are C2."""


def _box(rng, n=2000):
    low, high = left_heart().bounds()
    return rng.uniform(low - 10.0, high + 10.0, size=(n, 3))


def _maps():
    knots = np.linspace(-90.0, 60.0, 6)
    return {
        "affine": Affine(
            np.array([[1.1, 0.2, 0.0], [-0.1, 0.9, 0.1], [0, 0.3, 1.0]]), np.arange(3.0)
        ),
        "axial": Axial(
            np.array([1.0, -2.0]),
            knots,
            np.column_stack([np.sin(knots), np.cos(knots), 8.0 * np.sin(knots / 30.0)]),
            0.2 * np.column_stack([np.sin(knots / 20.0), np.cos(knots / 20.0)]),
            0.3 * np.sin(knots / 40.0),
        ),
        "tube": TubeWarp(
            np.array([10.0, 5.0, 0.0]),
            np.array([0.6, 0.0, 0.8]),
            14.0,
            9.0,
            24.0,
            np.array([8.0, 3.0, 4.0]),
            0.1,
        ),
        "bumps": Bumps(
            np.array([[0.0, 0.0, 0.0], [10.0, 10.0, -20.0]]),
            np.array([25.0, 32.0]),
            np.array([[3.0, -2.0, 1.0], [0.0, 3.0, 3.0]]),
        ),
    }


@pytest.mark.parametrize("kind", list(_maps()))
def test_a_map_and_its_inverse_undo_each_other(kind, rng):
    step = _maps()[kind]
    points = _box(rng)
    np.testing.assert_allclose(step.inverse(step.forward(points)), points, atol=INVERSE_MM)
    np.testing.assert_allclose(step.forward(step.inverse(points)), points, atol=INVERSE_MM)


@pytest.mark.parametrize("kind", list(_maps()))
def test_the_remainder_after_the_jacobian_is_of_second_order(kind, rng):
    step = _maps()[kind]
    points, direction = _box(rng), rng.normal(size=3)
    steps = np.array([1e-1, 1e-2, 1e-3])
    first = step.linearised(points)[1] @ direction
    remainders = np.array(
        [
            np.abs(step.forward(points + h * direction) - step.forward(points) - h * first).mean()
            for h in steps
        ]
    )
    if kind == "affine":
        assert remainders.max() < 1e-12
        return
    slopes = np.diff(np.log(remainders)) / np.diff(np.log(steps))
    assert slopes.min() > TAYLOR_SLOPE


def test_every_shape_of_the_demonstration_is_a_diffeomorphic_image(rng):
    truth = demonstration_truth()
    points = _box(rng)
    for deformation in truth.deformations.values():
        assert np.linalg.det(deformation.linearised(points)[1]).min() > 0.1
        back = deformation.inverse(deformation.forward(points))
        np.testing.assert_allclose(back, points, atol=INVERSE_MM)


def test_subjects_drawn_from_many_seeds_stay_diffeomorphic(rng):
    points = _box(rng, 4000)
    worst = [
        np.linalg.det(deformation.linearised(points)[1]).min()
        for seed in range(12)
        for deformation in demonstration_truth(5, 10, seed).deformations.values()
    ]
    assert min(worst) > 0.0


def test_a_composition_multiplies_jacobians_and_applies_the_first_map_first(rng):
    one, two = _maps()["affine"], _maps()["axial"]
    points = _box(rng, 20)
    both = Deformation((one, two))
    np.testing.assert_allclose(both.forward(points), two.forward(one.forward(points)))
    np.testing.assert_allclose(
        both.linearised(points)[1],
        two.linearised(one.forward(points))[1] @ one.linearised(points)[1],
    )


def test_cramers_rule_agrees_with_elimination(rng):
    matrices, vectors = rng.normal(size=(50, 3, 3)) + 2.0 * np.eye(3), rng.normal(size=(50, 3))
    expected = np.linalg.solve(matrices, vectors[:, :, None])[:, :, 0]
    np.testing.assert_allclose(solve3(matrices, vectors), expected, rtol=1e-9)


def test_a_folding_displacement_is_reported_when_inverted():
    def fold(points):
        value = np.zeros_like(points)
        value[:, 0] = -points[:, 0] + points[:, 0] ** 2  # x + d = x^2 has no negative value
        slope = np.zeros((len(points), 3, 3))
        slope[:, 0, 0] = -1.0 + 2.0 * points[:, 0]
        return value, slope

    with pytest.raises(ConvergenceError, match="1 of 1 unsolved"):
        newton_inverse(fold, np.array([[-1.0, 0.0, 0.0]]), "fold")


def test_maps_that_cannot_be_inverted_are_refused():
    with pytest.raises(InputError, match="positive determinant"):
        Affine(np.diag([1.0, 1.0, -1.0]), np.zeros(3))
    knots = np.array([0.0, 1.0, 2.0])
    rise = np.zeros((3, 3))
    rise[1, 2] = 5.0
    with pytest.raises(InputError, match="keep their order"):
        Axial(np.zeros(2), knots, rise, np.zeros((3, 2)), np.zeros(3))
    with pytest.raises(InputError, match="outer radius"):
        TubeWarp(np.zeros(3), np.array([0.0, 0.0, 1.0]), 5.0, 4.0, 3.0, np.zeros(3), 0.0)


def test_the_level_of_one_sphere_or_tube_is_its_distance(rng):
    points = rng.normal(size=(100, 3)) * 10.0
    sphere = Ellipsoid(np.array([1.0, 2.0, 3.0]), np.full(3, 4.0), np.eye(3))
    value, _ = Anatomy((sphere,), 1.0, (), {}).level(points)
    np.testing.assert_allclose(value, np.linalg.norm(points - sphere.center, axis=1) - 4.0)
    tube = Tube(np.array([0.0, 0.0, -100.0]), np.array([0.0, 0.0, 100.0]), 2.0, 2.0)
    value, _ = Anatomy((tube,), 1.0, (), {}).level(points)
    np.testing.assert_allclose(value, np.hypot(points[:, 0], points[:, 1]) - 2.0)


def test_the_gradients_of_the_body_and_its_cuts_are_those_of_central_differences(rng):
    anatomy = left_heart()
    points = project_to_surface(anatomy, _box(rng, 300))
    step = 1e-5
    for function in (anatomy.level, *(cut.height for cut in anatomy.cuts)):
        _, gradient = function(points)
        for axis in range(3):
            shift = step * np.eye(3)[axis]
            difference = (function(points + shift)[0] - function(points - shift)[0]) / (2.0 * step)
            # A tube's slope jumps at its ends: a few points may straddle one.
            error = np.abs(difference - gradient[:, axis])
            assert np.percentile(error, 98.0) < 1e-6


def test_projection_meets_the_surface_and_the_cut(rng):
    anatomy = left_heart()
    for index, cut in enumerate(anatomy.cuts):
        away = cut.center + 0.4 * cut.radius_mm * rng.normal(size=(50, 3))
        points = project_to_surface(anatomy, away)
        points = points[cut.reaches(points) & (np.abs(cut.height(points)[0]) < 2.0)]
        assert len(points)
        points = project_to_curves(anatomy, points, np.full(len(points), index))
        assert np.abs(anatomy.level(points)[0]).max() < 1e-11
        assert np.abs(cut.height(points)[0]).max() < 1e-11


def test_anatomies_with_nonsense_cuts_are_refused():
    sphere = Ellipsoid(np.zeros(3), np.ones(3), np.eye(3))
    axis = np.array([0.0, 0.0, 1.0])
    with pytest.raises(InputError, match="saddle axis"):
        Cut("A.top", None, np.zeros(3), axis, 1.0, 2.0 * axis)
    cut = Cut("B.top", None, np.zeros(3), axis, 1.0, np.array([1.0, 0.0, 0.0]))
    with pytest.raises(InputError, match=r"B\.top"):
        Anatomy((sphere,), 1.0, (cut,), {"A": np.zeros(3)})
