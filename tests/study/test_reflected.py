"""Shapes mirrored on reading: surfaces, openings, cuts and points, wherever they come from."""

import json

import nibabel
import numpy as np
import pytest
from scipy.spatial import cKDTree

from ostiform.errors import InputError
from ostiform.study import read_study
from ostiform.surface import enclosed_volume, write_surface
from tests.oracles.holed_spheres import holed_sphere
from tests.study.single_shapes import read_shape

STRETCH = np.array([30.0, 20.0, 24.0])
HOLES = [((0.9, 0.2, 0.4), 0.5, 24), ((-0.3, 0.9, 0.3), 0.3, 20)]
HEADER = 'schema = 1\n[parts.A]\nostia = ["big", "small"]\n[shapes]\n'
BIG = STRETCH * HOLES[0][0] / np.linalg.norm(HOLES[0][0])


def lopsided(vertices):
    return vertices * STRETCH + 4.0 * np.exp(3.0 * (vertices @ [0.5, 0.6, -0.6] - 1.0))[:, None]


def write_pair(folder, holes):
    """Write a surface and its mirror image, faces outward in both."""
    vertices, faces = holed_sphere(600, holes)
    write_surface(folder / "m0_L.vtp", lopsided(vertices), faces)
    write_surface(folder / "m1_R.vtp", lopsided(vertices) * [-1, 1, 1], faces[:, ::-1])


def read_pair(folder, text):
    (folder / "study.toml").write_text(text)
    study = read_study(folder / "study.toml")
    return [read_shape(study, entry) for entry in study.entries]


def check_equal(one, two):
    for part, first in one.parts.items():
        second = two.parts[part]
        np.testing.assert_allclose(second.vertices, first.vertices, atol=1e-12)
        assert {tuple(np.roll(f, -f.argmin())) for f in second.faces} == {
            tuple(np.roll(f, -f.argmin())) for f in first.faces
        }
        for name, loop in first.loops.items():
            np.testing.assert_array_equal(second.loops[name], loop)


def check_same_cut(one, two):
    first, second = one.parts["A"], two.parts["A"]
    assert len(first.vertices) == len(second.vertices)
    assert cKDTree(first.vertices).query(second.vertices)[0].max() < 1e-9
    rims = [s.vertices[s.loops["big"]] for s in (first, second)]
    np.testing.assert_allclose(rims[0].mean(0), rims[1].mean(0), atol=1e-9)
    volumes = [enclosed_volume(s.vertices, s.faces) for s in (first, second)]
    assert volumes[0] == pytest.approx(volumes[1])


def test_a_reflected_surface_is_the_one_that_was_mirrored(tmp_path):
    write_pair(tmp_path, HOLES)
    own = f'[ostia.shapes.m1_R]\n"A.big" = {(BIG * [-1, 1, 1]).tolist()}\n'
    points = f'[ostia.points]\n"A.big" = {BIG.tolist()}\n'
    for reflect in ('"*_R"', '["m1_R"]'):
        text = HEADER + f'pattern = "{{subject}}.vtp"\nreflect = {reflect}\n'
        one, two = read_pair(tmp_path, text + own + points)
        check_equal(one, two)
        assert not one.repairs
        assert two.repairs == ("A: reflected left for right, as the study says",)
    (tmp_path / "sheet.csv").write_text("subject,file,reflect\na,m0_L.vtp,\nb,m1_R.vtp,yes\n")
    check_equal(*read_pair(tmp_path, HEADER + 'sheet = "sheet.csv"\n' + points))


def test_cuts_of_the_shape_itself_lie_in_its_file_and_those_of_all_where_it_comes_to(tmp_path):
    write_pair(tmp_path, [])
    head = HEADER.replace('"big", "small"', '"big"')
    head += 'pattern = "{subject}.vtp"\nreflect = "*_R"\n'
    plane = f"{{center = {(0.9 * BIG).tolist()}, normal = {BIG.tolist()}, reach = 30}}"
    one, two = read_pair(tmp_path, head + f'[cuts]\nplanes = {{"A.big" = {plane}}}\n')
    check_same_cut(one, two)
    for name, sign in (("m0_L", 1), ("m1_R", -1)):
        place = 0.9 * BIG * [sign, 1, 1]
        markup = {
            "type": "Plane",
            "coordinateSystem": "LPS",
            "name": "big",
            "center": place.tolist(),
            "normal": (BIG * [sign, 1, 1]).tolist(),
            "size": [60, 60],
        }
        (tmp_path / f"{name}.mrk.json").write_text(json.dumps({"markups": [markup]}))
    marked = read_pair(tmp_path, head + '[cuts]\nmarkups = "{subject}.mrk.json"\n')
    check_same_cut(*marked)
    check_same_cut(one, marked[0])


def test_label_maps_are_reflected_as_meshes_are(tmp_path):
    index = np.indices((30, 30, 30)).transpose(1, 2, 3, 0)
    mask = ((((index - 14.5) / [12.0, 8.0, 10.0]) ** 2).sum(-1) < 1) | (
        ((index - [22, 18, 16]) ** 2).sum(-1) < 30
    )
    for name, sign in (("a", 1.0), ("b_R", -1.0)):
        affine = np.diag([2.0 * sign, 2.0, 2.0, 1.0])
        nibabel.save(nibabel.Nifti1Image(mask.astype(np.uint8), affine), tmp_path / f"{name}.nii")
    text = 'schema = 1\n[parts.A]\n[shapes]\npattern = "{subject}.nii"\nreflect = "*_R"\n'
    one, two = (shape.parts["A"] for shape in read_pair(tmp_path, text))
    volumes = [enclosed_volume(s.vertices, s.faces) for s in (one, two)]
    assert volumes[0] == pytest.approx(volumes[1], rel=1e-3)
    assert volumes[0] > 0.0
    np.testing.assert_allclose(one.vertices.mean(0), two.vertices.mean(0), atol=0.3)


def test_a_pattern_that_names_nobody_is_refused(tmp_path):
    write_pair(tmp_path, HOLES)
    text = HEADER + 'pattern = "{subject}.vtp"\nreflect = "*_r"\n'
    with pytest.raises(InputError, match="shapes.reflect: expected subjects, found none named"):
        read_pair(tmp_path, text)
