"""The embedding of components: certified, invariant, joint across seams."""

import importlib
from dataclasses import replace

import numpy as np
import pytest

from ostiform.domain import Sphere, lay_out, outlined
from ostiform.embedding import EmbeddingSettings, certify, conformal_holes, embed
from ostiform.embedding.start import starting_map
from ostiform.embedding.untangle import Untangled
from ostiform.errors import EmbeddingError, InputError
from ostiform.surface import Component, Seam
from ostiform.surface.hygiene import cleaned_for_embedding
from tests.oracles.implicit_atria import (
    atrium,
    joined_component,
    left_heart,
    opened_component,
    ventricle,
)
from tests.oracles.spherical_domains import SEAM, circle, domain_of_circles

POSE = np.eye(4)
DRIVER = importlib.import_module(
    "ostiform.embedding.embed_component"
)  # the package exports a function


def laid_out(component: Component, pole: str | None = "LA.mitral") -> Sphere:
    holes = conformal_holes(component, pole, POSE)
    return lay_out([[outlined(component)]], [[holes]], pole).spheres[0]


def embedded(component, pole="LA.mitral", settings=None, pose=POSE):
    component, _ = cleaned_for_embedding(component)
    return embed(component, laid_out(component, pole), settings, pose)


def moved(component: Component, rotation=POSE[:3, :3], shift=0.0, scale=1.0) -> Component:
    return replace(component, vertices=scale * component.vertices @ rotation.T + shift)


def rotation_about(axis, angle):
    axis = np.asarray(axis, float) / np.linalg.norm(axis)
    cross = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


@pytest.fixture(scope="module")
def small_atrium():
    return opened_component(atrium(4.0), 2.8, relax=6)


@pytest.fixture(scope="module")
def heart():
    component = joined_component(left_heart(np.random.default_rng(3)), 2.8, relax=8)
    return cleaned_for_embedding(component)[0]


@pytest.fixture(scope="module")
def heart_map(heart):
    return embed(heart, laid_out(heart, "LV.mitral"), None, POSE)


@pytest.mark.parametrize(("length", "relax"), [(4.0, 6), (8.0, 6), (8.0, 0)])
def test_atria_with_long_veins_raw_or_regular_are_embedded(length, relax):
    embedding = embedded(opened_component(atrium(length), 3.0, relax=relax))
    assert embedding.certificate.problems == ()
    assert embedding.certificate.flipped == embedding.certificate.degenerate == 0
    assert embedding.certificate.area_defect < 1e-9
    assert embedding.certificate.rim_error < 1e-12
    assert all(abs(twist) < np.pi for twist in embedding.certificate.twist.values())
    assert embedding.distortion.angle_mean < 0.55 * length + 0.5
    names = [state.name for state in embedding.states]
    assert names == ["tutte", "opened", "arc-length", "untangled", "conformal"]
    assert [state.flipped for state in embedding.states][0] == 0
    np.testing.assert_array_equal(embedding.states[-1].directions, embedding.directions)


def test_a_ventricle_is_embedded_nearly_conformally():
    component = opened_component(ventricle(), 4.0, "LV", relax=6)
    embedding = embedded(component, "LV.mitral")
    assert embedding.certificate.is_valid
    assert embedding.distortion.angle_median < 1.35


@pytest.mark.parametrize("seed", range(5))
def test_random_atria_are_embedded(seed):
    rng = np.random.default_rng(100 + seed)
    body = atrium(rng.uniform(3, 9), int(rng.integers(2, 7)), rng)
    embedding = embedded(opened_component(body, 2.8, relax=6 if seed % 2 else 0))
    assert embedding.certificate.problems == ()


@pytest.mark.long
@pytest.mark.parametrize("relax", [0, 8])
@pytest.mark.parametrize("seed", range(30))
def test_many_random_atria_are_embedded(seed, relax):
    rng = np.random.default_rng(seed)
    body = atrium(rng.uniform(3, 12), int(rng.integers(1, 7)), rng)
    try:
        component = opened_component(body, 2.0, relax=relax)
    except AssertionError:
        pytest.skip("the cuts of this body run into each other")
    embedding = embedded(component, max(component.rims, key=lambda n: len(component.rims[n])))
    assert embedding.certificate.problems == ()


@pytest.mark.long
def test_every_usable_real_surface_is_embedded(shared_data):
    from tests.oracles.real_surfaces import left_atrium, left_heart_template, ventricle_phase

    components = [left_atrium(shared_data, number) for number in (1, 2, 4, 6)]
    components += [left_heart_template(shared_data), ventricle_phase(shared_data, 8)]
    for component in components:
        pole = max(component.rims, key=lambda n: len(component.rims[n]))
        assert embedded(component, pole).certificate.problems == ()


def test_a_real_atrium_is_embedded(shared_data):
    from tests.oracles.real_surfaces import left_atrium

    embedding = embedded(left_atrium(shared_data, 2), "LA.0")
    assert embedding.certificate.problems == ()
    assert embedding.distortion.angle_mean < 2.0


def test_the_map_ignores_position_and_unit(small_atrium):
    first = embedded(small_atrium)
    turn = rotation_about([1, 2, 3], 0.7)
    for change in ({"scale": 10.0}, {"shift": np.array([100.0, -50, 20])}):
        again = embedded(moved(small_atrium, **change))
        np.testing.assert_allclose(again.directions, first.directions, atol=2e-3)
    pose = np.eye(4)
    pose[:3, :3] = turn.T
    component, _ = cleaned_for_embedding(moved(small_atrium, turn))
    again = embed(component, laid_out(cleaned_for_embedding(small_atrium)[0]), None, pose)
    np.testing.assert_allclose(again.directions, first.directions, atol=2e-3)


def test_the_map_ignores_where_loops_start(small_atrium):
    first = embedded(small_atrium)
    rolled = {name: np.roll(rim, 5) for name, rim in small_atrium.rims.items()}
    again = embedded(replace(small_atrium, rims=rolled))
    # the minimum is the same; the Newton iteration stops within 1e-4 of its energy
    difference = np.linalg.norm(again.directions - first.directions, axis=1)
    assert np.sqrt(np.mean(difference**2)) < 0.02
    for name, curve in first.curves.items():
        assert again.curves[name].first_angle != pytest.approx(curve.first_angle, abs=1e-3)


def test_the_map_is_the_same_every_time(small_atrium):
    np.testing.assert_array_equal(
        embedded(small_atrium).directions, embedded(small_atrium).directions
    )


def test_a_domain_is_mapped_back_to_itself():
    rims = {"A.p": circle(0, 0, 20), "A.q": circle(90, 0, 8), "A.r": circle(110, 130, 6)}
    component, sphere, identity = domain_of_circles(rims, pole="A.p")
    embedding = embed(component, sphere, None, POSE)
    assert embedding.certificate.is_valid
    error = np.linalg.norm(embedding.directions - identity, axis=1)
    assert np.median(error) < 0.02
    np.testing.assert_allclose(embedding.distortion.angle_mean, 1.0, atol=0.05)


def test_one_opening_is_turned_by_the_pose(small_atrium):
    body = atrium(4.0)
    tubes = tuple(replace(tube, is_open=tube.name == "mitral") for tube in body.tubes)
    component = opened_component(replace(body, tubes=tubes), 3.0, relax=6)
    first = embedded(component)
    turn = rotation_about([1, 0, 2], 1.1)
    pose = np.eye(4)
    pose[:3, :3] = turn.T
    again = embedded(moved(component, turn), pose=pose)
    assert first.certificate.is_valid
    assert again.certificate.is_valid
    # the rotation about the pole is free: the pose must fix it
    np.testing.assert_allclose(again.directions, first.directions, atol=0.05)


@pytest.mark.parametrize("axis", [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
def test_shapes_with_one_opening_are_turned_alike_though_it_looks_down(axis):
    """Their widths across the axis change places: positions seen from above would mislead."""
    body = atrium(4.0)
    tubes = tuple(replace(tube, is_open=tube.name == "mitral") for tube in body.tubes)
    component = opened_component(replace(body, tubes=tubes), 3.0, relax=6)
    pose = np.eye(4)
    pose[:3, :3] = rotation_about(axis, np.pi)
    wide, deep = (
        replace(component, vertices=component.vertices * widths)
        for widths in ([1.25, 0.8, 1.0], [0.8, 1.25, 1.0])
    )
    holes = [conformal_holes(one, "LA.mitral", pose) for one in (wide, deep)]
    (sphere,) = lay_out([[outlined(wide), outlined(deep)]], [holes], "LA.mitral").spheres
    first, second = (embed(one, sphere, None, pose).directions for one in (wide, deep))
    apart = np.degrees(np.arccos(np.clip((first * second).sum(axis=1), -1.0, 1.0)))
    assert np.median(apart) < 20.0


def test_a_closed_surface_is_turned_by_the_pose():
    body = atrium(3.0)
    tubes = tuple(replace(tube, is_open=False) for tube in body.tubes)
    component = opened_component(replace(body, tubes=tubes), 3.0, relax=6)
    first = embedded(component, None)
    assert first.certificate.is_valid
    assert [s.name for s in first.states] == ["tutte", "untangled", "conformal"]
    assert conformal_holes(component, None, POSE).directions == {}
    turn = rotation_about([1, -1, 2], 2.0)
    again = embedded(moved(component, turn), None)
    np.testing.assert_allclose(again.directions, first.directions @ turn.T, atol=0.05)


def test_a_joint_map_is_smooth_across_its_seam(heart, heart_map):
    assert heart_map.certificate.problems == ()
    jump = next(iter(heart_map.distortion.seam_jump.values()))
    assert jump.mean <= max(0.2, 1.5 * jump.floor_mean)
    (curve,) = heart.seams.values()
    np.testing.assert_array_equal(heart_map.directions[curve, 2], 0.0)
    assert [s.name for s in heart_map.states][-2:] == ["joint", "conformal"]


def test_a_joint_map_has_its_parts_on_their_sides(heart, heart_map):
    middles = heart_map.directions[heart.faces].mean(axis=1)
    second = heart.parts.index("LA")
    assert (middles[heart.face_part == second, 2] > 0).all()
    assert (middles[heart.face_part != second, 2] < 0).all()


def test_two_parts_without_openings_meet_at_their_seam():
    component, sphere, identity = domain_of_circles({}, seam=circle(0, 0, 90), pole=SEAM.first)
    embedding = embed(component, sphere, None, POSE)
    assert embedding.certificate.problems == ()
    assert np.median(np.linalg.norm(embedding.directions - identity, axis=1)) < 0.1


def test_a_second_seam_lies_in_its_part(heart, heart_map):
    # cut a part off the atrium: the fans around a vertex far from all rims
    component = with_cap(heart)
    seams = tuple(component.seams)
    assert len(seams) == 2
    sphere = laid_out(component, "LV.mitral")
    embedding = embed(component, sphere, None, POSE)
    assert embedding.certificate.problems == ()
    inner = sphere.seams[seams[1]]
    cap = component.faces[component.face_part == 2]
    middles = embedding.directions[cap].mean(axis=1)
    middles /= np.linalg.norm(middles, axis=1, keepdims=True)
    assert (np.arccos(np.clip(middles @ inner.center, -1, 1)) < inner.radius).all()


def with_cap(component: Component) -> Component:
    """The component with a disc of the atrium as a third part, joined by a seam."""
    on_curve = np.zeros(len(component.vertices), dtype=bool)
    for curve in (*component.rims.values(), *component.seams.values()):
        on_curve[curve] = True
    border = component.vertices[on_curve]
    far = np.linalg.norm(component.vertices[:, None] - border[None], axis=2).min(axis=1)
    atrial = np.unique(component.faces[component.face_part == 1])
    center = component.vertices[atrial[np.argmax(far[atrial])]]
    near = np.linalg.norm(component.vertices - center, axis=1) < 0.6 * far[atrial].max()
    inside = near[component.faces].all(axis=1)
    part = np.where(inside, 2, component.face_part)
    from ostiform.surface import boundary_loops

    (curve,) = boundary_loops(component.faces[inside])
    seams = {**component.seams, Seam("LA.cap", "CAP.base"): curve}
    return cleaned_for_embedding(
        replace(
            component,
            name="LV+LA+CAP",
            parts=("LV", "LA", "CAP"),
            face_part=part,
            seams=seams,
        )
    )[0]


def test_the_harmonic_barrier_cannot_fold(small_atrium):
    embedding = embedded(small_atrium, settings=EmbeddingSettings("harmonic-barrier"))
    assert embedding.method == "harmonic-barrier"
    assert embedding.certificate.is_valid


def test_the_plain_harmonic_map_of_long_veins_is_reported_as_folded(small_atrium):
    embedding = embedded(small_atrium, settings=EmbeddingSettings("harmonic"))
    assert embedding.method == "harmonic"
    assert embedding.certificate.flipped > 0
    assert not embedding.certificate.is_valid
    assert embedding.states[-1].name == "harmonic"
    assert max(embedding.distortion.circle_ratio.values()) > 2.0


def test_curves_start_at_the_angles_of_their_first_vertices(heart, heart_map):
    sphere = laid_out(heart, "LV.mitral")
    for name, curve in heart_map.curves.items():
        on_circle = sphere.curves[name]
        loop = heart.rims.get(name, next(iter(heart.seams.values())))
        np.testing.assert_allclose(
            on_circle.points(np.array([curve.first_angle]))[0],
            heart_map.directions[loop[0]],
            atol=1e-9,
        )


def test_the_certificate_is_that_of_the_map(small_atrium):
    component, _ = cleaned_for_embedding(small_atrium)
    sphere = laid_out(component)
    embedding = embed(component, sphere, None, POSE)
    again = certify(component, sphere, embedding.directions)
    assert again.twist == embedding.certificate.twist
    assert again.hole_order == embedding.certificate.hole_order


def test_a_start_that_stays_folded_is_refused(small_atrium):
    # two triangles that share all three vertices in opposite order cannot both be upright
    faces = np.array(small_atrium.faces)
    rim = next(iter(small_atrium.rims.values()))
    inner = faces[~np.isin(faces, rim).any(axis=1)][0]
    faces = np.vstack([faces, inner, inner[::-1]])
    broken = replace(small_atrium, faces=faces, face_part=np.zeros(len(faces), dtype=np.int64))
    with pytest.raises(EmbeddingError, match="without folds"):
        embed(broken, laid_out(small_atrium), None, POSE)


@pytest.mark.parametrize(
    "changes", [{"method": "magic"}, {"tolerance": 0.0}, {"max_iterations": 0}]
)
def test_settings_out_of_range_are_refused(changes):
    with pytest.raises(InputError, match=f"{next(iter(changes)).replace('_', ' ')}: expected"):
        EmbeddingSettings(**changes)


def test_a_pole_that_is_no_opening_is_refused(small_atrium):
    sphere = laid_out(small_atrium)
    with pytest.raises(InputError, match="pole"):
        embed(small_atrium, replace(sphere, pole="LA.nothing"), None, POSE)


def test_a_seam_that_cannot_be_carried_to_its_circle_turns_on_it(heart, monkeypatch):
    def mirrored(component, sphere, directions):
        return directions * np.array([1.0, 1.0, -1.0])

    monkeypatch.setattr(DRIVER, "seams_on_circles", mirrored)
    monkeypatch.setattr(
        DRIVER,
        "untangled",
        lambda directions, faces, is_fixed: Untangled(directions, len(faces), 0),
    )
    embedding = embed(heart, laid_out(heart, "LV.mitral"), None, POSE)
    assert embedding.certificate.problems == ()
    (curve,) = heart.seams.values()
    np.testing.assert_allclose(embedding.directions[curve, 2], 0.0, atol=1e-12)


def test_a_start_that_covers_the_sphere_twice_is_refused(small_atrium, monkeypatch):
    component, _ = cleaned_for_embedding(small_atrium)
    sphere = laid_out(component)
    start = starting_map(component, sphere, POSE)
    assert start.degree == 1
    monkeypatch.setattr(DRIVER, "starting_map", lambda *_: replace(start, degree=2))
    with pytest.raises(EmbeddingError, match="covers it 2 times"):
        embed(component, sphere, None, POSE)


def test_a_closed_surface_whose_start_stays_folded_is_refused(monkeypatch):
    component, sphere, identity = domain_of_circles({}, count=300)
    monkeypatch.setattr(
        DRIVER,
        "untangled",
        lambda directions, faces, is_fixed: Untangled(directions, 3, 0),
    )
    with pytest.raises(EmbeddingError, match="found 3 of"):
        embed(component, sphere, None, POSE)
