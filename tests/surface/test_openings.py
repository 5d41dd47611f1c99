import numpy as np
import pytest

from ostiform.errors import InputError, TopologyError
from ostiform.surface import boundary_loops, genus, opened_by_value
from tests.oracles.holed_spheres import sphere_with_circles

CIRCLES = [((0, 0, 1), 0.5, 30), ((1, 0, 0), 0.3, 20)]


@pytest.fixture(scope="module")
def closed():
    """A closed sphere whose two caps hold the values 3 and 7, the wall 1."""
    vertices, faces, loops = sphere_with_circles(500, CIRCLES)
    values = np.ones(len(faces), dtype=np.int32)
    centroids = vertices[faces].mean(axis=1)
    centroids /= np.linalg.norm(centroids, axis=1, keepdims=True)
    for (center, radius, _), value in zip(CIRCLES, (3, 7), strict=True):
        values[np.arccos(np.clip(centroids @ np.array(center, float), -1, 1)) < radius] = value
    return faces, values, loops


def test_deleting_caps_opens_a_closed_surface_and_names_its_rims(closed):
    faces, values, loops = closed
    opened = opened_by_value(faces, values, {"mitral": 3, "aortic": 7})
    assert genus(opened.faces) == 0
    assert len(boundary_loops(opened.faces)) == 2
    np.testing.assert_array_equal(opened.rims["mitral"], loops[0])
    np.testing.assert_array_equal(opened.rims["aortic"], loops[1])
    np.testing.assert_array_equal(opened.faces, faces[values == 1])


def test_caps_that_are_not_named_stay_closed(closed):
    faces, values, _ = closed
    assert len(boundary_loops(opened_by_value(faces, values, {"aortic": 7.0}).faces)) == 1


def test_a_value_that_no_triangle_has_is_refused(closed):
    faces, values, _ = closed
    with pytest.raises(InputError, match=r"value 4 for the opening mitral, found the values 1, 3"):
        opened_by_value(faces, values, {"mitral": 4})


def test_an_array_of_another_length_is_refused(closed):
    faces, values, _ = closed
    with pytest.raises(InputError, match="one value per triangle"):
        opened_by_value(faces, values[:-1], {"mitral": 3})


def test_caps_that_touch_are_refused(closed):
    faces, values, _ = closed
    touching = values.copy()
    rim = np.isin(faces, np.unique(faces[values == 3])).any(axis=1) & (values == 1)
    touching[np.flatnonzero(rim)[0]] = 9
    with pytest.raises(TopologyError, match="mitral and nick with"):
        opened_by_value(faces, touching, {"mitral": 3, "nick": 9})


def test_a_surface_that_is_all_cap_is_refused(closed):
    faces, values, _ = closed
    with pytest.raises(TopologyError, match="every triangle is a cap"):
        opened_by_value(faces, np.full_like(values, 3), {"mitral": 3})
