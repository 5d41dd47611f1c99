"""Parts round others are found, and cut open towards the eye."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from ostiform.model import ModelMesh, ShapeModel
from ostiform.report.cutaway import drawn_faces, enclosed_parts
from ostiform.report.shading import ALL_ROUND
from ostiform.surface import spherical_fibonacci


def shells(centre):
    """A model of two spheres: EPI of radius 30 about the origin, LV of radius 20."""
    unit = spherical_fibonacci(400)
    faces = ConvexHull(unit).simplices.astype(np.int64)
    corners = unit[faces]
    inward = np.linalg.det(corners) < 0
    faces[inward] = faces[inward, ::-1]
    points = np.vstack([30.0 * unit, 20.0 * unit + centre])
    mesh = ModelMesh(
        faces=np.vstack([faces, faces + 400]),
        face_part=np.repeat([0, 1], len(faces)),
        part=np.repeat([0, 1], 400),
        parts=("EPI", "LV"),
        loops={},
    )
    return ShapeModel(
        points, np.zeros((0, 800, 3)), np.zeros(0), np.full(800, 1 / 800), mesh, 0.0, 2
    )


def test_a_part_round_another_is_found_and_only_it():
    assert enclosed_parts(shells(np.array([3.0, 0.0, 2.0]))) == {0: (1,)}
    assert enclosed_parts(shells(np.array([25.0, 0.0, 0.0]))) == {}  # they cross
    assert enclosed_parts(shells(np.array([80.0, 0.0, 0.0]))) == {}


@pytest.mark.parametrize("view", ALL_ROUND)
def test_the_half_before_the_inner_part_is_not_drawn(view):
    model = shells(np.zeros(3))
    (drawn,) = drawn_faces(model, (view,))
    nearness = view.seen(model.mean)[model.mesh.faces].mean(axis=1)[:, 2]
    outer = model.mesh.face_part == 0
    np.testing.assert_array_equal(drawn[outer], nearness[outer] < 0.0)
    assert drawn[~outer].all()
