"""How far one surface passes through another."""

import numpy as np
import pytest

from ostiform.study import read_study
from ostiform.surface import crossing_depth, write_surface
from tests.oracles.holed_spheres import holed_sphere
from tests.study.single_shapes import read_shape


def ball(radius, center=(0.0, 0.0, 0.0), holes=(), points=2000):
    vertices, faces = holed_sphere(points, holes)
    return radius * vertices + center, faces


@pytest.mark.parametrize("overlap", [0.8, 3.0, 8.6])
def test_two_balls_that_overlap_are_as_deep_in_each_other_as_they_overlap(overlap):
    one, two = ball(20.0), ball(12.0, (32.0 - overlap, 0.0, 0.0))
    depth, place = crossing_depth(one, two)
    assert depth == pytest.approx(overlap, abs=0.3)
    assert np.linalg.norm(place - (20.0, 0.0, 0.0)) < overlap + 2.0
    assert crossing_depth(two, one)[0] == pytest.approx(depth)


def test_what_stands_out_of_an_envelope_is_its_depth():
    outer, inner = ball(20.0), ball(12.0, (12.0, 0.0, 0.0))
    assert crossing_depth(inner, outer)[0] == pytest.approx(4.0, abs=0.3)


def test_surfaces_inside_or_beside_each_other_do_not_cross():
    assert crossing_depth(ball(20.0), ball(12.0))[0] == 0.0
    assert crossing_depth(ball(20.0), ball(12.0, (40.0, 0.0, 0.0)))[0] == 0.0


def test_what_enters_through_an_opening_does_not_cross():
    opened = ball(20.0, holes=[((1.0, 0.0, 0.0), 0.5, 40)])
    assert crossing_depth(opened, ball(5.0, (18.0, 0.0, 0.0)))[0] == 0.0


def test_reading_says_which_components_pass_through_each_other(tmp_path):
    write_surface(tmp_path / "a_LV.vtp", *ball(20.0, points=700))
    write_surface(tmp_path / "a_RV.vtp", *ball(12.0, (24.0, 0.0, 0.0), points=700))
    (tmp_path / "study.toml").write_text(
        'schema = 1\n[parts.LV]\n[parts.RV]\n[shapes]\npattern = "{subject}_{part}.vtp"\n',
        encoding="utf-8",
    )
    study = read_study(tmp_path / "study.toml")
    (said,) = read_shape(study, study.entries[0]).repairs
    assert said.startswith("LV and RV pass through each other, by up to ")
    assert 7.5 < float(said.split("up to ")[1].split(" ")[0]) < 8.5
