"""Names of openings from the circles of a base domain alone."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ostiform.domain import Circle, circle_to_part_sphere
from ostiform.pipeline.ingest import layout_circles
from ostiform.study import named_population, parsed_settings
from ostiform.study.layout_names import LayoutCircle, names_by_layout
from ostiform.study.shape import ShapeId
from ostiform.study.survey import ShapeSurvey, part_survey
from ostiform.surface import Seam, boundary_loops
from tests.oracles.holed_spheres import holed_sphere, sphere_with_circles

VEINS = {
    "RSPV": (-0.7, -0.7, 0.3),
    "RIPV": (-0.6, 0.6, 0.6),
    "LSPV": (0.1, -0.5, 0.9),
    "LIPV": (1.0, 0.0, 0.2),
}
ATRIUM = {"mitral": (0.0, 0.0, -1.0), **VEINS}
STUDY = """
schema = 1
[parts.LA]
ostia = ["mitral", "RSPV", "RIPV", "LSPV", "LIPV"]
[shapes]
pattern = "{subject}.vtp"
"""


def surveyed(label, seed, turn):
    """A stretched, turned atrium with its true names."""
    rng = np.random.default_rng(seed)
    radii = [0.6, 0.25, 0.22, 0.2, 0.18]
    centers = np.array(list(ATRIUM.values())) + rng.normal(0, 0.05, (5, 3))
    holes = [(tuple(c), r, 16) for c, r in zip(centers, radii, strict=True)]
    vertices, faces = holed_sphere(900, holes)
    loops = boundary_loops(faces)
    middles = np.array([vertices[loop].mean(axis=0) for loop in loops])
    names = {
        name: int(np.argmax(middles @ (c / np.linalg.norm(c))))
        for name, c in zip(ATRIUM, centers, strict=True)
    }
    placed = (30.0 * vertices * rng.uniform(0.85, 1.15, 3)) @ turn.T
    facts = part_survey(placed, faces, loops, {})
    return ShapeSurvey(ShapeId(label, "0", 0.0), {"LA": facts}), names


def circles(turn=None, crowding=1.0):
    """The circles as a study gives them: turned as a whole, the veins crowded about the roof."""
    turn = np.eye(3) if turn is None else turn
    rows = []
    for name, center in ATRIUM.items():
        x, y, z = np.array(center) / np.linalg.norm(center)
        polar = np.arccos(z) * (crowding if name != "mitral" else 1.0)
        point = np.array([np.sin(polar) * np.array([x, y]) / max(np.hypot(x, y), 1e-9)])
        point = turn @ np.append(point, np.cos(polar))
        radius = 15.0 if name == "mitral" else 4.0
        rows.append(
            f'[domain.circles."LA.{name}"]\ncenter = {point.tolist()}\nradius_deg = {radius}\n'
        )
    return STUDY + "".join(rows)


@pytest.mark.parametrize("crowding", [1.0, 0.35])
def test_circles_of_the_domain_alone_name_turned_shapes(crowding):
    turns = Rotation.random(4, rng=np.random.default_rng(5)).as_matrix()
    shapes = [surveyed(str(k), k, turns[k]) for k in range(3)]
    settings = parsed_settings(circles(turns[3], crowding))
    found = named_population(settings, [s for s, _ in shapes], layout_circles(settings))
    assert found.problems == {}
    for survey, names in shapes:
        assert dict(found.names[survey.id].names["LA"]) == names


def test_circles_that_do_not_tell_are_a_clear_problem():
    shape, _ = surveyed("0", 0, np.eye(3))
    some = parsed_settings(circles().rpartition("[domain")[0])
    found = named_population(some, [shape], layout_circles(some))
    assert "expected circles in [domain.circles] (one for every opening" in found.problems[shape.id]


def test_a_ring_of_circles_leaves_two_ways_alike():
    belt = [((np.cos(t), np.sin(t), 0.5), 0.2, 16) for t in np.pi / 2 * np.arange(4)]
    vertices, faces = holed_sphere(900, [((0, 0, -1.0), 0.5, 30), *belt])
    facts = part_survey(30 * vertices, faces, boundary_loops(faces), {})
    shape = ShapeSurvey(ShapeId("0", "0", 0.0), {"LA": facts})
    layout = {
        f"LA.{name}": LayoutCircle(np.array(c) / np.linalg.norm(c), r)
        for name, (c, r, _) in zip("pabcd", [((0, 0, -1.0), 0.5, 30), *belt], strict=True)
    }
    found = names_by_layout(shape, {"LA": tuple("pabcd")}, [("LA",)], (), layout)
    assert found.margin < 0.05


def test_parts_on_both_sides_of_a_seam_turn_together():
    # A ball in two halves; two openings above that only the one below tells apart.
    equator = ((0.0, 0.0, 1.0), np.pi / 2, 48)
    holes = [((0.6, 0.2, 0.8), 0.2, 14), ((-0.6, 0.2, 0.8), 0.2, 14), ((0.5, 0.6, -0.8), 0.25, 16)]
    vertices, faces, _ = sphere_with_circles(900, [*holes, equator])
    middle = vertices[faces].mean(axis=1)
    inside = np.zeros(len(faces), dtype=bool)
    for center, radius, _ in holes:
        inside |= np.arccos(np.clip(middle @ np.array(center) / np.linalg.norm(center), -1, 1)) < (
            radius
        )
    names = {"LV": ("mitral", "aortic"), "LA": ("mitral", "right", "left")}
    true = {"right": holes[0][0], "left": holes[1][0], "aortic": holes[2][0]}
    turn = Rotation.random(rng=np.random.default_rng(1)).as_matrix()
    parts, expected = {}, {}
    for part, above in (("LV", False), ("LA", True)):
        own = faces[~inside & ((middle[:, 2] > 0) == above)]
        loops = boundary_loops(own)
        centers = np.array([vertices[loop].mean(axis=0) for loop in loops])
        expected[part] = {"mitral": int(np.argmin(np.linalg.norm(centers, axis=1)))} | {
            o: int(np.argmin(np.linalg.norm(centers - np.array(true[o]), axis=1)))
            for o in names[part][1:]
        }
        known = {"mitral": expected[part]["mitral"]}
        parts[part] = part_survey(30 * vertices @ turn.T, own, loops, known)
    shape = ShapeSurvey(ShapeId("0", "0", 0.0), parts)
    layout = {}
    for part in names:
        for ostium in names[part][1:]:
            center = np.array(true[ostium]) / np.linalg.norm(true[ostium])
            layout[f"{part}.{ostium}"] = LayoutCircle(center, 0.1)
    seams = (Seam("LV.mitral", "LA.mitral"),)
    found = names_by_layout(shape, names, [("LV", "LA")], seams, layout)
    assert {p: dict(n) for p, n in found.names.items()} == expected
    assert found.margin > 0.5
    assert names_by_layout(shape, names, [("LV", "LA")], seams, {}) is None


def test_circles_drawn_on_the_sphere_of_a_part_are_brought_to_the_component():
    circle = Circle(np.array([0.6, 0.0, 0.8]), np.radians(5.0), 0.0)
    drawn = circle_to_part_sphere(circle, "second")
    text = STUDY.replace("[shapes]", '[parts.LV]\nostia = ["mitral"]\n[shapes]')
    text = text.replace("{subject}.vtp", "{subject}_{part}.vtp")
    text += '[[seams]]\nfirst = "LV.mitral"\nsecond = "LA.mitral"\n'
    text += f'[domain.circles."LA.RSPV"]\ncenter = {drawn.center.tolist()}\nframe = "part"\n'
    text += f"radius_deg = {np.degrees(drawn.radius)}\n"
    found = layout_circles(parsed_settings(text))["LA.RSPV"]
    np.testing.assert_allclose(found.center, circle.center, atol=1e-9)
    np.testing.assert_allclose(found.radius, circle.radius, atol=1e-9)
