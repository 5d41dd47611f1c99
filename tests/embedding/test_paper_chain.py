"""The paper's chain step by step: theorems where there are, and the folds it is known to have."""

from dataclasses import replace

import numpy as np
import pytest

from ostiform.domain import ConformalHoles, Sphere
from ostiform.embedding import (
    HarmonicStatus,
    MaxMinStatus,
    PaperSettings,
    arc_length_images,
    certify,
    fixed_circle_charts,
    fold_explanations,
    folds_by_circle_ratio,
    harmonic_embedding,
    harmonic_map,
    natural_rotations,
    on_sphere,
    paper_states,
    smoothed_where_better,
    triangle_qualities,
    untangled_by_area,
    widest_harmonic_circle,
)
from ostiform.errors import InputError
from ostiform.surface import (
    Component,
    cotangent_stiffness,
    count_flipped,
    rotation_between,
    uniform_laplacian,
)
from tests.oracles.spherical_domains import (
    SEAM,
    circle,
    domain_of_circles,
    left_atrium,
    left_heart,
    tube,
)

SOLVERS = ("conjugate-gradient", "linear-program")


def on_curves(component):
    fixed = np.zeros(len(component.vertices), dtype=bool)
    for curve in (*component.rims.values(), *component.seams.values()):
        fixed[curve] = True
    return fixed


def hexagon(centre):
    """Six triangles round one vertex."""
    angles = np.pi / 3.0 * np.arange(6)
    points = np.vstack([centre, np.stack([np.cos(angles), np.sin(angles)], axis=1)])
    ring = 1 + np.arange(6)
    faces = np.stack([np.zeros(6, np.int64), ring, np.roll(ring, -1)], axis=1)
    return points, faces, np.arange(7) > 0


def folded_tube(edges_around=24):
    component, sphere = tube(
        3.0, 1.0, 0.3, 4.0 * widest_harmonic_circle(3.0, 1.0, 0.3), edges_around
    )
    return component, sphere


def test_rims_lie_on_their_circles_at_arc_length_and_interior_vertices_at_the_mean():
    component, sphere, _ = left_atrium()
    images = arc_length_images(component, sphere)
    chart = fixed_circle_charts(component, sphere)[0]
    directions = on_sphere((chart,), len(component.vertices))
    for name, (rim, image) in images.items():
        np.testing.assert_allclose(directions[rim], image, atol=1e-12)
        angles = np.unwrap(sphere.rims[name].angles(image))
        np.testing.assert_allclose(np.diff(angles), -2.0 * np.pi / len(rim), atol=1e-9)
    laplacian = uniform_laplacian(chart.faces, len(chart.points))
    np.testing.assert_allclose((laplacian @ chart.points)[~chart.is_fixed], 0.0, atol=1e-10)


def test_a_convex_domain_is_never_folded_by_tutte():
    component, sphere, _ = domain_of_circles(
        {"A.only": circle(20, 50, 40)}, count=900, pole="A.only"
    )
    stretched = replace(component, vertices=component.vertices * np.array([1.0, 3.0, 0.4]))
    charts = fixed_circle_charts(stretched, sphere)
    assert count_flipped(on_sphere(charts, len(component.vertices)), component.faces) == 0


def test_every_part_has_its_own_plane_and_the_seam_is_shared():
    component, sphere, directions = left_heart()
    charts = fixed_circle_charts(component, sphere)
    assert len(charts) == 2
    mapped = on_sphere(charts, len(component.vertices))
    seam = component.seams[SEAM]
    np.testing.assert_allclose(mapped[seam], directions[seam], atol=1e-12)
    for chart, sign in zip(charts, (-1.0, 1.0), strict=True):
        radius = np.linalg.norm(chart.points, axis=1)
        assert radius.max() < 1.0 + 1e-12  # the seam is the unit circle that encloses the part
        inner = np.setdiff1d(chart.vertices, seam)
        assert (sign * mapped[inner, 2] > 0.0).all()


def test_a_closed_surface_has_no_plane():
    component, sphere, _ = domain_of_circles({}, count=200)
    with pytest.raises(InputError, match="expected an opening to project the part from"):
        fixed_circle_charts(component, sphere)


def test_given_rotations_are_where_the_first_vertex_goes():
    component, sphere, _ = left_heart()
    wanted = {"LA.a": 0.4, SEAM.first: -1.1}
    images = arc_length_images(component, sphere, wanted)
    for name, angle in wanted.items():
        first = images[name][1][:1]
        np.testing.assert_allclose(sphere.curves[name].angles(first), angle, atol=1e-12)


def test_natural_rotations_put_a_posed_domain_where_it_is():
    component, sphere, directions = left_heart()
    rotation = rotation_between(np.array([0.0, 0.0, 1.0]), np.array([0.6, -0.2, -0.7]))
    turned = replace(component, vertices=component.vertices @ rotation)
    found = natural_rotations(turned, sphere, rotation)
    for name, (curve, image) in arc_length_images(turned, sphere, found).items():
        np.testing.assert_allclose(image, directions[curve], atol=1e-9, err_msg=name)


def test_natural_rotation_of_a_loop_without_area_is_the_phase():
    component, sphere, _ = left_atrium(count=600)
    vertices = component.vertices.copy()
    vertices[component.rims["A.b"]] = vertices[component.rims["A.b"][0]]
    sphere = replace(sphere, rims={**sphere.rims, "A.b": replace(sphere.rims["A.b"], phase=0.7)})
    found = natural_rotations(replace(component, vertices=vertices), sphere, np.eye(3))
    assert found["A.b"] == 0.7


@pytest.mark.parametrize("solver", SOLVERS)
def test_the_maximin_vertex_of_a_regular_hexagon_is_its_centre(solver):
    points, faces, is_fixed = hexagon([2.3, -1.4])
    result = untangled_by_area(points, faces, is_fixed, solver=solver, max_sweeps=1)
    assert result.status is MaxMinStatus.UNTANGLED
    np.testing.assert_allclose(result.points[0], 0.0, atol=0.02 if solver == SOLVERS[0] else 1e-9)


def test_both_local_solvers_raise_the_least_area_to_the_same_optimum(rng):
    points, faces, is_fixed = hexagon([0.0, 0.0])
    points[1:] += rng.normal(0.0, 0.25, (6, 2))
    points[0] = [1.5, 1.5]

    def least(moved):
        a, b, c = (moved[faces[:, k]] for k in range(3))
        return 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]).min()

    exact, soft = (
        untangled_by_area(points, faces, is_fixed, 1, solver).points  # type: ignore[arg-type]
        for solver in SOLVERS[::-1]  # type: ignore[arg-type]
    )
    grid = np.stack(np.meshgrid(np.linspace(-1, 1, 201), np.linspace(-1, 1, 201)), -1).reshape(
        -1, 2
    )
    best = max(least(np.vstack([p, points[1:]])) for p in grid)
    assert least(exact) >= best  # no grid point is better than the optimum
    assert least(soft) >= 0.95 * least(exact)


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_small_folded_tube_is_untangled(solver):
    component, sphere = folded_tube()
    chart = fixed_circle_charts(component, sphere)[0]
    folded = count_flipped(on_sphere((chart,), len(component.vertices)), component.faces)
    assert folded > 0
    result = untangled_by_area(chart.points, chart.faces, chart.is_fixed, solver=solver)
    assert result.status is MaxMinStatus.UNTANGLED
    assert result.folded == 0
    mapped = on_sphere((replace(chart, points=result.points),), len(component.vertices))
    assert count_flipped(mapped, component.faces) == 0
    np.testing.assert_allclose(result.points[chart.is_fixed], chart.points[chart.is_fixed])


def test_untangling_says_when_its_sweeps_are_used_up_and_when_it_is_stuck():
    component, sphere = folded_tube()
    chart = fixed_circle_charts(component, sphere)[0]
    short = untangled_by_area(chart.points, chart.faces, chart.is_fixed, max_sweeps=2)
    assert short.status is MaxMinStatus.EXHAUSTED
    assert short.folded > 0
    points, faces, is_fixed = hexagon([0.0, 0.0])
    points[2] = -2.0 * points[2]  # the fixed ring itself is crossed: no position is good
    stuck = untangled_by_area(points, faces, is_fixed)
    assert stuck.status is MaxMinStatus.STALLED
    assert stuck.folded > 0


def test_an_unknown_solver_or_descent_is_refused():
    points, faces, is_fixed = hexagon([0.0, 0.0])
    with pytest.raises(InputError, match="untangling solver"):
        untangled_by_area(points, faces, is_fixed, solver="simplex")  # type: ignore[arg-type]
    component, _, directions = left_atrium(count=400)
    with pytest.raises(InputError, match="descent: expected explicit or semi-implicit"):
        harmonic_map(component, directions, on_curves(component), "steepest")  # type: ignore[arg-type]


def test_qualities_are_one_for_equilateral_zero_for_flat_and_negative_for_inverted():
    side = np.radians(1.0)
    angles = 2.0 * np.pi / 3.0 * np.arange(3)
    near_pole = np.stack([side * np.cos(angles), side * np.sin(angles), np.ones(3)], axis=1)
    faces = np.array([[0, 1, 2], [0, 2, 1], [0, 1, 1]])
    np.testing.assert_allclose(triangle_qualities(near_pole, faces), [1.0, -1.0, 0.0], atol=1e-12)


def test_smoothing_never_lowers_the_least_quality_and_keeps_rims(rng):
    component, _, directions = left_atrium()
    fixed = on_curves(component)
    noisy = directions + np.where(fixed[:, None], 0.0, rng.normal(0.0, 0.02, directions.shape))
    noisy /= np.linalg.norm(noisy, axis=1, keepdims=True)
    result = smoothed_where_better(noisy, component.faces, fixed)
    before = triangle_qualities(noisy, component.faces)
    after = triangle_qualities(result.directions, component.faces)
    assert result.moves > 0
    assert after.min() >= before.min()
    assert after.mean() > before.mean()
    np.testing.assert_allclose(result.directions[fixed], noisy[fixed])
    np.testing.assert_allclose(np.linalg.norm(result.directions, axis=1), 1.0)


@pytest.mark.parametrize("descent", ["explicit", "semi-implicit"])
def test_the_identity_is_found_again_where_it_is_conformal(descent):
    component, sphere, directions = left_atrium(count=800)
    start = on_sphere(fixed_circle_charts(component, sphere), len(directions))
    result = harmonic_map(component, start, on_curves(component), descent, 5000, 1e-13)
    assert result.folded == 0
    assert (np.diff(result.energies) <= 0.0).all()
    assert result.status is HarmonicStatus.CONVERGED
    # The continuous identity is harmonic; the discrete minimum is off by the mesh's O(h^2).
    assert np.abs(result.directions - directions).max() < 2e-3
    assert np.abs(start - directions).max() > 0.05
    laplacian = cotangent_stiffness(component.vertices, component.faces) @ result.directions
    along = np.einsum("va,va->v", laplacian, result.directions)
    tangential = laplacian - along[:, None] * result.directions
    assert np.abs(tangential[~on_curves(component)]).max() < 1e-4


def test_the_descent_says_why_it_stopped():
    component, _, directions = left_atrium(count=400)
    fixed = on_curves(component)
    exhausted = harmonic_map(component, directions, fixed, "explicit", 1, 1e-16)
    assert exhausted.status is HarmonicStatus.EXHAUSTED
    assert exhausted.iterations == 1
    settled = harmonic_map(component, directions, fixed, "semi-implicit", 2000, 0.0)
    assert settled.status in (HarmonicStatus.STALLED, HarmonicStatus.CONVERGED)


@pytest.mark.parametrize("length", [1.0, 2.0, 4.0])
def test_the_harmonic_map_of_a_tube_folds_exactly_above_the_law(length):
    ring = 0.02
    widest = widest_harmonic_circle(length, 1.0, ring)
    counts = []
    for factor in (0.8, 0.95, 1.05, 1.3):
        component, sphere = tube(length, 1.0, ring, factor * widest)
        start = on_sphere(fixed_circle_charts(component, sphere), len(component.vertices))
        counts.append(harmonic_map(component, start, on_curves(component)).folded)
    assert counts[:2] == [0, 0]
    assert 0 < counts[2] < counts[3]


def test_folds_grow_with_the_ratio_of_the_circle_to_its_conformal_radius():
    component, sphere = tube(3.0, 1.0, 0.02, 0.001)
    # The conformal map of a tube onto an annulus has the ratio of radii exp(-L / r).
    holes = ConformalHoles({}, {"T.end": 0.02 * np.exp(-3.0)})
    counts = folds_by_circle_ratio(component, sphere, holes, [1.0, 1.9, 2.2, 4.0])
    np.testing.assert_array_equal(counts[:2], 0)
    assert 0 < counts[2] < counts[3]


def test_circles_that_are_too_wide_are_explained():
    _, sphere, _ = left_atrium(count=400)
    holes = ConformalHoles({}, {"A.a": np.radians(1.0), "A.b": np.radians(5.0)})
    sentences = fold_explanations(sphere, holes)
    assert len(sentences) == 1
    assert sentences[0].startswith("A.a: expected a circle of at most 2 times")
    assert "found 6 times" in sentences[0]


def test_the_chain_keeps_every_state_and_its_folds():
    component, sphere = folded_tube()
    result = harmonic_embedding(component, sphere)
    assert [state.name for state in result.states] == ["tutte", "untangled", "smoothed", "harmonic"]
    for state in result.states:
        assert state.flipped == count_flipped(state.directions, component.faces)
        assert state.seconds >= 0.0
    folded = [state.flipped for state in result.states]
    assert folded[0] > 0
    assert folded[1] == folded[2] == 0
    assert folded[3] > 0
    assert len(result.notes) == 1
    assert "expected the harmonic map (HY eq. 3, 4) to be free of folds" in result.notes[0]
    np.testing.assert_array_equal(result.states[-1].directions, result.directions)


def test_a_failed_untangling_falls_back_to_the_given_start():
    component, sphere, directions = left_atrium(count=800)
    long_veins = replace(
        component, vertices=np.where(directions[:, 2:] < -0.2, 4.0 * component.vertices, directions)
    )
    wide = replace(sphere, rims=dict(sphere.rims))
    settings = PaperSettings(max_untangling_sweeps=0)
    rotations = {name: 1.0 + circle.phase for name, circle in sphere.rims.items()}
    alone = harmonic_embedding(long_veins, wide, settings, rotations)
    assert any("untangling (HY eq. 1)" in note for note in alone.notes)
    helped = harmonic_embedding(long_veins, wide, settings, rotations, start=directions)
    assert [state.name for state in helped.states][2] == "start"
    assert helped.states[2].flipped == 0
    assert any("replaces the untangled one" in note for note in helped.notes)
    np.testing.assert_allclose(list(helped.rotations.values()), 0.0, atol=1e-9)


def test_a_joined_left_heart_is_certified_where_its_circles_are_conformal():
    component, sphere, _ = left_heart()
    states = paper_states(component, sphere)
    certificate = certify(component, sphere, states[-1].directions)
    assert certificate.is_valid, certificate.problems


def test_the_chain_gives_the_same_result_every_time_and_in_every_unit():
    component, sphere = folded_tube()
    large = Component(
        component.name,
        component.parts,
        100.0 * component.vertices,
        component.faces,
        component.face_part,
        component.rims,
        component.seams,
    )
    one, two = harmonic_embedding(component, sphere), harmonic_embedding(component, sphere)
    np.testing.assert_array_equal(one.directions, two.directions)
    np.testing.assert_allclose(
        harmonic_embedding(large, sphere).directions, one.directions, atol=1e-6
    )


def test_a_plane_map_whose_chords_fold_on_the_sphere_is_noted():
    # Seven rim vertices close together and one opposite: in the plane the fan is convex, but one
    # triangle spans more than a hemisphere, so that its chord triangle lies on the other side.
    angles = np.append(np.linspace(-0.2, 0.2, 7), np.pi)
    rim = np.stack([np.cos(angles), np.sin(angles), np.zeros(8)], axis=1)
    ring = np.arange(8)
    fan = np.stack([np.full(8, 8), ring, np.roll(ring, -1)], axis=1)
    component = Component(
        "A",
        ("A",),
        np.vstack([rim, [[0.0, 0.0, -1.0]]]),
        fan,
        np.zeros(8, np.int64),
        {"A.only": ring},
        {},
    )
    sphere = Sphere("A", ("A",), {"A.only": circle(0, 0, 30)}, {}, "A.only")
    result = harmonic_embedding(component, sphere)
    assert result.states[1].flipped > 0
    assert any("found 2 triangles so large or flat" in note for note in result.notes)
