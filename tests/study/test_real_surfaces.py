"""Real surfaces beside the repository: read, opened, named."""

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment
from scipy.spatial.transform import Rotation

from ostiform.errors import InputError
from ostiform.study import loop_facts, named_population, read_study, survey_shape
from ostiform.surface import enclosed_volume, read_mesh, write_surface
from tests.study.single_shapes import read_shape

LEFT_ATRIA = """
schema = 1
[parts.LA]
ostia = ["mitral", "RSPV", "RIPV", "LSPV", "LIPV"]
[shapes]
folder = "{folder}"
pattern = "LA_with_fibers_{{subject}}.vtk"
[ostia.points]
"LA.mitral" = [41, -24, -12]
"LA.RSPV" = [-11, -17, 33]
"LA.RIPV" = [-9, 7, 16]
"LA.LSPV" = [56, -8, 29]
"LA.LIPV" = [55, 2, 10]
"""
VENTRICLE = """
schema = 1
[parts.LV]
ostia = ["mitral", "aortic"]
[shapes]
folder = "{folder}"
pattern = "{{subject}}_LV_ENDOCARDIAL_{{phase}}.vtk"
[ostia.points]
"LV.mitral" = [-1, 35, -34]
"LV.aortic" = [-11, 12, -17]
"""
TEMPLATE = """
schema = 1
[parts.LH]
ostia = ["aortic", "RSPV", "RIPV", "LSPV", "LIPV"]
[shapes]
folder = "{folder}"
pattern = "{{subject}}.vtp"
open = {{array = "ModelFaceID", aortic = 3, RSPV = 2, RIPV = 6, LSPV = 5, LIPV = 4}}
"""


@pytest.fixture
def study(shared_data, tmp_path):
    def make(text, folder):
        path = tmp_path / "study.toml"
        path.write_text(text.format(folder=shared_data / folder), encoding="utf-8")
        return read_study(path)

    return make


def test_five_of_six_left_atria_are_read_and_the_sixth_hole_is_told(study):
    atria = study(LEFT_ATRIA, "left-atria")
    assert [entry.id.subject for entry in atria.entries] == list("123456")
    centers = []
    for entry in atria.entries:
        if entry.id.subject == "5":
            with pytest.raises(InputError, match="shape 5: LA: .* found 6: loop 1 at"):
                read_shape(atria, entry)
            continue
        shape = read_shape(atria, entry)
        *stray, turned = shape.repairs
        assert stray == ["LA: dropped 1 triangle in 1 stray piece"] * (entry.id.subject == "3")
        assert turned.endswith("triangles of an inside-out surface outward")
        surface = shape.parts["LA"]
        assert enclosed_volume(surface.vertices, surface.faces) > 5e4
        assert len(surface.loops["mitral"]) == max(map(len, surface.loops.values()))
        centers.append([loop_facts(surface.vertices, l).center for l in surface.loops.values()])
    mitral, rspv, ripv, lspv, lipv = np.moveaxis(np.array(centers), 1, 0)
    # LPS: left is +x, superior +z; the mitral valve is the lowest opening.
    assert (mitral[:, 2] < np.minimum(ripv[:, 2], lipv[:, 2])).all()
    assert (np.maximum(rspv[:, 0], ripv[:, 0]) < np.minimum(lspv[:, 0], lipv[:, 0])).all()
    assert (rspv[:, 2] > ripv[:, 2]).all()
    assert (lspv[:, 2] > lipv[:, 2]).all()


def test_all_phases_of_a_ventricle_are_named_alike(study):
    cine = study(VENTRICLE, "lv-cine")
    assert len(cine.entries) == 25
    assert cine.alignment_per == "subject"
    assert [entry.id.phase for entry in cine.entries] == [f"{k:03d}" for k in range(25)]
    np.testing.assert_allclose([e.id.time for e in cine.entries], np.arange(25) / 25)
    shapes = [read_shape(cine, entry) for entry in cine.entries]
    for shape in shapes:
        surface = shape.parts["LV"]
        assert {n: len(l) for n, l in surface.loops.items()} == {"mitral": 48, "aortic": 24}
        for name, loop in surface.loops.items():
            np.testing.assert_array_equal(loop, shapes[0].parts["LV"].loops[name])
    volumes = [enclosed_volume(s.parts["LV"].vertices, s.parts["LV"].faces) for s in shapes]
    assert max(volumes) > 2 * min(volumes) > 0


def test_the_left_heart_template_is_opened_by_its_face_labels(study):
    template = study(TEMPLATE, "left-heart-template")
    surface = read_shape(template, template.entries[0]).parts["LH"]
    assert surface.faces.shape == (32558, 3)
    assert {name: len(loop) for name, loop in surface.loops.items()} == {
        "aortic": 67,
        "RSPV": 25,
        "RIPV": 32,
        "LSPV": 42,
        "LIPV": 30,
    }


def test_atria_turned_in_their_files_get_their_names_and_a_sixth_hole_is_closed(
    shared_data, tmp_path
):
    turns = [np.eye(3), *Rotation.random(5, rng=np.random.default_rng(5)).as_matrix()]
    for k, turn in enumerate(turns, start=1):
        mesh = read_mesh(shared_data / "left-atria" / f"LA_with_fibers_{k}.vtk")
        write_surface(tmp_path / f"{k}.vtp", mesh.vertices @ turn.T, mesh.faces)
    text = LEFT_ATRIA.format(folder=".").replace("LA_with_fibers_{subject}.vtk", "{subject}.vtp")
    text = text.replace("[ostia.points]", '[ostia]\nclose = ["LA.hole"]\n[ostia.points]')
    path = tmp_path / "study.toml"
    path.write_text(text, encoding="utf-8")
    atria = read_study(path)
    surveys = [survey_shape(atria, entry) for entry in atria.entries]
    found = named_population(atria.settings, surveys)
    assert found.problems == {}
    rough = np.array(list(atria.settings.ostia.points.values()))
    for turn, survey in zip(turns, surveys, strict=True):
        # Turned back, the atria lie in one frame, where the rough points tell.
        centers = np.array([loop.center for loop in survey.parts["LA"].loops]) @ turn
        distance = np.linalg.norm(rough[:, None] - centers, axis=2)
        _, expected = linear_sum_assignment(distance)
        assert list(found.names[survey.id].names["LA"].values()) == expected.tolist()
    shape = read_shape(atria, atria.entries[4], found.names[surveys[4].id])
    assert "LA: closed 1 accessory opening (34.6 mm round)" in shape.repairs
    assert len(shape.parts["LA"].loops) == 5
