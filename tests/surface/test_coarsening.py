"""A component that is too fine is meshed anew, on the same surface, rims and seams."""

import numpy as np
import pytest

from ostiform.errors import ConvergenceError
from ostiform.surface import cleaned_for_embedding, coarsened, face_areas
from tests.oracles.spherical_domains import left_atrium, left_heart
from tests.surface.test_hygiene import check_consistent, chords


@pytest.mark.parametrize("make", [left_atrium, left_heart])
def test_a_fine_component_keeps_its_surface_its_openings_and_its_parts(make):
    component = make(count=6000)[0]
    coarse, distance = coarsened(component, 1500)
    assert len(coarse.vertices) == pytest.approx(1500, rel=0.02)
    assert coarse.parts == component.parts
    check_consistent(coarse)
    assert not chords(coarse)
    # Vertices lie on triangles whose corners lie on the unit sphere, and edges are h long.
    h = np.sqrt(4.0 * np.pi / 1500 * 2.0 / np.sqrt(3.0))
    np.testing.assert_allclose(np.linalg.norm(coarse.vertices, axis=1), 1.0, atol=1e-3)
    assert 0.0 < distance < h**2 / 3.0  # h^2 / 6 in an even triangle
    for part in range(len(component.parts)):
        area, before = (
            face_areas(one.vertices, one.faces)[one.face_part == part].sum()
            for one in (coarse, component)
        )
        assert area == pytest.approx(before, rel=5e-3)
    for name, rim in component.rims.items():
        own = coarse.vertices[coarse.rims[name]]
        center = component.vertices[rim].mean(axis=0)
        assert np.linalg.norm(own.mean(axis=0) - center) < 0.1 * h
        assert coarse.vertices[coarse.rims[name][0]] == pytest.approx(
            component.vertices[rim[0]], abs=h
        )
    for seam, curve in coarse.seams.items():
        assert np.abs(coarse.vertices[curve, 2]).max() < 1e-9, seam  # the equator
    assert cleaned_for_embedding(coarse)[0] is coarse


def test_a_component_that_is_coarse_enough_stays_the_same_object():
    component = left_atrium(count=600)[0]
    assert coarsened(component, len(component.vertices)) == (component, 0.0)


def test_too_few_vertices_for_the_openings_is_refused():
    with pytest.raises(ConvergenceError, match="expected 20 vertices"):
        coarsened(left_atrium(count=600)[0], 20)
