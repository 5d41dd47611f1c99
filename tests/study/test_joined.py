"""One mesh of joined parts, without labels, divided at the seam by a plane or a curve."""

import json

import numpy as np
import pytest

from ostiform.errors import InputError
from ostiform.study import read_study
from ostiform.surface import welded_components, write_surface
from tests.oracles.holed_spheres import holed_sphere, sphere_with_circles
from tests.study.single_shapes import read_shape

HEART = """
schema = 1
[parts.LV]
ostia = ["mitral", "aortic"]
[parts.LA]
ostia = ["mitral", "right", "left"]
[[seams]]
first = "LV.mitral"
second = "LA.mitral"
[shapes]
pattern = "{subject}.vtp"
joined = true
[ostia.points]
"LA.right" = [20, 0, 30]
"LA.left" = [-20, 0, 30]
"""
PLANE = '[cuts.planes."LV.mitral"]\ncenter = [0, 0, 3]\nnormal = [0, 0.1, NORMAL]\n'
ABOVE = [((0.6, 0, 0.8), 0.2, 16), ((-0.6, 0, 0.8), 0.2, 16)]
BELOW = ((0.0, 0.6, -0.8), 0.25, 18)


def shape_of(folder, text):
    (folder / "study.toml").write_text(text, encoding="utf-8")
    study = read_study(folder / "study.toml")
    return read_shape(study, study.entries[0])


def check_conforming(shape):
    rims = [shape.parts[p].vertices[shape.parts[p].loops["mitral"]] for p in ("LV", "LA")]
    assert {tuple(v) for v in rims[0].tolist()} == {tuple(v) for v in rims[1].tolist()}
    (component,) = welded_components(shape.parts, shape.seams)
    assert list(component.parts) == ["LV", "LA"]
    return rims[0]


@pytest.mark.parametrize("normal", ["1.0", "-1.0"])
def test_a_plane_divides_a_joined_heart_whichever_way_it_looks(tmp_path, normal):
    vertices, faces = holed_sphere(1500, [*ABOVE, BELOW])
    write_surface(tmp_path / "a.vtp", 40 * vertices, faces)
    shape = shape_of(tmp_path, HEART + PLANE.replace("NORMAL", normal))
    rim = check_conforming(shape)
    unit = np.array([0.0, 0.1, float(normal)])
    np.testing.assert_allclose((rim - [0, 0, 3]) @ unit, 0.0, atol=1e-9)
    assert shape.parts["LA"].vertices[:, 2].max() > 30
    assert set(shape.parts["LA"].loops) == {"mitral", "right", "left"}


def test_caps_tell_the_sides_of_a_closed_heart(tmp_path):
    vertices, faces, _ = sphere_with_circles(1500, [*ABOVE, BELOW])
    middle = vertices[faces].mean(axis=1)
    label = np.ones(len(faces))
    for value, (center, radius, _) in zip((2, 3, 4), [*ABOVE, BELOW], strict=True):
        direction = np.array(center) / np.linalg.norm(center)
        label[np.arccos(np.clip(middle @ direction, -1, 1)) < radius] = value
    write_surface(tmp_path / "a.vtp", 40 * vertices, faces, cell_data={"id": label})
    text = HEART.replace(
        "joined = true", 'joined = true\nopen = {array = "id", right = 2, left = 3, aortic = 4}'
    )
    shape = shape_of(tmp_path, text + PLANE.replace("NORMAL", "-1.0"))
    check_conforming(shape)
    assert shape.parts["LA"].vertices[shape.parts["LA"].loops["right"]][:, 0].min() > 0


def test_the_normal_points_into_the_second_part_where_nothing_else_tells(tmp_path):
    vertices, faces = holed_sphere(1500, [])
    write_surface(tmp_path / "a.vtp", 40 * vertices, faces)
    text = HEART.replace(', "aortic"', "").replace(', "right", "left"', "")
    text = text.partition("[ostia.points]")[0]
    for normal, sign in (("1.0", 1), ("-1.0", -1)):
        shape = shape_of(tmp_path, text + PLANE.replace("NORMAL", normal))
        check_conforming(shape)
        assert sign * shape.parts["LA"].vertices[:, 2].mean() > 0
    turn = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    curve = 40 * np.c_[np.cos(turn), np.sin(turn), 0.05 * np.cos(2 * turn)]
    markup = {
        "type": "ClosedCurve",
        "name": "LV.mitral",
        "coordinateSystem": "LPS",
        "controlPoints": [{"position": p} for p in curve.tolist()],
    }
    (tmp_path / "a.mrk.json").write_text(json.dumps({"markups": [markup]}), encoding="utf-8")
    with pytest.raises(InputError, match="give a plane whose normal points into LA"):
        shape_of(tmp_path, text + '[cuts]\nmarkups = "{subject}.mrk.json"\n')


def test_a_seam_without_a_cut_is_told(tmp_path):
    vertices, faces = holed_sphere(800, [*ABOVE, BELOW])
    write_surface(tmp_path / "a.vtp", 40 * vertices, faces)
    with pytest.raises(InputError, match="plane or a closed curve for the seam LV.mitral"):
        shape_of(tmp_path, HEART)
    with pytest.raises(InputError, match="cut of LV.mitral: expected the cut to meet"):
        shape_of(tmp_path, HEART + PLANE.replace("NORMAL", "1.0").replace("0, 0, 3", "0, 0, 300"))


def test_joined_needs_seams_and_excludes_split():
    from ostiform.study import parsed_settings

    without = HEART.replace("[[seams]]", "").replace('first = "LV.mitral"', "")
    with pytest.raises(InputError, match=r"shapes.joined: expected \[\[seams\]\]"):
        parsed_settings(without.replace('second = "LA.mitral"', ""))
    both = HEART.replace("joined = true", 'joined = true\nsplit = {array = "a", LV = 1, LA = 2}')
    with pytest.raises(InputError, match="one of the keys joined and split"):
        parsed_settings(both)
