import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ostiform.errors import InputError
from ostiform.study import named_population, parsed_settings
from ostiform.study.shape import ShapeId
from ostiform.study.survey import ShapeSurvey, part_survey
from ostiform.surface import boundary_loops
from tests.oracles.holed_spheres import holed_sphere

# Like an atrium: a wide opening below, four veins that no turn or mirror image exchanges.
CENTERS = {
    "mitral": (0.0, 0.0, -1.0),
    "RSPV": (-0.7, -0.7, 0.3),
    "RIPV": (-0.6, 0.6, 0.6),
    "LSPV": (0.1, -0.5, 0.9),
    "LIPV": (1.0, 0.0, 0.2),
}
RADII = {"mitral": 0.6, "RSPV": 0.25, "RIPV": 0.22, "LSPV": 0.2, "LIPV": 0.18}
STUDY = """
schema = 1
[parts.LA]
ostia = ["mitral", "RSPV", "RIPV", "LSPV", "LIPV"]
[shapes]
pattern = "{subject}.vtp"
"""
POINTS = (
    STUDY
    + "[ostia.points]\n"
    + "\n".join(
        f'"LA.{name}" = {[round(30 * x, 1) for x in center]}' for name, center in CENTERS.items()
    )
)


def atrium(seed, names=tuple(CENTERS), extra=()):
    rng = np.random.default_rng(seed)
    holes = [
        (np.array(CENTERS[name]) + rng.normal(0, 0.05, 3), RADII[name] * rng.uniform(0.9, 1.1), 16)
        for name in names
    ]
    vertices, faces = holed_sphere(900, [*holes, *extra])
    return 30.0 * vertices * rng.uniform(0.9, 1.1, 3) * [1.2, 0.8, 1.0], faces, holes


def survey(label, atrium, transform=None, known=None, points=None):
    vertices, faces, _ = atrium
    if transform is not None:
        vertices = vertices @ transform.T
        if np.linalg.det(transform) < 0:
            faces = faces[:, [0, 2, 1]]
    facts = part_survey(vertices, faces, boundary_loops(faces), known or {})
    return ShapeSurvey(ShapeId(label, "0", 0.0), {"LA": facts}, points or {})


def true_names(atrium, names=tuple(CENTERS)):
    vertices, faces, holes = atrium
    loops = boundary_loops(faces)
    centers = np.array([vertices[loop].mean(axis=0) for loop in loops])
    centers /= np.linalg.norm(centers, axis=1, keepdims=True)
    stretched = [np.array(h[0]) * vertices.std(axis=0) for h in holes]
    return {
        name: int(np.argmax(centers @ (point / np.linalg.norm(point))))
        for name, point in zip(names, stretched, strict=False)
    }


def rotations(count, seed=3):
    return Rotation.random(count, rng=np.random.default_rng(seed)).as_matrix()


def test_rough_points_reach_shapes_that_are_turned_in_their_files():
    atria = [atrium(seed) for seed in range(6)]
    turns = [np.eye(3), *rotations(5)]
    surveys = [
        survey(str(k), a, turn) for k, (a, turn) in enumerate(zip(atria, turns, strict=True))
    ]
    found = named_population(parsed_settings(POINTS), surveys)
    assert found.problems == {}
    for item, a in zip(surveys, atria, strict=True):
        assert dict(found.names[item.id].names["LA"]) == true_names(a)
    assert found.names[surveys[0].id].notes == ()
    assert "named by their places" in found.names[surveys[1].id].notes[0]


def test_one_shape_with_points_names_all_others():
    atria = [atrium(seed) for seed in range(4)]
    surveys = [
        survey(str(k), a, t) for k, (a, t) in enumerate(zip(atria, rotations(4), strict=True))
    ]
    vertices, faces, _ = atria[2]
    names = true_names(atria[2])
    loops = boundary_loops(faces)
    points = {
        f"LA.{name}": rotations(4)[2] @ vertices[loops[k]].mean(axis=0).round(1)
        for name, k in names.items()
    }
    surveys[2] = survey("2", atria[2], rotations(4)[2], points=points)
    found = named_population(parsed_settings(STUDY), surveys)
    assert found.problems == {}
    for item, a in zip(surveys, atria, strict=True):
        assert dict(found.names[item.id].names["LA"]) == true_names(a)


def test_caps_of_one_shape_name_all_others():
    atria = [atrium(seed) for seed in range(3)]
    surveys = [survey("0", atria[0], known=true_names(atria[0]))]
    surveys += [survey(str(k), atria[k], rotations(3)[k]) for k in (1, 2)]
    found = named_population(parsed_settings(STUDY), surveys)
    for item, a in zip(surveys, atria, strict=True):
        assert dict(found.names[item.id].names["LA"]) == true_names(a)


def test_a_mirrored_shape_is_reported():
    atria = [atrium(seed) for seed in range(4)]
    mirror = np.diag([-1.0, 1.0, 1.0])
    surveys = [survey(str(k), a) for k, a in enumerate(atria[:3])] + [survey("m", atria[3], mirror)]
    found = named_population(parsed_settings(POINTS), surveys)
    assert "far better as its mirror image" in found.names[surveys[3].id].notes[0]
    assert dict(found.names[surveys[3].id].names["LA"]) == true_names(atria[3])
    assert not any("mirror" in n for s in surveys[:3] for n in found.names[s.id].notes)


def test_openings_that_look_alike_are_a_clear_problem():
    # A belt of four equal openings fits itself in four ways.
    text = STUDY.replace('["mitral", "RSPV", "RIPV", "LSPV", "LIPV"]', '["a", "b", "c", "d"]')
    belt = [((np.cos(t), np.sin(t), 0.0), 0.3, 16) for t in np.pi / 2 * np.arange(4)]
    vertices, faces = holed_sphere(900, belt)
    points = {f"LA.{name}": 30 * np.array(hole[0]) for name, hole in zip("abcd", belt, strict=True)}
    settings = parsed_settings(text)
    other, other_faces = holed_sphere(1000, belt)
    shapes = [
        survey("0", (30 * vertices, faces, []), points=points),
        survey("1", (30 * other, other_faces, [])),
    ]
    found = named_population(settings, shapes)
    assert list(found.names) == [shapes[0].id]
    assert re.search(r"LA: .* two ways .* \[ostia.shapes.\"1/0\"\]", found.problems[shapes[1].id])


def test_a_fifth_vein_is_refused_with_what_to_do_or_closed():
    extra = [((0.0, 0.9, 0.5), 0.15, 12)]
    atria = [atrium(0), atrium(1), atrium(2), atrium(3, extra=extra)]
    surveys = [survey(str(k), a) for k, a in enumerate(atria)]
    found = named_population(parsed_settings(POINTS), surveys)
    message = found.problems[surveys[3].id]
    assert "LA: expected 5 openings (mitral, RSPV, RIPV, LSPV, LIPV), found 6: loop 1 at" in message
    assert 'ostia.close (as "LA.NAME")' in message
    closing = POINTS.replace("[ostia.points]", '[ostia]\nclose = ["LA.fifth"]\n[ostia.points]')
    found = named_population(parsed_settings(closing), surveys)
    assert found.problems == {}
    names = found.names[surveys[3].id]
    assert dict(names.names["LA"]) == true_names(atria[3])
    assert len(names.closed["LA"]) == 1


def test_a_missing_vein_is_refused_with_the_loops_there_are():
    few = atrium(3, names=("mitral", "RSPV", "RIPV", "LSPV"))
    surveys = [survey(str(k), atrium(k)) for k in range(3)] + [survey("3", few)]
    found = named_population(parsed_settings(POINTS), surveys)
    assert "found 4: loop 1 at [" in found.problems[surveys[3].id]
    assert "open or repair the surface" in found.problems[surveys[3].id]


def test_a_nick_taken_for_a_vein_is_noticed_by_its_size():
    # The vein is closed and a hole of the mesh is there instead: the count is right.
    nick = [((1.0, 0.0, 0.2), 0.03, 6)]
    odd = atrium(3, names=("mitral", "RSPV", "RIPV", "LSPV"), extra=nick)
    surveys = [survey(str(k), atrium(k)) for k in range(3)] + [survey("3", odd)]
    found = named_population(parsed_settings(POINTS), surveys)
    assert "expected the opening LIPV about" in found.problems[surveys[3].id]


def test_shapes_in_other_units_are_refused():
    surveys = [survey(str(k), atrium(k)) for k in range(3)]
    surveys.append(survey("m", atrium(3), 0.001 * np.eye(3)))
    found = named_population(parsed_settings(POINTS), surveys)
    assert list(found.problems) == [surveys[3].id]
    assert "times smaller: its file is in other units" in found.problems[surveys[3].id]


def test_without_any_point_the_loops_are_told():
    surveys = [survey(str(k), atrium(k)) for k in range(2)]
    found = named_population(parsed_settings(STUDY), surveys)
    assert len(found.problems) == 2
    message = found.problems[surveys[0].id]
    assert message.startswith("expected rough points in [ostia.points]")
    assert "; its loops: loop 1 at" in message


def test_a_population_of_giants_is_in_smaller_units():
    surveys = [
        survey(str(k), (1000.0 * v, f, h)) for k, (v, f, h) in enumerate(map(atrium, (0, 1)))
    ]
    found = named_population(parsed_settings(POINTS), surveys)
    assert "less than 5 m, found 96.9 m across" in found.problems[surveys[0].id]
    assert 'check units in the study, as units = "um"' in found.problems[surveys[1].id]


def test_points_in_other_units_are_refused():
    far = POINTS.replace("[0.0, 0.0, -30.0]", "[0, 0, -900]").replace("-21.0", "2100")
    surveys = [survey(str(k), atrium(k)) for k in range(2)]
    found = named_population(parsed_settings(far), surveys)
    assert "check the units and frame of the points" in found.problems[surveys[0].id]


def test_a_name_to_close_must_not_be_an_ostium():
    with pytest.raises(InputError, match=r'ostia.close\[0\]: expected "PART.NAME"'):
        parsed_settings(STUDY + '[ostia]\nclose = ["LA.RSPV"]\n')
