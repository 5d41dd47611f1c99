import numpy as np
import pytest

from ostiform.domain import (
    BaseDomain,
    Circle,
    Sphere,
    graded_template,
    spherical_delaunay,
    triangle_quality,
    with_levels,
)
from ostiform.domain.template import curve_names
from ostiform.errors import InputError
from ostiform.surface import (
    Seam,
    boundary_loops,
    count_flipped,
    euler_characteristic,
    half_edges,
    spherical_areas,
    spherical_fibonacci,
    unique_edges,
)
from tests.star_shapes import closed_domain, cup_domain, heart_domain, two_sphere_domain, unit

EXACT = 1e-12  # a point from an angle and back


def directed(faces):
    return {tuple(edge) for edge in half_edges(faces).tolist()}


def chain_domain():
    """Three parts: B inside the equator of A, C inside a small circle of B; a vein in each."""
    seams = {
        Seam("A.x", "B.y"): Circle(unit(0, np.pi / 2), np.pi / 2),
        Seam("B.z", "C.w"): Circle(unit(0.5, 0.8), 0.4),
    }
    rims = {
        "A.v": Circle(unit(1.0, -0.7), 0.1),
        "B.v": Circle(unit(3.5, 0.5), 0.1),
        "C.v": Circle(unit(0.5, 0.8), 0.1),
    }
    return BaseDomain((Sphere("A+B+C", ("A", "B", "C"), rims, seams, "A.x"),))


def handle_domain():
    """One part with a handle: a seam between two circles of the same part."""
    seams = {Seam("A.in", "A.out"): Circle(unit(0.0, 0.0), 0.3)}
    rims = {"A.v": Circle(unit(2.0, 0.3), 0.2)}
    return BaseDomain((Sphere("A", ("A",), rims, seams, "A.v"),))


DOMAINS = {
    "heart": (heart_domain(), 1200, -3),
    "cup": (cup_domain(), 400, 1),
    "closed": (closed_domain(), 300, 2),
    "two spheres": (two_sphere_domain(), 700, 3),
    "chain": (chain_domain(), 1000, -1),
    "handle": (handle_domain(), 500, 1),
}
TEMPLATES = {name: graded_template(domain, n) for name, (domain, n, _) in DOMAINS.items()}


@pytest.mark.parametrize("name", DOMAINS)
def test_a_template_is_a_sound_triangulation_of_its_domain(name):
    domain, n_points, chi = DOMAINS[name]
    template = TEMPLATES[name]
    assert len(template.points) == n_points
    assert count_flipped(template.points, template.faces) == 0
    assert euler_characteristic(template.faces) == chi
    np.testing.assert_array_equal(np.unique(template.faces), np.arange(n_points))
    for index, sphere in enumerate(domain.spheres):
        own = template.faces[template.sphere[template.faces[:, 0]] == index]
        caps = sum(2 * np.pi * (1 - np.cos(circle.radius)) for circle in sphere.rims.values())
        area = spherical_areas(template.points, own).sum()
        np.testing.assert_allclose(area, 4 * np.pi - caps, rtol=0.01)  # chords for arcs


@pytest.mark.parametrize("name", DOMAINS)
def test_points_of_curves_lie_exactly_and_evenly_on_their_circles(name):
    domain, _, _ = DOMAINS[name]
    template = TEMPLATES[name]
    circles = {n: circle for sphere in domain.spheres for n, circle in sphere.curves.items()}
    assert template.curves == curve_names(domain) == tuple(circles)
    for index, (curve, circle) in enumerate(circles.items()):
        on = template.points[template.curve == index]
        np.testing.assert_allclose(on @ circle.center, np.cos(circle.radius), atol=EXACT)
        steps = np.diff(np.sort(circle.angles(on)))
        np.testing.assert_allclose(steps, 2 * np.pi / len(on), atol=1e-9)
        assert set(template.loops[curve]) == set(np.flatnonzero(template.curve == index))


@pytest.mark.parametrize("name", DOMAINS)
def test_every_loop_runs_along_edges_with_its_part_on_the_left(name):
    domain, _, _ = DOMAINS[name]
    template = TEMPLATES[name]
    for ostium, loop in template.loops.items():
        part = template.parts.index(ostium.split(".")[0])
        edges = directed(template.faces[template.face_part == part])
        assert set(zip(loop.tolist(), np.roll(loop, -1).tolist(), strict=True)) <= edges
    rims = {frozenset(loop.tolist()) for loop in boundary_loops(template.faces)}
    names = [rim for sphere in domain.spheres for rim in sphere.rims]
    assert rims == {frozenset(template.loops[rim].tolist()) for rim in names}


@pytest.mark.parametrize("name", DOMAINS)
def test_triangles_are_nearly_equilateral(name):
    template = TEMPLATES[name]
    quality = triangle_quality(template.points, template.faces)
    assert quality.min_angle > 12
    assert quality.mean > 0.9
    assert quality.mean_min_angle > 43


def test_both_sides_of_a_seam_list_the_same_points_in_opposite_order():
    template = TEMPLATES["heart"]
    first, second = template.loops["LV.mitral"], template.loops["LA.mitral"]
    np.testing.assert_array_equal(np.roll(first[::-1], 1), second)
    assert (template.part[first] == template.parts.index("LV")).all()
    lower = template.points[template.faces].mean(axis=1)[:, 2] < 0
    np.testing.assert_array_equal(template.face_part == 0, lower)


def test_parts_of_nested_seams_are_told_apart():
    domain, _, _ = DOMAINS["chain"]
    template = TEMPLATES["chain"]
    middle = template.points[template.faces].mean(axis=1)
    small = domain.spheres[0].seams[Seam("B.z", "C.w")]
    expected = np.where(
        middle @ small.center > np.cos(small.radius), 2, np.where(middle[:, 2] > 0, 1, 0)
    )
    np.testing.assert_array_equal(template.face_part, expected)
    assert set(np.unique(template.part)) == {0, 1, 2}


def test_the_number_of_points_on_a_rim_can_be_chosen():
    template = graded_template(cup_domain(), 300, rim_counts={"LV.mitral": 37}, iterations=3)
    assert len(template.loops["LV.mitral"]) == 37
    assert len(template.points) == 300


def test_sizes_grade_the_template():
    def sizing(u):
        return np.where(u[:, 2] > 0, 1.0, 2.0)

    template = graded_template(closed_domain(), 600, sizing=[sizing])
    north = (template.points[:, 2] > 0).mean()
    assert 0.73 < north < 0.87  # four points to one, less what grades the equator


def test_edges_grow_slowly_away_from_a_fine_rim():
    template = graded_template(cup_domain(), 800, rim_counts={"LV.mitral": 120})
    edges, _, _ = unique_edges(template.faces)
    middle = template.points[edges].mean(axis=1)
    lengths = np.linalg.norm(np.diff(template.points[edges], axis=1)[:, 0], axis=1)
    distance = np.arccos(np.clip(middle[:, 2], -1, 1)) - 0.4
    fine = 2 * np.pi * np.sin(0.4) / 120
    assert lengths[distance < 2 * fine].mean() < 1.8 * fine
    assert (lengths <= 2.2 * (fine + 0.25 * np.maximum(distance, 0) + fine)).all()


def test_the_same_seed_gives_the_same_template():
    one, two = (graded_template(cup_domain(), 200, iterations=3) for _ in range(2))
    np.testing.assert_array_equal(one.points, two.points)
    np.testing.assert_array_equal(one.faces, two.faces)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"n_points": 5}, "more points"),
        ({"rim_counts": {"LV.aortic": 20}}, "found LV.aortic"),
        ({"rim_counts": {"LV.mitral": 2}}, "at least 3"),
        ({"sizing": []}, "one function per sphere"),
        ({"sizing": [lambda u: -np.ones(len(u))]}, "positive"),
    ],
)
def test_impossible_templates_are_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        graded_template(**{"domain": cup_domain(), "n_points": 200, **arguments})


def test_a_spherical_delaunay_triangulation_has_empty_circumcircles():
    points = spherical_fibonacci(80)
    faces = spherical_delaunay(points)
    assert count_flipped(points, faces) == 0
    a, b, c = (points[faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    above = normals @ points.T - np.einsum("fi,fi->f", normals, a)[:, None]
    assert above.max() < 1e-14


def test_too_few_or_coincident_points_have_no_triangulation():
    with pytest.raises(InputError, match="at least 4"):
        spherical_delaunay(np.eye(3))
    points = spherical_fibonacci(20)
    with pytest.raises(InputError, match="coincide"):
        spherical_delaunay(np.vstack([points, points[:2]]))


def test_quality_of_known_triangles():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, np.sqrt(0.75), 0], [0, 1, 0], [2, 0, 0]])
    equilateral = triangle_quality(points, np.array([[0, 1, 2]]))
    np.testing.assert_allclose(
        [equilateral.worst, equilateral.mean, equilateral.min_angle], [1, 1, 60], rtol=1e-12
    )
    right = triangle_quality(points, np.array([[0, 1, 3], [0, 1, 2]]))
    np.testing.assert_allclose([right.worst, right.min_angle], [np.sqrt(0.75), 45], rtol=1e-12)
    np.testing.assert_allclose(right.mean_min_angle, 52.5, rtol=1e-12)
    assert triangle_quality(points, np.array([[0, 1, 4]])).worst == 0.0
    with pytest.raises(InputError, match="at least one triangle"):
        triangle_quality(points, np.zeros((0, 3), dtype=np.int64))


@pytest.mark.parametrize("name", DOMAINS)
def test_levels_are_nested_sound_triangulations(name):
    domain, n_points, chi = DOMAINS[name]
    counts = (n_points // 6, n_points // 2)
    template = with_levels(TEMPLATES[name], domain, counts)
    assert tuple(len(level.index) for level in template.levels) == counts
    coarse, fine = template.levels
    assert set(coarse.index) < set(fine.index)
    for level in template.levels:
        assert euler_characteristic(level.faces) == chi
        assert count_flipped(template.points[level.index], level.faces) == 0
        assert len(np.unique(level.faces)) == len(level.index)
        back = np.full(n_points, -1)
        back[level.index] = np.arange(len(level.index))
        for ostium, loop in template.loops.items():
            kept = back[loop[np.isin(loop, level.index)]]
            assert len(kept) >= 4
            part = template.parts.index(ostium.split(".")[0])
            edges = directed(level.faces[level.face_part == part])
            assert set(zip(kept.tolist(), np.roll(kept, -1).tolist(), strict=True)) <= edges


def test_levels_spread_over_the_given_positions():
    template = TEMPLATES["closed"]
    stretched = template.points * [1.0, 1.0, 20.0]
    level = with_levels(template, closed_domain(), [40], stretched).levels[0]
    heights = np.sort(stretched[level.index, 2])
    even = with_levels(template, closed_domain(), [40]).levels[0]
    assert np.diff(heights).max() < np.diff(np.sort(stretched[even.index, 2])).max()


@pytest.mark.parametrize(
    ("counts", "message"),
    [([200, 100], "ascending"), ([5000], "ascending"), ([10], "circles")],
)
def test_impossible_levels_are_refused(counts, message):
    with pytest.raises(InputError, match=message):
        with_levels(TEMPLATES["heart"], heart_domain(), counts)
