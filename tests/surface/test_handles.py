import numpy as np
import pytest

from ostiform.surface.handles import short_handle_curve
from tests.oracles.holed_spheres import holed_sphere, torus


def length(vertices, curve):
    return np.linalg.norm(vertices[curve] - np.roll(vertices[curve], 1, axis=0), axis=1).sum()


def test_the_curve_of_a_torus_goes_round_its_tube():
    vertices, faces = torus(60, 30)
    tube = np.ptp(vertices[:, 2]) / 2
    curve = short_handle_curve(vertices, faces)
    assert len(set(curve.tolist())) == len(curve)
    assert length(vertices, curve) == pytest.approx(2 * np.pi * tube, rel=0.01)


def test_openings_are_no_handles():
    vertices, faces = holed_sphere(600, [((0, 0, 1), 0.5, 30), ((1, 0, 0), 0.3, 20)])
    assert len(short_handle_curve(vertices, faces)) == 0
    vertices, faces = torus(60, 30)
    opened = np.delete(faces, 5, axis=0)
    curve = short_handle_curve(vertices, opened)
    assert len(curve) == 30
    assert curve.max() < len(vertices)
