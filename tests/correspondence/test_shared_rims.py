"""Rims that two components share: one curve in every shape, in the mean and in every mode."""

import numpy as np
import pytest

from ostiform.correspondence import distances_of_rims, tied_rims, with_tied_rims
from ostiform.errors import InputError
from ostiform.model import read_correspondence, read_model
from ostiform.pipeline import Stage, add_shapes, build_study
from ostiform.study import parsed_settings
from ostiform.surface import write_surface
from tests.oracles.holed_spheres import half_sphere

STUDY = """schema = 1
pole = "ENDO.mitral"
[parts.ENDO]
ostia = ["mitral", "aortic"]
[parts.EPI]
ostia = ["mitral"]
[ostia]
shared = [["ENDO.mitral", "EPI.mitral"]]
[ostia.points]
"ENDO.mitral" = [0, 0, 0]
"ENDO.aortic" = [17, 0, -20]
[shapes]
pattern = "{subject}_{part}.vtp"
[alignment]
frame = "files"
[template]
points = 240
[correspondence]
levels = 1
"""


def write_ventricle(folder, seed):
    """Write a chamber in a wall: both surfaces end in one curve, sampled by each of them apart."""
    rng = np.random.default_rng(seed)
    size = rng.normal(1.0, 0.1, 3) * [22.0, 20.0, 40.0]
    bulge = rng.normal(0.0, 0.15)
    hole = [((0.65, 0.0, -0.76), 0.25, 14)]
    for part, count, wall, holes in (("ENDO", 30, 0.0, hole), ("EPI", 25, 9.0, [])):
        u, faces = half_sphere(350, count, -1, holes)
        around = np.arctan2(u[:, 1], u[:, 0])
        radial = 1.0 + 0.15 * np.cos(2.0 * around + 3.0 * bulge) * (1.0 - u[:, 2] ** 2)
        points = u * size * radial[:, None] + wall * u * np.clip(-u[:, 2:], 0.0, None) ** 0.5
        write_surface(folder / f"s{seed}_{part}.vtp", points, faces)


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    folder = tmp_path_factory.mktemp("walls")
    for seed in range(5):
        write_ventricle(folder, seed)
    (folder / "study.toml").write_text(STUDY, "utf-8")
    build_study(folder / "study.toml", folder / "out", until=Stage.MODEL, workers=1)
    return folder


def off_first_rim(points, template):
    (tied,) = tied_rims(template, points[0], [("ENDO.mitral", "EPI.mitral")])
    return distances_of_rims(points, template, tied)


def test_a_shared_rim_is_one_curve_in_shapes_mean_and_modes(built):
    found = read_correspondence(built / "out" / "correspondence.h5")
    model = read_model(built / "out" / "model.h5").model
    drawn = [model.mean]
    for mode, variance in zip(model.modes, model.variances, strict=True):
        drawn += [model.mean + sign * np.sqrt(variance) * mode for sign in (-2.0, 2.0)]
    for shapes in (found.points, found.aligned, np.array(drawn)):
        assert off_first_rim(shapes, found.template).max() < 1e-9
    for kind in ("conformal", "euclidean"):
        other = read_correspondence(built / "out" / kind / "correspondence.h5")
        assert off_first_rim(other.points, other.template).max() < 1e-9


def test_the_surfaces_stay_where_they_were(built, tmp_path):
    text = STUDY.replace('shared = [["ENDO.mitral", "EPI.mitral"]]', "")
    (built / "apart.toml").write_text(text, "utf-8")
    build_study(built / "apart.toml", tmp_path / "out", until=Stage.CORRESPOND, workers=1)
    apart = read_correspondence(tmp_path / "out" / "correspondence.h5")
    tied = read_correspondence(built / "out" / "correspondence.h5")
    moved = np.linalg.norm(tied.points - apart.points, axis=2).max(axis=0)
    (one,) = tied_rims(apart.template, apart.aligned.mean(axis=0), [("ENDO.mitral", "EPI.mitral")])
    touched = np.union1d(one.rim, one.inner)
    assert (moved[np.setdiff1d(np.arange(len(moved)), touched)] == 0.0).all()
    assert moved[one.rim].max() > 0.3  # mm: they did slide
    assert moved[one.inner].max() < moved[one.rim].max()
    np.testing.assert_allclose(one.follow.sum(axis=1).max(), 1.0, atol=0.35)


def test_an_added_shape_has_the_shared_rim_too(built, tmp_path):
    write_ventricle(built, 7)
    add_shapes(built / "out", built / "study.toml", tmp_path / "more", ["s7"])
    found = read_correspondence(tmp_path / "more" / "correspondence.h5")
    assert [id.subject for id in found.ids][-1] == "s7"
    assert off_first_rim(found.points, found.template).max() < 1e-9


def test_tied_points_are_the_same_combination_in_every_shape(built, rng):
    found = read_correspondence(built / "out" / "correspondence.h5")
    tied = tied_rims(found.template, found.points[0], [("ENDO.mitral", "EPI.mitral")])
    one, two = rng.normal(size=(2, *found.points.shape))
    both = with_tied_rims(one + 2.0 * two, tied)
    np.testing.assert_allclose(both, with_tied_rims(one, tied) + 2.0 * with_tied_rims(two, tied))


@pytest.mark.parametrize(
    ("pairs", "message"),
    [
        ('[["ENDO.mitral", "EPI.tricuspid"]]', r"shared\[0\]: expected ostia of \[parts\]"),
        ('[["ENDO.mitral", "ENDO.aortic"]]', "expected ostia of two parts"),
        ('[["ENDO.mitral", "EPI.mitral"], ["ENDO.aortic", "EPI.mitral"]]', "once each"),
    ],
)
def test_pairs_that_cannot_be_shared_are_refused(pairs, message):
    text = STUDY.replace('[["ENDO.mitral", "EPI.mitral"]]', pairs)
    with pytest.raises(InputError, match=message):
        parsed_settings(text)
