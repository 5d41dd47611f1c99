"""The automatic and the explicit layout of the base domain."""

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ostiform.domain import (
    Circle,
    CircleSetting,
    ComponentOutline,
    ConformalHoles,
    chosen_pole,
    circle_from_part_sphere,
    lay_out,
    outlined,
    pole_circle,
)
from ostiform.errors import InputError, TopologyError
from ostiform.surface import Component, Seam
from tests.oracles.holed_spheres import holed_sphere
from tests.oracles.left_heart_domain import (
    MITRAL,
    VEINS,
    at,
    chain,
    left_heart_holes,
    left_heart_outline,
    outline,
)

NARROW = np.radians(3.5)


def angle(one, other):
    return np.arccos(np.clip(one @ other, -1.0, 1.0))


def gaps(sphere):
    """Gap over required gap for all pairs of rims of one part and for rims and the equator."""
    found = {}
    for (one, first), (other, second) in itertools.combinations(sphere.rims.items(), 2):
        if one.split(".")[0] == other.split(".")[0]:
            gap = angle(first.center, second.center) - first.radius - second.radius
            required = max(3.0 * min(first.radius, second.radius), np.radians(3.0))
            found[one, other] = gap / required
    if sphere.seams:
        for name, circle in sphere.rims.items():
            side = 1.0 if name.startswith("LA") else -1.0
            gap = np.arcsin(side * circle.center[2]) - circle.radius
            found[name, "seam"] = gap / max(3.0 * circle.radius, np.radians(3.0))
    return found


def test_circles_that_have_room_stay_at_the_population_mean(rng):
    holes = [left_heart_holes(rng) for _ in range(6)]
    (sphere,) = lay_out([[left_heart_outline()] * 6], [holes]).spheres
    for name, circle in sphere.rims.items():
        mean = np.mean([shape.directions[name] for shape in holes], axis=0)
        np.testing.assert_allclose(circle.center, mean / np.linalg.norm(mean), atol=1e-12)
    np.testing.assert_allclose([sphere.rims[name].radius for name in VEINS], NARROW)
    np.testing.assert_allclose(sphere.rims["LV.aortic"].radius, np.radians(8.0))
    assert sphere.pole == "LV.mitral"


def test_the_seam_is_the_equator_with_its_second_part_in_the_north(rng):
    (sphere,) = lay_out([[left_heart_outline()]], [[left_heart_holes(rng)]]).spheres
    np.testing.assert_allclose(sphere.seams[MITRAL].center, [0.0, 0.0, 1.0])
    np.testing.assert_allclose(sphere.seams[MITRAL].radius, np.pi / 2)
    assert all(sphere.rims[name].center[2] > 0 for name in VEINS)
    assert sphere.rims["LV.aortic"].center[2] < 0


def test_crowded_circles_are_moved_apart_and_no_farther():
    holes = left_heart_holes(LA_RIPV=at(55, 30), LV_aortic=at(-8, 30))
    (sphere,) = lay_out([[left_heart_outline()]], [[holes]]).spheres
    found = gaps(sphere)
    assert min(found.values()) > 1.0 - 1e-6
    np.testing.assert_allclose(found["LA.RSPV", "LA.RIPV"], 1.0, atol=1e-4)
    np.testing.assert_allclose(found["LV.aortic", "seam"], 1.0, atol=1e-4)
    for name in ("LA.LSPV", "LA.LIPV"):
        np.testing.assert_allclose(sphere.rims[name].center, holes.directions[name], atol=1e-6)


def test_two_crowded_circles_share_the_way():
    holes = left_heart_holes(LA_RSPV=at(50, 20), LA_RIPV=at(50, 26))
    (sphere,) = lay_out([[left_heart_outline()]], [[holes]]).spheres
    moves = [
        angle(sphere.rims[name].center, holes.directions[name]) for name in ("LA.RSPV", "LA.RIPV")
    ]
    np.testing.assert_allclose(moves[0], moves[1], rtol=1e-3)
    before = angle(holes.directions["LA.RSPV"], holes.directions["LA.RIPV"])
    np.testing.assert_allclose(sum(moves), 5 * NARROW - before, rtol=1e-3)


def test_a_circle_on_the_wrong_side_of_the_seam_is_brought_to_its_own():
    (sphere,) = lay_out([[left_heart_outline()]], [[left_heart_holes(LA_LIPV=at(-5, 160))]]).spheres
    found = gaps(sphere)
    np.testing.assert_allclose(found["LA.LIPV", "seam"], 1.0, atol=1e-4)


def test_coincident_circles_are_moved_apart():
    holes = left_heart_holes(LA_RSPV=at(50, 20), LA_RIPV=at(50, 20), LA_LSPV=at(50, 20))
    (sphere,) = lay_out([[left_heart_outline()]], [[holes]]).spheres
    assert min(gaps(sphere).values()) > 1.0 - 1e-6


def test_the_order_about_the_pole_is_kept(rng):
    names = [f"A.{k}" for k in range(9)]
    one = outline(("A",), [*names, "A.pole"])
    longitudes = np.sort(rng.uniform(0, 120, 9))
    holes = ConformalHoles(
        {n: at(rng.uniform(-30, 0), lon) for n, lon in zip(names, longitudes, strict=True)},
        dict.fromkeys(names, 0.001),
    )
    (sphere,) = lay_out([[one]], [[holes]], pole="A.pole").spheres
    assert min(gaps(sphere).values()) > 1.0 - 1e-6
    azimuth = np.unwrap([np.arctan2(*sphere.rims[n].center[1::-1]) for n in names])
    steps = np.diff(np.r_[azimuth, azimuth[0] + 2 * np.pi])
    assert (steps > 0).all()
    np.testing.assert_allclose(steps.sum(), 2 * np.pi)


def test_circles_that_do_not_fit_shrink():
    """A band of 25 degrees holds 2 radii and 2 gaps of 3 radii each: 25 / 8 degrees of radius."""
    holes = left_heart_holes(LA_RIPV=at(10, 60), LA_LSPV=at(12, 150), LA_LIPV=at(9, 250))
    circles = {"LA.RSPV": CircleSetting(at(90, 0), 65.0)}
    (sphere,) = lay_out([[left_heart_outline()]], [[holes]], circles=circles).spheres
    radii = np.degrees([sphere.rims[name].radius for name in VEINS[1:]])
    assert (radii <= 25.0 / 8.0).all()
    assert (radii > 0.9 * 25.0 / 8.0).all()
    np.testing.assert_allclose(sphere.rims["LA.RSPV"].radius, np.radians(65.0))


def test_forty_crowded_circles_are_spread():
    names = [f"A.{k:02d}" for k in range(40)]
    k = np.arange(40)
    centers = [at(80 - 1.2 * i, 137.5 * i) for i in k]
    holes = ConformalHoles(dict(zip(names, centers, strict=True)), dict.fromkeys(names, 0.01))
    one = outline(("A",), {"A.pole": 500.0} | dict.fromkeys(names, 40.0))
    (sphere,) = lay_out([[one]], [[holes]]).spheres
    assert min(gaps(sphere).values()) > 1.0 - 1e-6


def test_a_domain_without_room_is_refused():
    circles = {name: CircleSetting(radius_deg=40.0) for name in VEINS}
    with pytest.raises(InputError, match=r"expected room for a gap of .* make explicit circles"):
        lay_out([[left_heart_outline()]], [[left_heart_holes()]], circles=circles)


def test_the_layout_does_not_depend_on_the_order_of_shapes_or_names(rng):
    holes = [left_heart_holes(rng, LA_RIPV=at(55, 30)) for _ in range(5)]
    one = left_heart_outline()
    turned = ComponentOutline(
        one.name, one.parts, one.areas, dict(list(one.rims.items())[::-1]), one.seams
    )
    (before,) = lay_out([[one] * 5], [holes]).spheres
    (after,) = lay_out([[turned] * 5], [holes[::-1]]).spheres
    for name, circle in before.rims.items():
        np.testing.assert_allclose(after.rims[name].center, circle.center, atol=1e-9)


def test_wide_openings_keep_within_their_limits():
    def radius_of(degrees, latitude=-75):
        holes = left_heart_holes(LV_aortic=at(latitude, 30))
        holes = ConformalHoles(holes.directions, {**holes.radii, "LV.aortic": np.radians(degrees)})
        (sphere,) = lay_out([[left_heart_outline()]], [[holes]]).spheres
        return np.degrees(sphere.rims["LV.aortic"].radius)

    np.testing.assert_allclose(
        [radius_of(d) for d in (0.1, 3.0, 6.0, 12.0, 30.0)], [3.5, 3.5, 6.0, 12.0, 15.0]
    )
    # At 24 degrees from the seam a quarter is left for the radius, three for the gap.
    np.testing.assert_allclose(radius_of(12.0, latitude=-24), 6.0)


def test_explicit_circles_are_used_verbatim_and_the_others_keep_clear_of_them():
    center = at(52, 25)
    circles = {"LA.RSPV": CircleSetting(2.0 * center, 6.0, 30.0)}
    (sphere,) = lay_out([[left_heart_outline()]], [[left_heart_holes()]], circles=circles).spheres
    np.testing.assert_allclose(sphere.rims["LA.RSPV"].center, center, atol=1e-15)
    np.testing.assert_allclose(sphere.rims["LA.RSPV"].radius, np.radians(6.0))
    np.testing.assert_allclose(sphere.rims["LA.RSPV"].phase, np.radians(30.0))
    assert min(gaps(sphere).values()) > 1.0 - 1e-6


def test_a_fully_explicit_domain_needs_no_hole_positions():
    holes = left_heart_holes()
    circles = {n: CircleSetting(c, 4.0) for n, c in holes.directions.items()}
    (sphere,) = lay_out([[left_heart_outline()]], [[]], circles=circles).spheres
    for name, center in holes.directions.items():
        np.testing.assert_allclose(sphere.rims[name].center, center, atol=1e-15)


def test_automatic_circles_turn_with_the_explicit_ones():
    """Explicit centres in a frame turned about the pole: the others follow."""
    turn = Rotation.from_rotvec([0.0, 0.0, 1.1])
    holes = left_heart_holes()
    circles = {
        name: CircleSetting(turn.apply(np.array(holes.directions[name])), 4.0) for name in VEINS[:2]
    }
    (sphere,) = lay_out([[left_heart_outline()]], [[holes]], circles=circles).spheres
    for name, center in holes.directions.items():
        np.testing.assert_allclose(
            sphere.rims[name].center, turn.apply(np.array(center)), atol=1e-9
        )


def test_an_explicit_pole_carries_the_automatic_circles_with_it():
    names = ("A.one", "A.two")
    one = outline(("A",), {"A.pole": 90.0, "A.one": 30.0, "A.two": 30.0})
    holes = ConformalHoles(
        {"A.one": at(-20, 10), "A.two": at(-20, 130)}, dict.fromkeys(names, 0.001)
    )
    circles = {"A.pole": CircleSetting(np.array([1.0, 0.0, 0.0]), 10.0)}
    (sphere,) = lay_out([[one]], [[holes]], circles=circles).spheres
    for name in names:
        np.testing.assert_allclose(
            sphere.rims[name].center @ [1.0, 0.0, 0.0], holes.directions[name][2], atol=1e-9
        )


def test_a_circle_on_the_parts_own_sphere_is_carried_over():
    center = np.array([0.3, 0.2, -0.9])
    circles = {"LV.aortic": CircleSetting(center, 12.0, 20.0, "part")}
    (sphere,) = lay_out([[left_heart_outline()]], [[left_heart_holes()]], circles=circles).spheres
    expected = circle_from_part_sphere(Circle(center, np.radians(12.0), np.radians(20.0)), "first")
    found = sphere.rims["LV.aortic"]
    np.testing.assert_allclose(found.center, expected.center, atol=1e-12)
    np.testing.assert_allclose([found.radius, found.phase], [expected.radius, expected.phase])


def test_overlapping_explicit_circles_are_refused():
    holes = left_heart_holes()
    circles = {n: CircleSetting(c, 4.0) for n, c in holes.directions.items()}
    circles["LA.RIPV"] = CircleSetting(at(55, 24), 4.0)
    with pytest.raises(
        InputError, match=r"circles LA\.RSPV and LA\.RIPV: .*at least 3 degrees, found 5\.71 of ov"
    ):
        lay_out([[left_heart_outline()]], [[holes]], circles=circles)


def test_explicit_circles_across_the_seam_are_refused():
    circles = {"LV.aortic": CircleSetting(at(-10, 30), 9.0)}
    with pytest.raises(
        InputError, match=r"LV\.aortic and LV\.mitral: .*on LV's side, found 1: move them"
    ):
        lay_out([[left_heart_outline()]], [[left_heart_holes()]], circles=circles)
    circles = {"LV.aortic": CircleSetting(at(30, 30), 4.0)}
    with pytest.raises(InputError, match=r"on LV's side, found 34 of overlap"):
        lay_out([[left_heart_outline()]], [[left_heart_holes()]], circles=circles)


def test_the_pole_of_one_part_is_about_the_north_with_its_share_of_area():
    one = outline(("LA",), {"LA.mitral": 90.0, **dict.fromkeys(VEINS, 40.0)})
    holes = left_heart_holes()
    holes = ConformalHoles(
        {n: holes.directions[n] * [1, 1, -1] for n in VEINS}, dict.fromkeys(VEINS, 0.001)
    )
    (sphere,) = lay_out([[one]], [[holes]]).spheres
    assert sphere.pole == "LA.mitral"
    np.testing.assert_allclose(sphere.rims["LA.mitral"].center, [0.0, 0.0, 1.0])
    disc = 90.0**2 / (4 * np.pi)
    share = disc / (10_000.0 + disc)
    expected = np.arccos(1 - 2 * share)
    assert np.radians(15.0) < expected
    np.testing.assert_allclose(sphere.rims["LA.mitral"].radius, np.radians(15.0))
    small = outline(("LA",), {"LA.mitral": 30.0, **dict.fromkeys(VEINS, 20.0)})
    disc = 30.0**2 / (4 * np.pi)
    np.testing.assert_allclose(
        pole_circle([small], "LA.mitral").radius, np.arccos(1 - 2 * disc / (10_000.0 + disc))
    )


def test_the_pole_is_the_study_s_choice_then_the_seam_then_the_longest_rim():
    assert chosen_pole([left_heart_outline()]) == "LV.mitral"
    assert chosen_pole([left_heart_outline()], "LA.RSPV") == "LA.RSPV"
    assert chosen_pole([left_heart_outline()], "RA.tricuspid") == "LV.mitral"
    rims = [outline(("A",), {"A.x": 30.0, "A.y": y}) for y in (20.0, 50.0)]
    assert chosen_pole(rims) == "A.y"
    assert chosen_pole([outline(("A",), ())]) is None


def test_closed_and_one_opening_parts_are_laid_out():
    closed, cup = outline(("B",), ()), outline(("C",), ("C.rim",))
    domain = lay_out([[closed], [cup]], [[ConformalHoles({}, {})], [ConformalHoles({}, {})]])
    assert dict(domain.spheres[0].rims) == {}
    assert domain.spheres[0].pole is None
    np.testing.assert_allclose(domain.spheres[1].rims["C.rim"].center, [0.0, 0.0, 1.0])


def test_a_further_seam_holds_its_part_inside_its_circle():
    seam = Seam("B.c", "C.b")
    sphere = chain(seam)
    circle, rim = sphere.seams[seam], sphere.rims["C.rim"]
    assert angle(circle.center, rim.center) + rim.radius < circle.radius
    outer = sphere.rims["B.rim"]
    assert angle(circle.center, outer.center) - outer.radius > circle.radius
    # C and B share the northern hemisphere: half of its area each.
    np.testing.assert_allclose(circle.radius, np.radians(50.0))


def test_a_further_seam_written_the_other_way_is_the_same_circle_seen_from_its_other_side():
    forward, backward = Seam("B.c", "C.b"), Seam("C.b", "B.c")
    one, other = chain(forward), chain(backward)
    np.testing.assert_allclose(other.seams[backward].center, -one.seams[forward].center, atol=1e-6)
    np.testing.assert_allclose(
        other.seams[backward].radius, np.pi - one.seams[forward].radius, atol=1e-9
    )


def test_an_explicit_further_seam_is_used_verbatim():
    seam = Seam("B.c", "C.b")
    sphere = chain(seam, **{"C.b": CircleSetting(at(50, 15), 30.0)})
    np.testing.assert_allclose(sphere.seams[seam].center, at(50, 15), atol=1e-15)
    np.testing.assert_allclose(sphere.seams[seam].radius, np.radians(30.0))
    backward = Seam("C.b", "B.c")
    sphere = chain(backward, **{"C.b": CircleSetting(-at(50, 15), 150.0)})
    np.testing.assert_allclose(sphere.seams[backward].center, -at(50, 15), atol=1e-15)
    np.testing.assert_allclose(sphere.seams[backward].radius, np.radians(150.0))


def test_a_seam_of_a_part_with_itself_is_a_pair_of_equal_circles():
    handle = Seam("A.left", "A.right")
    one = outline(("A",), {"A.pole": 60.0}, (handle,))
    holes = ConformalHoles(
        {"A.left": at(0, 0), "A.right": at(0, 90)}, {"A.left": 0.1, "A.right": 0.2}
    )
    (sphere,) = lay_out([[one]], [[holes]]).spheres
    assert sphere.handles == (handle,)
    assert sphere.rims["A.left"].radius == sphere.rims["A.right"].radius
    assert dict(sphere.seams) == {}


def test_seams_in_a_cycle_are_refused():
    seams = (Seam("A.b", "B.a"), Seam("B.c", "C.b"), Seam("C.a", "A.c"))
    one = outline(("A", "B", "C"), (), seams)
    with pytest.raises(TopologyError, match="do not form a cycle"):
        lay_out([[one]], [[ConformalHoles({}, {})]])
    with pytest.raises(TopologyError, match="none that leads to D"):
        lay_out([[outline(("A", "B", "D"), (), seams[:1])]], [[ConformalHoles({}, {})]])


def test_outlines_hold_perimeters_and_areas():
    vertices, faces = holed_sphere(4000, [((0.0, 0.0, 1.0), np.pi / 3, 90)])
    rim = np.flatnonzero(np.abs(vertices[:, 2] - 0.5) < 1e-9)
    rim = rim[np.argsort(-np.arctan2(vertices[rim, 1], vertices[rim, 0]))]
    component = Component(
        "A", ("A",), 10.0 * vertices, faces, np.zeros(len(faces), int), {"A.rim": rim}, {}
    )
    found = outlined(component)
    np.testing.assert_allclose(found.rims["A.rim"], 20 * np.pi * np.sin(np.pi / 3), rtol=1e-3)
    np.testing.assert_allclose(found.areas["A"], 300 * np.pi, rtol=5e-3)
