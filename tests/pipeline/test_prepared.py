"""What a shape is mapped with: its own meshes, or coarser ones that are told of."""

import pytest

from ostiform.pipeline.prepared import prepared_shape
from tests.domain.test_pose import MANY_HOLES, shape, surface


def test_a_part_that_is_too_fine_is_mapped_coarser_and_kept_as_read():
    one = shape(surface(MANY_HOLES, 1500))
    before = len(one.parts["B"].vertices)
    coarse = prepared_shape(one, 700)
    assert len(coarse.components[0].vertices) == pytest.approx(700, rel=0.02)
    assert len(coarse.shape.parts["B"].vertices) == before
    assert coarse.repairs[-1].startswith("B meshed anew for its map, ")
    assert coarse.repairs[-1].endswith(" mm away")


@pytest.mark.parametrize("finest", [None, 10_000])
def test_other_parts_are_mapped_as_they_are(finest):
    one = shape(surface(MANY_HOLES, 1500))
    prepared = prepared_shape(one, finest)
    assert not any("meshed anew" in repair for repair in prepared.repairs)
    assert len(prepared.components[0].vertices) >= len(one.parts["B"].vertices)
