import numpy as np
import pytest

from ostiform.errors import InputError, TopologyError
from ostiform.surface import (
    Seam,
    Surface,
    boundary_loops,
    component_parts,
    genus,
    is_consistently_oriented,
    split_ostium_name,
    welded_components,
)
from tests.oracles.holed_spheres import half_sphere, holed_sphere, torus

MITRAL = Seam("LV.mitral", "LA.mitral")


def surface(vertices, faces, names_by_center):
    """Name each loop by the nearest of the given directions."""
    loops = {}
    for loop in boundary_loops(faces):
        center = vertices[loop].mean(axis=0)
        name = min(
            names_by_center, key=lambda n: np.linalg.norm(np.array(names_by_center[n]) - center)
        )
        loops[name] = loop
    return Surface(vertices, faces, loops)


@pytest.fixture(scope="module")
def heart():
    lower = half_sphere(400, 36, -1, [((0.6, 0, -0.8), 0.25, 16)])
    upper = half_sphere(300, 36, 1, [((0.6, 0, 0.8), 0.2, 14), ((-0.6, 0, 0.8), 0.2, 12)])
    return {
        "LV": surface(*lower, {"mitral": (0, 0, 0), "aortic": (0.6, 0, -0.8)}),  # type: ignore[call-arg]
        "LA": surface(*upper, {"mitral": (0, 0, 0), "RPV": (0.6, 0, 0.8), "LPV": (-0.6, 0, 0.8)}),  # type: ignore[call-arg]
    }


def test_two_parts_weld_to_one_surface_with_the_free_openings_left(heart):
    (component,) = welded_components(heart, [MITRAL])
    assert component.name == "LV+LA"
    assert component.parts == ("LV", "LA")
    assert len(component.vertices) == sum(len(s.vertices) for s in heart.values()) - 36
    assert {name: len(rim) for name, rim in component.rims.items()} == {
        "LV.aortic": 16,
        "LA.RPV": 14,
        "LA.LPV": 12,
    }
    assert is_consistently_oriented(component.faces)
    assert genus(component.faces) == 0
    assert sorted(len(loop) for loop in boundary_loops(component.faces)) == [12, 14, 16]


def test_rims_and_seam_keep_their_positions_and_order(heart):
    (component,) = welded_components(heart, [MITRAL])
    for name, rim in component.rims.items():
        part, ostium = name.split(".")
        original = heart[part].vertices[heart[part].loops[ostium]]
        np.testing.assert_array_equal(component.vertices[rim], original)
    np.testing.assert_array_equal(
        component.vertices[component.seams[MITRAL]],
        heart["LA"].vertices[heart["LA"].loops["mitral"]],
    )


def test_the_second_part_lies_on_the_left_of_the_seam(heart):
    (component,) = welded_components(heart, [MITRAL])
    curve = component.seams[MITRAL]
    pairs = set(zip(curve.tolist(), np.roll(curve, -1).tolist(), strict=True))
    for face, part in zip(component.faces.tolist(), component.face_part.tolist(), strict=True):
        for k in range(3):
            if (face[k], face[(k + 1) % 3]) in pairs:
                assert component.parts[part] == "LA"
    angle = np.unwrap(np.arctan2(*component.vertices[curve][:, [1, 0]].T))
    assert (np.diff(angle) > 0).all()


def test_welding_does_not_depend_on_where_loops_start(heart):
    rolled = dict(heart["LA"].loops)
    rolled["mitral"] = np.roll(rolled["mitral"], 11)
    turned = {**heart, "LA": Surface(heart["LA"].vertices, heart["LA"].faces, rolled)}
    (one,), (two,) = welded_components(heart, [MITRAL]), welded_components(turned, [MITRAL])
    np.testing.assert_array_equal(one.faces, two.faces)
    np.testing.assert_array_equal(np.roll(one.seams[MITRAL], 11), two.seams[MITRAL])


def test_parts_without_seams_are_components_of_their_own(heart):
    lone = welded_components(heart, [])
    assert [c.name for c in lone] == ["LV", "LA"]
    assert set(lone[0].rims) == {"LV.mitral", "LV.aortic"}
    assert lone[0].seams == {}


def test_a_closed_part_is_a_component_without_rims():
    vertices, faces = holed_sphere(200, [])
    (component,) = welded_components({"RV": Surface(vertices, faces, {})}, [])
    assert (dict(component.rims), dict(component.seams)) == ({}, {})


def test_four_parts_in_a_chain_weld_to_one_component():
    bands = {}
    cuts = [np.pi, 2.2, np.pi / 2, 0.9, 0.0]
    axis = (0.0, 0.0, 1.0)
    circles = [(axis, angle, 30) for angle in cuts[1:-1]]
    vertices, faces = holed_sphere(500, [], circles)
    height = np.arccos(vertices[faces].mean(axis=1) @ np.array(axis))
    for k, name in enumerate("ABCD"):
        mine = faces[(height < cuts[k]) & (height > cuts[k + 1])]
        kept, index = np.unique(mine, return_inverse=True)
        centers = {f"{n}": (0, 0, np.cos(cuts[n])) for n in range(1, 4)}
        bands[name] = surface(vertices[kept], index.reshape(-1, 3), centers)
    seams = [Seam("A.1", "B.1"), Seam("C.3", "D.3"), Seam("C.2", "B.2")]
    (component,) = welded_components(bands, seams)
    assert component.name == "A+B+C+D"
    assert len(component.vertices) == len(vertices)
    assert len(component.faces) == len(faces)
    assert list(component.seams) == seams
    # The second part on the left: B below A's rim, D above, B below.
    turns = {
        seam: np.sign(np.diff(np.unwrap(np.arctan2(*component.vertices[c][:, [1, 0]].T)))).mean()
        for seam, c in component.seams.items()
    }
    assert [turns[seam] for seam in seams] == [1.0, 1.0, -1.0]


def test_sets_of_parts_keep_study_order():
    seams = [Seam("d.x", "a.x"), Seam("c.x", "b.x")]
    assert component_parts(["a", "b", "c", "d", "e"], seams) == (("a", "d"), ("b", "c"), ("e",))


def test_a_seam_of_a_part_with_itself_is_refused_in_one_sentence():
    vertices, faces = half_sphere(300, 30, 1, [((0, 0, 1), 0.3, 30)])
    tube = surface(vertices, faces, {"low": (0, 0, 0), "high": (0, 0, 0.95)})
    with pytest.raises(TopologyError, match="joins T to itself: surfaces with handles"):
        welded_components({"T": tube}, [Seam("T.low", "T.high")])


def test_a_cycle_of_seams_is_refused_in_one_sentence(heart):
    seams = [MITRAL, Seam("LV.aortic", "LA.RPV")]
    with pytest.raises(TopologyError, match="do not form a cycle, found LV and LA already joined"):
        welded_components(heart, seams)


def test_a_surface_with_a_handle_is_refused():
    vertices, faces = torus(14, 9)
    with pytest.raises(TopologyError, match="component T: .* found genus 1"):
        welded_components({"T": Surface(vertices, faces, {})}, [])


def test_a_part_in_two_pieces_is_refused():
    vertices, faces = holed_sphere(100, [])
    two = Surface(
        np.vstack([vertices, vertices + 5]), np.vstack([faces, faces + len(vertices)]), {}
    )
    with pytest.raises(TopologyError, match="found 2 pieces"):
        welded_components({"T": two}, [])


def test_rims_that_do_not_coincide_are_refused(heart):
    moved = heart["LA"].vertices.copy()
    moved[heart["LA"].loops["mitral"][3], 2] += 1e-12
    apart = {**heart, "LA": Surface(moved, heart["LA"].faces, heart["LA"].loops)}
    with pytest.raises(InputError, match="found 36 and 36 vertices with 35 in common"):
        welded_components(apart, [MITRAL])


def test_rims_that_run_alike_are_refused(heart):
    inside_out = Surface(
        heart["LA"].vertices,
        heart["LA"].faces[:, [0, 2, 1]],
        {name: loop[::-1] for name, loop in heart["LA"].loops.items()},
    )
    with pytest.raises(InputError, match="run in opposite directions"):
        welded_components({**heart, "LA": inside_out}, [MITRAL])


def test_names_that_do_not_exist_are_refused(heart):
    with pytest.raises(InputError, match="expected an opening tricuspid on LA"):
        welded_components(heart, [Seam("LV.mitral", "LA.tricuspid")])
    with pytest.raises(InputError, match="found RA"):
        welded_components(heart, [Seam("LV.mitral", "RA.mitral")])
    with pytest.raises(InputError, match=r'written "PART.OSTIUM", found "mitral"'):
        split_ostium_name("mitral")


def test_chords_that_both_parts_have_between_the_same_rim_vertices_are_split():
    # A square rim whose diagonal is an edge of both parts: two pyramid-less quads each.
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    lid = Surface(square, np.array([[0, 1, 2], [0, 2, 3]]), {"rim": np.array([0, 1, 2, 3])})
    base = Surface(square, np.array([[0, 2, 1], [0, 3, 2]]), {"rim": np.array([3, 2, 1, 0])})
    (component,) = welded_components({"lid": lid, "base": base}, [Seam("base.rim", "lid.rim")])
    assert len(component.vertices) == 5
    np.testing.assert_array_equal(component.face_part, [0, 0, 1, 1, 1, 1])
    assert genus(component.faces) == 0
    np.testing.assert_allclose(component.vertices[4], [0.5, 0.5, 0.0])
