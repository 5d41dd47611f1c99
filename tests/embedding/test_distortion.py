"""Distortion and the jump across a seam against maps whose derivative is known."""

from dataclasses import replace

import numpy as np
import pytest

from ostiform.domain import ConformalHoles
from ostiform.embedding import (
    loop_near_circle,
    measure_distortion,
    one_sided_derivatives,
    seam_jump,
)
from ostiform.embedding.distortion import angle_distortion, area_shares
from ostiform.errors import TopologyError
from ostiform.surface import Component, inverse_stereographic, stereographic
from ostiform.surface.quantiles import weighted_quantile
from tests.oracles.spherical_domains import SEAM, left_atrium, left_heart

NO_HOLES = ConformalHoles({}, {})


def with_vertices(component, vertices):
    return Component(
        component.name,
        component.parts,
        vertices,
        component.faces,
        component.face_part,
        component.rims,
        component.seams,
    )


def test_the_identity_has_no_distortion():
    component, sphere, directions = left_atrium()
    distortion = measure_distortion(component, sphere, directions, NO_HOLES)
    np.testing.assert_allclose(distortion.angle_mean, 1.0)
    np.testing.assert_allclose(distortion.angle_p99, 1.0)
    np.testing.assert_allclose([distortion.area_p01, distortion.area_p99], 1.0, atol=3e-3)


def test_a_moebius_map_keeps_angles_and_changes_areas():
    component, sphere, directions = left_atrium(count=6000)
    dilated = inverse_stereographic(2.0 * stereographic(directions))
    distortion = measure_distortion(component, sphere, dilated, NO_HOLES)
    np.testing.assert_allclose(distortion.angle_mean, 1.0, atol=0.03)
    # Area factor 4 (1 + r^2)^2 / (1 + 4 r^2)^2, r = tan(latitude angle / 2): 4 to 1/4 at the poles.
    assert distortion.area_p99 > 2.0 * distortion.area_p01


def test_a_linear_stretch_of_a_cylinder_has_its_ratio():
    component, _, directions = left_atrium(count=6000)
    # From the cylinder (azimuth, height) to the sphere by its equal-area map: at z the stretch
    # along the meridian is 1 / sqrt(1 - z^2), along the parallel sqrt(1 - z^2), their ratio known.
    x, y, z = directions.T
    rho = np.hypot(x, y)
    band = (np.abs(z) < 0.6)[component.faces].all(axis=1)
    cylinder = with_vertices(component, np.stack([x / rho, y / rho, z], axis=1))
    stretch = angle_distortion(cylinder, directions)[band]
    centre = z[component.faces[band]].mean(axis=1)
    np.testing.assert_allclose(stretch, 1.0 / (1.0 - centre**2), rtol=0.06)
    ratio, _ = area_shares(cylinder, directions)
    np.testing.assert_allclose(ratio[band] / np.median(ratio[band]), 1.0, atol=0.02)


def test_shares_average_to_one_and_ignore_the_unit_of_length():
    component, _, directions = left_atrium()
    uneven = component.vertices * np.array([1.0, 2.0, 0.5])
    ratio, share = area_shares(with_vertices(component, uneven), directions)
    np.testing.assert_allclose(ratio @ share, 1.0)
    large, _ = area_shares(with_vertices(component, 1000.0 * uneven), directions)
    np.testing.assert_allclose(large, ratio)


def test_a_collapsed_triangle_has_a_finite_distortion():
    component, _, directions = left_atrium()
    flat = directions.copy()
    face = component.faces[0]
    flat[face[0]] = flat[face[1]]
    stretch = angle_distortion(component, flat)
    assert np.isfinite(stretch).all()
    assert stretch[0] > 1e12


def test_circles_are_compared_with_conformal_radii_where_known():
    component, sphere, directions = left_atrium()
    holes = ConformalHoles({}, {"A.a": np.radians(2.0), "A.b": np.radians(12.0)})
    ratios = measure_distortion(component, sphere, directions, holes).circle_ratio
    assert set(ratios) == {"A.a", "A.b"}
    np.testing.assert_allclose([ratios["A.a"], ratios["A.b"]], [3.0, 0.5])


def test_the_jump_of_a_smooth_map_is_the_floor_of_the_mesh():
    component, sphere, directions = left_heart()
    jump = seam_jump(component, sphere, directions, SEAM)
    assert jump.mean < 1.5 * jump.floor_mean
    np.testing.assert_allclose(jump.kink, 1.0, atol=1e-3)


@pytest.mark.parametrize("factor", [0.5, 1.5, 3.0])
def test_a_kink_of_known_size_is_measured(factor):
    component, sphere, directions = left_heart(count=20000)
    # The surface is squeezed towards the equator on the second side: the map stretches by factor.
    x, y, z = directions.T
    vertices = np.stack([x, y, np.where(z > 0.0, z / factor, z)], axis=1)
    jump = seam_jump(with_vertices(component, vertices), sphere, directions, SEAM)
    np.testing.assert_allclose(jump.kink, factor, rtol=0.05)
    np.testing.assert_allclose(jump.mean, 2.0 * abs(factor - 1.0) / (factor + 1.0), rtol=0.1)
    assert jump.p95 >= jump.mean * 0.95
    assert jump.floor_mean < 0.1


def test_a_shear_of_known_size_is_measured():
    component, sphere, directions = left_heart(count=20000)
    x, y, z = directions.T
    turn = np.where(z > 0.0, 0.3 * np.arcsin(z), 0.0)  # 0.3 rad per rad of latitude, second side
    sheared = np.stack(
        [np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y, z], axis=1
    )
    jump = seam_jump(component, sphere, sheared, SEAM)
    np.testing.assert_allclose(jump.shear, np.arctan(0.3), atol=0.02)


def test_the_jump_does_not_depend_on_the_unit_of_length():
    component, sphere, directions = left_heart()
    one = seam_jump(component, sphere, directions, SEAM)
    large = with_vertices(component, 1000.0 * component.vertices)
    two = seam_jump(large, sphere, directions, SEAM)
    np.testing.assert_allclose(
        [two.mean, two.p95, two.floor_mean, two.kink, two.shear],
        [one.mean, one.p95, one.floor_mean, one.kink, one.shear],
    )


def test_floor_loops_run_once_about_the_seam_near_their_latitude():
    component, _, directions = left_heart()
    center = np.array([0.0, 0.0, 1.0])
    path = loop_near_circle(component, directions, center, np.radians(100))
    latitude = np.degrees(np.arcsin(directions[path][:, 2]))
    np.testing.assert_allclose(latitude, -10.0, atol=4.0)
    azimuth = np.unwrap(np.arctan2(directions[path][:, 1], directions[path][:, 0]))
    assert 2.0 * np.pi - 0.3 < azimuth[-1] - azimuth[0] < 2.0 * np.pi


def test_there_is_no_floor_loop_where_no_inner_vertex_is():
    component, _, directions = left_heart()
    every = np.arange(len(directions))
    sealed = replace(component, rims={**component.rims, "LA.all": every})
    assert loop_near_circle(sealed, directions, np.array([0.0, 0.0, 1.0]), 1.4) is None


def test_a_path_that_does_not_separate_is_refused():
    component, _, directions = left_heart()
    edge = component.seams[SEAM][:2]
    with pytest.raises(TopologyError, match="separates the surface"):
        one_sided_derivatives(component, directions, edge)


def test_weighted_quantiles_count_weight_not_values():
    values = np.array([3.0, 1.0, 2.0])
    weights = np.array([1.0, 8.0, 1.0])
    assert weighted_quantile(values, weights, 0.5) == 1.0
    assert weighted_quantile(values, weights, 0.85) == 2.0
    assert weighted_quantile(values, weights, 1.0) == 3.0
