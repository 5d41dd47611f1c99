"""What the base domain refuses, and its form as JSON."""

import json
from dataclasses import replace

import numpy as np
import pytest

from ostiform.domain import (
    BaseDomain,
    Circle,
    CircleSetting,
    ConformalHoles,
    Sphere,
    check_domain,
    domain_from_json,
    domain_to_json,
    lay_out,
    pole_circle,
)
from ostiform.errors import ArtifactError, InputError
from ostiform.surface import Seam
from tests.oracles.left_heart_domain import (
    MITRAL,
    VEINS,
    at,
    chain,
    left_heart_holes,
    left_heart_outline,
    outline,
)


def test_a_domain_survives_json_bit_for_bit(rng):
    holes = left_heart_holes(rng)
    handle = Seam("B.left", "B.right")
    other = outline(("B",), {"B.pole": 60.0}, (handle,))
    other_holes = ConformalHoles(
        {"B.left": at(0, 0), "B.right": at(0, 90)}, {"B.left": 0.1, "B.right": 0.2}
    )
    other_holes = replace(other_holes, up=np.array([0.6, 0.0, -0.8]))
    domain = lay_out(
        [[left_heart_outline()], [other]],
        [[holes], [other_holes]],
        circles={"LA.RSPV": CircleSetting(phase_deg=12.3)},
    )
    np.testing.assert_allclose(domain.spheres[1].up, [0.6, 0.0, -0.8], atol=1e-12)
    record = json.loads(json.dumps(domain_to_json(domain)))
    back = domain_from_json(record)
    assert domain_to_json(back) == domain_to_json(domain)
    for one, two in zip(domain.spheres, back.spheres, strict=True):
        for name, circle in one.curves.items():
            np.testing.assert_array_equal(two.curves[name].center, circle.center)


def test_a_record_without_up_means_the_north(rng):
    record = domain_to_json(lay_out([[left_heart_outline()]], [[left_heart_holes(rng)]]))
    del record["spheres"][0]["up"]
    np.testing.assert_array_equal(domain_from_json(record).spheres[0].up, [0.0, 0.0, 1.0])


def test_foreign_and_damaged_records_are_refused(rng):
    record = domain_to_json(lay_out([[left_heart_outline()]], [[left_heart_holes(rng)]]))
    with pytest.raises(ArtifactError, match="schema 1, found 7"):
        domain_from_json({**record, "schema": 7})
    with pytest.raises(ArtifactError, match="found None"):
        domain_from_json({})
    for key in ("name", "parts", "rims", "seams", "pole"):
        damaged = json.loads(json.dumps(record))
        del damaged["spheres"][0][key]
        with pytest.raises(ArtifactError, match="damaged"):
            domain_from_json(damaged)
    damaged = json.loads(json.dumps(record))
    damaged["spheres"][0]["rims"]["LA.RSPV"]["center"] = [1.0, 2.0]
    with pytest.raises(ArtifactError, match="damaged"):
        domain_from_json(damaged)


def sphere_with(**rims):
    circles = {name.replace("_", "."): circle for name, circle in rims.items()}
    return Sphere("A", ("A",), circles, {}, None)


def test_check_domain_refuses_what_cannot_be_embedded():
    with pytest.raises(InputError, match="between 0 and 90 degrees, found 95"):
        check_domain(BaseDomain((sphere_with(A_x=Circle(at(0, 0), np.radians(95.0))),)))
    twice = sphere_with(A_x=Circle(at(0, 0), 0.1))
    with pytest.raises(InputError, match=r"every circle once, found A\.x twice"):
        check_domain(BaseDomain((twice, twice)))
    near = sphere_with(A_x=Circle(at(0, 0), 0.1), A_y=Circle(at(0, 13), 0.1))
    with pytest.raises(InputError, match=r"gap of at least 3 degrees, found 1\.54"):
        check_domain(BaseDomain((near,)))
    polar = Sphere("A", ("A",), {}, {}, "A.x")
    with pytest.raises(InputError, match=r"pole of A: expected one of no ostium, found A\.x"):
        check_domain(BaseDomain((polar,)))
    handle = Sphere("A", ("A",), {}, {}, None, (Seam("A.x", "A.y"),))
    with pytest.raises(InputError, match=r"both sides, found none for A\.x"):
        check_domain(BaseDomain((handle,)))


def refused(match, **changes):
    given = {
        "outlines": [[left_heart_outline()]],
        "holes": [[left_heart_holes()]],
        "circles": {},
    } | changes
    with pytest.raises(InputError, match=match):
        lay_out(**given)


def test_unusable_settings_are_refused():
    refused("found LA.LAA", circles={"LA.LAA": CircleSetting(at(0, 0), 3.0)})
    refused("found LA.LAA", pole="LA.LAA")
    refused("not all zero", circles={"LA.RSPV": CircleSetting(np.zeros(3), 3.0)})
    refused("between 0 and 180", circles={"LA.RSPV": CircleSetting(at(40, 0), -3.0)})
    refused("finite phase", circles={"LA.RSPV": CircleSetting(phase_deg=np.nan)})
    refused("to be the equator", circles={"LV.mitral": CircleSetting(at(40, 0), 90.0)})
    refused("give both", circles={"LA.RSPV": CircleSetting(at(-40, 0), frame="part")})


def test_a_seam_is_set_once_and_parts_far_from_the_equator_have_no_sphere_of_their_own():
    one, seam = CircleSetting(at(50, 15), 30.0), Seam("B.c", "C.b")
    with pytest.raises(InputError, match="one setting for the two sides"):
        chain(seam, **{"B.c": one, "C.b": one})
    with pytest.raises(InputError, match="found C: give it on the component sphere"):
        chain(seam, **{"C.rim": CircleSetting(at(50, 15), 3.0, 0.0, "part")})


def test_unusable_populations_are_refused():
    holes = left_heart_holes()
    other = outline(("LV", "LA"), ("LV.aortic", *VEINS[:3]), (MITRAL,))
    refused("different ones", outlines=[[left_heart_outline(), other]])
    refused("at least one shape", outlines=[[]])
    refused("for 1 components, found 2", holes=[[holes], [holes]])
    refused("found neither", holes=[[]])
    short = ConformalHoles({n: at(50, 0) for n in VEINS[1:]}, dict.fromkeys(VEINS[1:], 0.01))
    refused("found none in shape 1 of 2", holes=[[holes, short]])
    opposite = left_heart_holes(LA_RSPV=-holes.directions["LA.RSPV"])
    refused("directions that cancel", holes=[[holes, opposite]])
    with pytest.raises(InputError, match="positive surface area"):
        pole_circle([outline(("A",), ("A.x",), (), {"A": 0.0})], "A.x")
