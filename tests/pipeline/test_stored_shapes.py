"""Shapes on disk give what shapes in memory give, in any number of processes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ostiform.artifacts import load_mapped, save
from ostiform.correspondence import (
    CorrespondenceSettings,
    SurfaceMarks,
    correspond,
    sample_with_derivative,
    sampler,
)
from ostiform.correspondence.build import shared_metric_of_template
from ostiform.correspondence.shapes import ShapesInMemory
from ostiform.embedding import Embeddings
from ostiform.errors import ArtifactError
from ostiform.execution import Workers
from ostiform.pipeline.stored_shapes import LARGEST_CHUNK, StoredShape, StoredShapes, chunk_size
from tests.oracles.warped_shapes import triangulated, two_part_domain, warped_family, with_level
from tests.pipeline.stored_functions import logged_and_killed_once, sampled_sum


@pytest.fixture(scope="module")
def family():
    return warped_family(two_part_domain(), 8, np.random.default_rng(3), n_vertices=400)


@pytest.fixture(scope="module")
def stored(family, tmp_path_factory):
    folder = tmp_path_factory.mktemp("stored")
    paths = [folder / f"{index}.bin" for index in range(len(family.samplers))]
    for path, shape in zip(paths, family.samplers, strict=True):
        save(path, shape.components, Embeddings)
    return tuple(StoredShape(path, None) for path in paths)


def test_a_file_gives_every_bit_back_and_arrays_as_writable_as_they_were(family, stored):
    template = triangulated(family.domain, 200)
    for own, shape in zip(stored, family.samplers, strict=True):
        opened = sampler(load_mapped(own.path, Embeddings), family.domain)
        found = sample_with_derivative(opened, template, template.points)
        expected = sample_with_derivative(shape, template, template.points)
        for one, other in zip(found, expected, strict=True):
            np.testing.assert_array_equal(one, other)
        for part, known in zip(opened.components, shape.components, strict=True):
            assert part.component.name == known.component.name
            assert list(part.curves) == list(known.curves)
            for name in ("points", "faces", "twins", "start"):
                one, other = getattr(part.locator, name), getattr(known.locator, name)
                np.testing.assert_array_equal(one, other)
                assert one.flags.writeable == other.flags.writeable
                assert one.flags.aligned


def test_a_damaged_file_is_one_sentence(family, stored, tmp_path):
    path = tmp_path / "shape.bin"
    content = stored[0].path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    with Workers(1) as workers:
        shapes = StoredShapes((StoredShape(path, None),), family.domain, workers)
        with pytest.raises(ArtifactError, match="expected the embeddings"):
            shapes.at(0)


def test_landmarks_of_the_user_stay_with_their_shapes(family, stored):
    marks = SurfaceMarks(("a",), np.zeros((1, 3)), np.ones(1))
    with Workers(1) as workers:
        kept = StoredShapes((replace(stored[0], marks=marks), *stored[1:]), family.domain, workers)
        assert kept.at(0).marks is marks
        assert kept.at(1).marks is None
        assert kept.chosen([1, 0]).at(1).marks is marks


def test_results_come_in_the_order_of_the_shapes_whatever_works_on_them(family, stored):
    template = triangulated(family.domain, 150)
    items = list(range(8))
    expected = ShapesInMemory(family.samplers).each(sampled_sum, items, template)
    for count in (1, 2):
        with Workers(count) as workers:
            found = StoredShapes(stored, family.domain, workers)
            assert found.each(sampled_sum, items, template) == expected


def test_a_killed_worker_costs_its_own_chunk_only(family, stored, tmp_path):
    with Workers(2) as workers:
        found = StoredShapes(stored, family.domain, workers).each(
            logged_and_killed_once, list(range(8)), str(tmp_path)
        )
    assert found == [
        float(shape.components[0].component.vertices.sum()) for shape in family.samplers
    ]
    assert (tmp_path / "killed").exists()
    calls = {int(p.stem): len(p.read_text().splitlines()) for p in Path(tmp_path).glob("*.log")}
    again = {index for index, count in calls.items() if count > 1}
    # Shapes 4 and 5 are one chunk; the other worker's chunk was under way at most.
    assert 5 in again
    assert len(again) <= 4


def test_the_correspondence_does_not_depend_on_where_the_shapes_are(family, stored):
    template = with_level(triangulated(family.domain, 200), family.domain, 90)
    settings = CorrespondenceSettings(levels=3, n_points=200, n_optimised=80, sweeps=2, per="shape")
    shared = shared_metric_of_template(
        family.samplers, family.ids, family.domain, template, settings
    )
    expected = correspond(family.samplers, family.ids, shared, settings)
    with Workers(2) as workers:
        shapes = StoredShapes(stored, family.domain, workers)
        again = shared_metric_of_template(shapes, family.ids, family.domain, template, settings)
        found = correspond(shapes, family.ids, again, settings)
    for kind, model in expected.items():
        for name in ("points", "aligned", "directions"):
            np.testing.assert_allclose(
                getattr(found[kind].correspondence, name),
                getattr(model.correspondence, name),
                rtol=0.0,
                atol=1e-9,
            )


def test_chunks_are_small_for_few_shapes_and_bounded_for_many():
    assert chunk_size(36, 2) == 6
    assert chunk_size(1, 8) == 1
    assert chunk_size(10_000, 2) == LARGEST_CHUNK
