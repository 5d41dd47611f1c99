"""A study of one shape can be embedded; a model asks for two, and says so."""

import numpy as np
import pytest

from ostiform.artifacts import load
from ostiform.embedding import Embeddings
from ostiform.errors import InputError
from ostiform.pipeline import Stage, build_study
from ostiform.surface import write_surface
from tests.oracles.holed_spheres import holed_sphere

STUDY = """
schema = 1
[parts.A]
ostia = ["top", "side"]
[shapes]
pattern = "{subject}.vtp"
[ostia.points]
"A.top" = [0, 0, 36]
"A.side" = [30, 0, 0]
"""


@pytest.fixture
def study(tmp_path):
    holes = [((0.0, 0.0, 1.0), 0.4, 24), ((1.0, 0.0, 0.0), 0.2, 16)]
    vertices, faces = holed_sphere(600, holes)
    write_surface(tmp_path / "one.vtp", vertices * np.array([30.0, 25.0, 36.0]), faces)
    path = tmp_path / "study.toml"
    path.write_text(STUDY, encoding="utf-8")
    return path


def test_one_shape_can_be_embedded(study, tmp_path):
    summary = build_study(study, tmp_path / "out", until=Stage.EMBED)
    assert (summary.shapes, summary.failures) == (1, ())
    (embedding,) = load(tmp_path / "out" / "embeddings" / "one_0.bin", Embeddings)
    assert embedding.certificate.is_valid


def test_one_shape_makes_no_model(study, tmp_path):
    with pytest.raises(InputError, match="at least 2 usable shapes, found 1"):
        build_study(study, tmp_path / "out", until=Stage.CORRESPOND)
