"""Contours in pieces: cut by a plane, they come as segments, and are one curve each."""

import numpy as np
import pytest
import pyvista

from ostiform.fitting.contours import joined_curves
from ostiform.fitting.files import FileRules, read_targets


def circle(n, centre):
    angle = 2.0 * np.pi * np.arange(n) / n
    return np.stack([np.cos(angle), np.sin(angle), np.zeros(n)], axis=1) + centre


@pytest.mark.parametrize("seed", range(3))
def test_segments_in_any_order_and_direction_become_the_curves_they_are_of(seed):
    rng = np.random.default_rng(seed)
    ring, arc = circle(12, [0.0, 0.0, 0.0]), circle(9, [5.0, 0.0, 1.0])
    points = np.concatenate([ring, arc])
    around = np.arange(12)
    segments = [(i, (i + 1) % 12) for i in around] + [(12 + i, 13 + i) for i in range(8)]
    pieces = [np.array(rng.permutation(segments[k])) for k in rng.permutation(len(segments))]
    found = sorted(joined_curves(points, pieces), key=len)
    np.testing.assert_array_equal(
        found[0] if (found[0][0] == arc[0]).all() else found[0][::-1], arc
    )
    assert len(found) == 2
    np.testing.assert_array_equal(found[1][0], found[1][-1])
    length = np.linalg.norm(np.diff(found[1], axis=0), axis=1).sum()
    np.testing.assert_allclose(length, 24.0 * np.sin(np.pi / 12.0))


def test_curves_that_branch_or_touch_are_not_joined_across_the_branch():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [1, 1, 0]])
    pieces = [np.array([0, 1]), np.array([1, 2]), np.array([3, 1])]
    assert sorted(len(curve) for curve in joined_curves(points, pieces)) == [2, 2, 2]


def test_long_pieces_are_joined_end_to_end_and_whole_ones_stay():
    ring = circle(10, [0.0, 0.0, 0.0])
    closed = np.append(np.arange(10), 0)
    (whole,) = joined_curves(ring, [closed])
    np.testing.assert_array_equal(whole, ring[closed])
    halves = [np.arange(6), np.array([0, 9, 8, 7, 6, 5])]
    (joined,) = joined_curves(ring, halves)
    assert len(joined) == 11
    np.testing.assert_array_equal(joined[0], joined[-1])


def test_a_file_of_segments_is_read_as_the_same_curves_as_one_of_polylines(tmp_path):
    surface = pyvista.Sphere(radius=20.0).slice(normal=(0.1, 0.0, 1.0))
    whole = surface.strip(max_length=100_000)
    targets = {}
    for name, mesh in {"segments": surface, "polylines": whole}.items():
        mesh.save(tmp_path / f"{name}.vtp")
        path = str(tmp_path / f"{name}.vtp")
        (targets[name],) = read_targets([path], ("LV",), FileRules("auto", "mm", "LPS"), {})
    lengths = [
        sum(np.linalg.norm(np.diff(curve, axis=0), axis=1).sum() for curve in target.curves)
        for target in targets.values()
    ]
    assert [len(target.curves) for target in targets.values()] == [1, 1]
    np.testing.assert_allclose(lengths[0], lengths[1])
