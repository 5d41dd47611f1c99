"""``warps.h5``: a model frozen on disk places shapes as the run itself would, bit for bit."""

from dataclasses import replace

import numpy as np
import pytest

from ostiform.correspondence import (
    CorrespondenceSettings,
    SurfaceMarks,
    correspond,
    place,
)
from ostiform.correspondence.build import shared_metric_of_template
from ostiform.errors import ArtifactError
from ostiform.model import read_frozen, read_warp, read_warps, write_warps
from tests.oracles.warped_shapes import one_part_domain, triangulated, warped_family, with_level


@pytest.fixture(scope="module", params=["with landmarks", "without"])
def fold(request, tmp_path_factory):
    """A family whose last shape was left out, the optimal model of the others, and its file."""
    domain = one_part_domain()
    family = warped_family(domain, 5, np.random.default_rng(7), n_vertices=500)
    if request.param == "with landmarks":
        place_of = np.array([[0.0, -0.6, -0.8]])
        samplers = tuple(
            replace(one, marks=SurfaceMarks(("a",), surface(place_of), np.ones(1)))
            for one, surface in zip(family.samplers, family.surfaces, strict=True)
        )
        family = replace(family, samplers=samplers)
    settings = CorrespondenceSettings(
        levels=3, n_points=250, n_optimised=90, per="shape", sweeps=3, noise_mm=0.3
    )
    template = with_level(triangulated(domain, 250), domain, 110)
    samplers, ids = family.samplers[:4], family.ids[:4]
    shared = shared_metric_of_template(samplers, ids, domain, template, settings)
    model = correspond(samplers, ids, shared, settings)["optimal"]
    path = tmp_path_factory.mktemp("warps") / "warps.h5"
    write_warps(path, model.frozen, model.warps)
    return family, model, path


def test_a_left_out_shape_lies_where_the_stored_model_places_it(fold):
    family, model, path = fold
    expected = place(family.samplers[4:], family.ids[4:], model.frozen)
    found = place(family.samplers[4:], family.ids[4:], read_frozen(path))
    np.testing.assert_allclose(found.points, expected.points, atol=1e-9, rtol=0.0)
    np.testing.assert_allclose(found.directions, expected.directions, atol=1e-9, rtol=0.0)
    np.testing.assert_allclose(found.transforms, expected.transforms, atol=1e-9, rtol=0.0)


def test_stored_warps_carry_points_as_those_of_the_run_do(fold):
    family, model, path = fold
    template, warps = model.correspondence.template, read_warps(path)
    assert warps.ids == family.ids[:4]
    for id, directions in zip(warps.ids, model.correspondence.directions, strict=True):
        for warp in (warps.of(id), read_warp(path, id), read_warp(path, str(id))):
            found = warp(template.points, template.sphere)
            np.testing.assert_allclose(found, directions, atol=1e-9, rtol=0.0)


def test_a_missing_file_and_an_unknown_shape_are_one_sentence(fold, tmp_path):
    for read in (read_frozen, read_warps):
        with pytest.raises(ArtifactError, match=r"warps\.h5: expected the warps"):
            read(tmp_path / "warps.h5")
    with pytest.raises(ArtifactError, match="warp of nobody/0"):
        read_warp(fold[2], "nobody/0")
