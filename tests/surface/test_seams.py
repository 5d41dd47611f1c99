import numpy as np
import pytest

from ostiform.errors import InputError
from ostiform.surface import Seam, Surface, boundary_loops, genus, welded_components
from ostiform.surface.seams import default_tolerance, loop_gap, sewn_seam
from tests.oracles.holed_spheres import half_sphere


def half(n_points, count, side, turn=0.0, radius=1.0):
    vertices, faces = half_sphere(n_points, count, side)
    c, s = np.cos(turn), np.sin(turn)
    vertices = radius * vertices @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    (loop,) = boundary_loops(faces)
    return Surface(vertices, faces, {"rim": loop})


def rim(surface):
    return surface.vertices[surface.loops["rim"]]


def sewn(first, second, tolerance=None):
    tolerance = tolerance or default_tolerance(rim(first), rim(second))
    return sewn_seam(first, "rim", second, "rim", tolerance)


def welded(result):
    (component,) = welded_components(
        {"A": result.first, "B": result.second}, [Seam("A.rim", "B.rim")]
    )
    return component


def test_rims_that_coincide_are_left_as_they_are():
    first, second = half(300, 36, -1), half(200, 36, 1)
    result = sewn(first, second)
    assert (result.moved_mm, result.n_inserted) == (0.0, 0)
    np.testing.assert_array_equal(result.first.vertices, first.vertices)
    np.testing.assert_array_equal(result.second.vertices, second.vertices)
    np.testing.assert_array_equal(result.second.loops["rim"], second.loops["rim"])


def test_rims_apart_by_noise_are_moved_together_bit_for_bit(rng):
    first, second = half(300, 36, -1), half(200, 36, 1)
    noisy = Surface(
        second.vertices + 1e-4 * rng.normal(size=second.vertices.shape),
        second.faces,
        second.loops,
    )
    result = sewn(first, noisy)
    assert 0.0 < result.moved_mm < 1e-3
    assert result.n_inserted == 0
    np.testing.assert_array_equal(result.first.vertices, first.vertices)
    assert genus(welded(result).faces) == 0


@pytest.mark.parametrize(
    ("n_first", "n_second", "turn"), [(36, 36, 0.08), (36, 50, 0.03), (20, 64, 0.01), (30, 31, 0.0)]
)
def test_rims_with_different_vertices_are_given_each_others(n_first, n_second, turn):
    first, second = half(300, n_first, -1), half(400, n_second, 1, turn)
    result = sewn(first, second)
    assert result.n_inserted > 0
    assert len(result.first.loops["rim"]) == len(result.second.loops["rim"])
    component = welded(result)
    assert genus(component.faces) == 0
    assert len(boundary_loops(component.faces)) == 0
    # Both halves keep their own faces' area: inserted vertices lie near the edges they divide.
    for before, after in ((first, result.first), (second, result.second)):
        np.testing.assert_allclose(area(after), area(before), rtol=0.01)


def test_sewing_scales_with_its_input():
    small = sewn(half(300, 36, -1), half(400, 50, 1, 0.03))
    large = sewn(half(300, 36, -1, radius=40.0), half(400, 50, 1, 0.03, radius=40.0))
    np.testing.assert_array_equal(small.first.faces, large.first.faces)
    np.testing.assert_array_equal(small.second.faces, large.second.faces)
    np.testing.assert_allclose(large.second.vertices, 40.0 * small.second.vertices, rtol=1e-12)


def test_inserted_vertices_lie_on_both_loops_in_order():
    result = sewn(half(300, 20, -1), half(400, 64, 1, 0.01))
    one, two = rim(result.first), rim(result.second)[::-1]
    start = two.tolist().index(one[0].tolist())
    np.testing.assert_array_equal(np.roll(two, -start, axis=0), one)


def test_rims_further_apart_than_the_tolerance_are_refused():
    second = half(200, 36, 1)
    apart = Surface(second.vertices + [0, 0, 0.3], second.faces, second.loops)
    with pytest.raises(InputError, match="found them 0.3 mm apart"):
        sewn(half(300, 36, -1), apart)


def test_rims_folded_within_the_tolerance_are_refused():
    second = half(200, 36, 1)
    vertices = second.vertices.copy()
    loop = second.loops["rim"]
    vertices[loop[[3, 5]]] = vertices[loop[[5, 3]]]
    folded = Surface(vertices, second.faces, second.loops)
    with pytest.raises(InputError, match="follow each other in one order"):
        sewn(half(300, 36, -1), folded, tolerance=1.0)


def test_the_gap_between_loops_is_the_larger_of_both_directions():
    line = np.array([[0.0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0]])
    bumped = np.array([[0.0, 0, 0], [1, 0, 0.5], [2, 0, 0], [2, 2, 0], [0, 2, 0]])
    np.testing.assert_allclose(loop_gap(line, bumped), 0.5)
    np.testing.assert_allclose(loop_gap(bumped, line), 0.5)


def area(surface):
    corners = surface.vertices[surface.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return 0.5 * np.linalg.norm(normals, axis=1).sum()
