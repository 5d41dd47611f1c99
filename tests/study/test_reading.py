import numpy as np
import pytest

from ostiform.errors import InputError, TopologyError
from ostiform.study import read_study
from ostiform.surface import boundary_loops, enclosed_volume, welded_components, write_surface
from tests.oracles.holed_spheres import half_sphere, holed_sphere, sphere_with_circles, torus
from tests.study.single_shapes import read_shape

HEART = """
schema = 1
[parts.LV]
ostia = ["mitral", "aortic"]
[parts.LA]
ostia = ["mitral", "RPV", "LPV"]
[[seams]]
first = "LV.mitral"
second = "LA.mitral"
[shapes]
pattern = "{subject}_{phase}_{part}.vtp"
[ostia.points]
"LA.RPV" = [-24, 0, 32]
"LA.LPV" = [24, 0, 32]
"""
TWO_HOLES = [((0, 0, 1), 0.5, 30), ((1, 0, 0), 0.3, 20)]
ALONE = """
schema = 1
[parts.LA]
ostia = ["mitral", "vein"]
[shapes]
pattern = "{subject}.vtp"
[ostia.points]
"LA.vein" = [40, 0, 0]
"""
CLOSED = 'schema = 1\n[parts.T]\nostia = []\n[shapes]\npattern = "{subject}.vtp"\n'


def lower(count=36):
    vertices, faces = half_sphere(400, count, -1, [((0.6, 0, -0.8), 0.25, 16)])
    return 40.0 * vertices, faces


def upper(count=36):
    holes = [((0.6, 0, 0.8), 0.2, 14), ((-0.6, 0, 0.8), 0.2, 12)]
    vertices, faces = half_sphere(300, count, 1, holes)
    return 40.0 * vertices, faces


@pytest.fixture
def shape(tmp_path):
    """Write surfaces by file name, and read the first shape of a study."""

    def read(text, **surfaces):
        for name, (vertices, faces, *data) in surfaces.items():
            write_surface(tmp_path / f"{name}.vtp", vertices, faces, cell_data=dict(*data))
        path = tmp_path / "study.toml"
        path.write_text(text, encoding="utf-8")
        study = read_study(path)
        return read_shape(study, study.entries[0])

    return read


def sizes(surface):
    return {name: len(loop) for name, loop in surface.loops.items()}


def test_a_left_heart_is_named_and_sewn(shape):
    found = shape(HEART, s_1_LV=lower(), s_1_LA=upper())
    assert str(found.id) == "s/1"
    assert sizes(found.parts["LV"]) == {"mitral": 36, "aortic": 16}
    # The veins are told apart by points, the mitral rims by their coincidence alone.
    assert sizes(found.parts["LA"]) == {"mitral": 36, "RPV": 12, "LPV": 14}
    assert found.repairs == ()
    (component,) = welded_components(found.parts, found.seams)
    assert len(component.vertices) == len(lower()[0]) + len(upper()[0]) - 36


def test_parts_extracted_apart_are_sewn_and_the_repair_is_told(shape):
    found = shape(HEART, s_1_LV=lower(36), s_1_LA=upper(50))
    (repair,) = found.repairs
    assert repair.startswith("seam LV.mitral = LA.mitral: moved rim vertices by up to ")
    (component,) = welded_components(found.parts, found.seams)
    assert len(boundary_loops(component.faces)) == 3


def test_parts_that_do_not_touch_are_refused_with_their_distance(shape):
    vertices, faces = upper()
    far = HEART + '"LA.mitral" = [0, 0, 0]\n"LV.mitral" = [0, 0, 0]\n'
    with pytest.raises(InputError, match=r"shape s/1: seam LV.mitral = LA.mitral: .* 5 mm apart"):
        shape(far, s_1_LV=lower(), s_1_LA=(vertices + [0, 0, 5.0], faces))


def test_the_tolerance_of_a_seam_can_be_set(shape):
    vertices, faces = upper()
    found = shape(
        HEART + "[welding]\ntolerance_mm = 3.0\n",
        s_1_LV=lower(),
        s_1_LA=(vertices + [0, 0, 2.5], faces),
    )
    assert "up to 2.5 mm" in found.repairs[0]


def test_units_and_frame_become_millimetres_in_lps(shape, tmp_path):
    vertices, faces = holed_sphere(300, TWO_HOLES)
    reference = shape(ALONE, a=(40.0 * vertices, faces)).parts["LA"]
    text = ALONE.replace("schema = 1", 'schema = 1\nunits = "cm"\nframe = "RAS"')
    text = text.replace("[40, 0, 0]", "[-4, 0, 0]")
    write_surface(tmp_path / "a.vtp", 4.0 * vertices * [-1, -1, 1], faces)
    raw = (tmp_path / "a.vtp").read_bytes()
    (tmp_path / "a.vtp").write_bytes(raw.replace(b'Name="SPACE"', b'Name="SPICE"'))
    found = shape(text).parts["LA"]
    np.testing.assert_allclose(found.vertices, reference.vertices, rtol=1e-14)
    np.testing.assert_array_equal(found.faces, reference.faces)
    np.testing.assert_array_equal(found.loops["vein"], reference.loops["vein"])


def test_a_file_that_states_another_frame_is_refused(shape):
    text = ALONE.replace("schema = 1", 'schema = 1\nframe = "RAS"')
    with pytest.raises(
        InputError, match="the frame RAS of the study, found a file that states LPS"
    ):
        shape(text, a=holed_sphere(300, TWO_HOLES))


def test_points_of_a_shape_come_before_those_of_its_subject_and_the_population(shape):
    vertices, faces = holed_sphere(300, TWO_HOLES)
    wrong, right = "[0, 0, 40]", "[40, 0, 0]"
    text = ALONE.replace(right, wrong)
    assert sizes(shape(text, a=(40 * vertices, faces)).parts["LA"]) == {"mitral": 20, "vein": 30}
    by_subject = text + f'[ostia.shapes."a"]\n"LA.vein" = {right}\n'
    assert sizes(shape(by_subject).parts["LA"]) == {"mitral": 30, "vein": 20}
    phases = by_subject.replace("{subject}", "{phase}").replace('shapes."a"', 'shapes."1"')
    assert sizes(shape(phases).parts["LA"]) == {"mitral": 30, "vein": 20}
    by_shape = phases + f'[ostia.shapes."1/a"]\n"LA.vein" = {wrong}\n'
    assert sizes(shape(by_shape).parts["LA"]) == {"mitral": 20, "vein": 30}


def test_an_inside_out_surface_is_turned(shape):
    vertices, faces = holed_sphere(300, TWO_HOLES)
    surface = shape(ALONE, a=(40 * vertices, faces[:, [0, 2, 1]])).parts["LA"]
    assert enclosed_volume(surface.vertices, surface.faces) > 0


def test_stray_pieces_and_useless_triangles_are_dropped_and_told(shape):
    vertices, faces = holed_sphere(300, TWO_HOLES)
    corner = len(vertices)
    messy = np.vstack([faces, [[corner, corner + 1, corner + 2]], faces[:2], [[0, 0, 1]]])
    found = shape(ALONE, a=(np.vstack([40 * vertices, 50 + np.eye(3)]), messy))
    assert found.repairs == (
        "LA: dropped 1 degenerate triangle",
        "LA: dropped 2 repeated triangles",
        "LA: dropped 1 triangle in 1 stray piece",
    )
    np.testing.assert_array_equal(found.parts["LA"].vertices, 40 * vertices)
    np.testing.assert_array_equal(found.parts["LA"].faces, faces)


def test_two_pieces_of_like_size_are_refused(shape):
    vertices, faces = holed_sphere(300, TWO_HOLES)
    two = np.vstack([vertices, vertices + 3]), np.vstack([faces, faces + len(vertices)])
    with pytest.raises(TopologyError, match="found 2 pieces, 50 % of the area outside"):
        shape(ALONE, a=two)


def test_a_closed_surface_is_opened_by_the_values_of_its_caps(shape):
    vertices, faces, _ = sphere_with_circles(400, TWO_HOLES)
    centroids = vertices[faces].mean(axis=1)
    centroids /= np.linalg.norm(centroids, axis=1, keepdims=True)
    label = np.ones(len(faces), dtype=np.int32)
    for (center, radius, _), value in zip(TWO_HOLES, (3, 7), strict=True):
        label[np.arccos(np.clip(centroids @ np.array(center, float), -1, 1)) < radius] = value
    data = {"Face": label}
    text = ALONE.replace("[ostia.points]", 'open = {array = "Face", mitral = 3, vein = 7}\n[ostia]')
    text = text.replace('"LA.vein" = [40, 0, 0]', "")
    assert sizes(shape(text, a=(40 * vertices, faces, data)).parts["LA"]) == {
        "mitral": 30,
        "vein": 20,
    }
    with pytest.raises(
        InputError, match="cell array Label of shapes.open, found the cell arrays F"
    ):
        shape(text.replace('"Face"', '"Label"'))
    with pytest.raises(InputError, match=r"shape a: LA \(.*a.vtp\): .* value 5 for .* vein"):
        shape(text.replace("vein = 7", "vein = 5"))


def test_a_cap_that_is_a_ring_is_refused(shape):
    ring = [((0, 0, 1), 0.6, 36), ((0, 0, 1), 0.3, 18)]
    vertices, faces = holed_sphere(500, [], ring)
    angle = np.arccos(vertices[faces].mean(axis=1)[:, 2])
    label = np.where((angle < 0.6) & (angle > 0.3), 3, 1)
    text = ALONE.replace('ostia = ["mitral", "vein"]', 'ostia = ["mitral"]')
    text = text.replace("[ostia.points]\n", 'open = {array = "Face", mitral = 3}\n')
    text = text.replace('"LA.vein" = [40, 0, 0]', "")
    with pytest.raises(TopologyError, match="one opening, found 1 loops round its 54 rim vertices"):
        shape(text, a=(40 * vertices, faces, {"Face": label}))


def test_a_surface_with_a_handle_is_refused(shape):
    with pytest.raises(TopologyError, match=r"shape a: T \(.*a.vtp\): .* found genus 1"):
        shape(CLOSED, a=torus(20, 12))


def test_a_surface_that_touches_itself_at_a_vertex_is_split_there_or_refused(shape):
    vertices, faces = holed_sphere(200, [])
    top, bottom = int(np.argmax(vertices[:, 2])), int(np.argmin(vertices[:, 2]))
    touching = (vertices, np.where(faces == bottom, top, faces))
    found = shape(CLOSED, a=touching)
    assert "T: split 1 vertex where the surface only touches itself" in found.repairs
    with pytest.raises(InputError, match="needs no repair .* split 1 vertex where"):
        shape(CLOSED.replace("schema = 1", "schema = 1\nrepair = false"), a=touching)


def test_an_edge_of_three_faces_is_refused(shape):
    vertices, faces = holed_sphere(200, [])
    fin = [faces[0, 0], faces[0, 1], len(vertices)]
    with pytest.raises(TopologyError, match="found 1 edges with three or more"):
        shape(CLOSED, a=(np.vstack([vertices, [[0, 0, 9]]]), np.vstack([faces, fin])))


def test_a_missing_part_fails_its_shape(shape):
    with pytest.raises(InputError, match="shape s/1: expected a file for the part LA, found none"):
        shape(HEART, s_1_LV=lower())


def test_a_damaged_file_is_named_with_its_shape(shape, tmp_path):
    (tmp_path / "a.vtp").write_bytes(b"<VTKFile")
    with pytest.raises(InputError, match=r"shape a: LA.*a.vtp"):
        shape(ALONE)


def test_an_extra_opening_fails_its_shape_with_a_list(shape):
    with pytest.raises(InputError, match=r"shape a: LA: expected 2 openings .* found 3: loop 1"):
        shape(ALONE, a=holed_sphere(300, [*TWO_HOLES, ((0, 1, 0), 0.2, 12)]))


def test_a_seam_of_a_part_with_itself_is_refused(shape):
    text = ALONE + '[[seams]]\nfirst = "LA.mitral"\nsecond = "LA.vein"\n'
    vertices, faces = holed_sphere(300, TWO_HOLES)
    with pytest.raises(TopologyError, match="joins LA to itself: surfaces with handles"):
        shape(text, a=(40 * vertices, faces))


def test_a_chain_of_parts_with_two_seams_is_named_by_its_seams(shape):
    axis = (0.0, 0.0, 1.0)
    vertices, faces = holed_sphere(500, [], [(axis, 1.0, 28), (axis, 2.0, 30)])
    vertices = 30.0 * vertices
    angle = np.arccos(vertices[faces].mean(axis=1)[:, 2] / 30.0)
    pieces = [faces[angle < 1], faces[(angle > 1) & (angle < 2)], faces[angle > 2]]
    text = """
schema = 1
[parts.A]
ostia = ["x"]
[parts.B]
ostia = ["y", "x"]
[parts.C]
ostia = ["y"]
[[seams]]
first = "A.x"
second = "B.x"
[[seams]]
first = "C.y"
second = "B.y"
[shapes]
pattern = "{subject}_{part}.vtp"
"""
    found = shape(
        text, s_A=(vertices, pieces[0]), s_B=(vertices, pieces[1]), s_C=(vertices, pieces[2])
    )
    assert sizes(found.parts["B"]) == {"y": 30, "x": 28}
    (component,) = welded_components(found.parts, found.seams)
    assert len(component.vertices) == len(vertices)
