"""Hygiene: chords, slivers and short rims are planted and must be gone, the rest unchanged."""

import numpy as np
import pytest

from ostiform.errors import TopologyError
from ostiform.surface import (
    Component,
    boundary_loops,
    cleaned_for_embedding,
    euler_characteristic,
    face_areas,
    half_edges,
    is_consistently_oriented,
    unique_edges,
)
from tests.oracles.spherical_domains import SEAM, circle, domain_of_circles, left_atrium, left_heart


def replaced(component, vertices=None, faces=None, face_part=None, rims=None, seams=None):
    return Component(
        component.name,
        component.parts,
        component.vertices if vertices is None else vertices,
        component.faces if faces is None else faces,
        component.face_part if face_part is None else face_part,
        component.rims if rims is None else rims,
        component.seams if seams is None else seams,
    )


def chords(component):
    """Inner edges with both ends on rims or seams that are no edge of them."""
    on_curve = np.zeros(len(component.vertices), bool)
    allowed = set()
    for curve in (*component.rims.values(), *component.seams.values()):
        on_curve[curve] = True
        allowed |= set(map(frozenset, np.stack([curve, np.roll(curve, -1)], 1).tolist()))
    edges = unique_edges(component.faces)[0]
    edges = edges[on_curve[edges].all(axis=1)]
    return [edge for edge in edges.tolist() if frozenset(edge) not in allowed]


def check_consistent(component):
    """Rims are the boundary loops with the surface on the left; seams run along edges."""
    assert is_consistently_oriented(component.faces)
    found = {frozenset(loop.tolist()) for loop in boundary_loops(component.faces)}
    assert found == {frozenset(rim.tolist()) for rim in component.rims.values()}
    directed = set(map(tuple, half_edges(component.faces).tolist()))
    for curve in (*component.rims.values(), *component.seams.values()):
        pairs = set(zip(curve.tolist(), np.roll(curve, -1).tolist(), strict=True))
        assert pairs <= directed
    for curve in component.seams.values():
        pairs = set(zip(np.roll(curve, -1).tolist(), curve.tolist(), strict=True))
        assert pairs <= directed


def with_folded_in_rim_vertices(component, name, every):
    """Shrink the mesh at a rim: remove the fans of some rim vertices, which leaves chords."""
    on_rim = np.zeros(len(component.vertices), bool)
    on_rim[component.rims[name]] = True
    ears = component.rims[name][::every]
    gone = np.isin(component.faces, ears).any(axis=1)
    faces = component.faces[~gone]
    loop = max(
        (
            loop
            for loop in boundary_loops(faces)
            if not any(
                set(loop.tolist()) & set(r.tolist()) for n, r in component.rims.items() if n != name
            )
        ),
        key=len,
    )
    used = np.unique(faces)
    index = np.full(len(component.vertices), -1)
    index[used] = np.arange(len(used))
    rims = {n: index[loop if n == name else rim] for n, rim in component.rims.items()}
    seams = {seam: index[curve] for seam, curve in component.seams.items()}
    return replaced(
        component, component.vertices[used], index[faces], component.face_part[~gone], rims, seams
    )


def test_a_clean_component_is_returned_as_it_is():
    component, _, _ = left_atrium()
    clean = cleaned_for_embedding(component)[0]
    assert not chords(clean)
    again, repairs = cleaned_for_embedding(clean)
    assert again is clean
    assert repairs == ()


def test_chords_at_rims_and_seams_are_split_without_changing_the_surface():
    component, _, _ = left_heart(count=900)
    ragged = with_folded_in_rim_vertices(component, "LV.aortic", 3)
    assert chords(ragged)
    clean, repairs = cleaned_for_embedding(ragged)
    assert not chords(clean)
    check_consistent(clean)
    assert euler_characteristic(clean.faces) == euler_characteristic(ragged.faces)
    assert any("inner edges" in sentence for sentence in repairs)
    np.testing.assert_allclose(clean.vertices[: len(ragged.vertices)], ragged.vertices)
    for part in range(2):
        np.testing.assert_allclose(
            face_areas(clean.vertices, clean.faces[clean.face_part == part]).sum(),
            face_areas(ragged.vertices, ragged.faces[ragged.face_part == part]).sum(),
        )


def with_ears_at_a_seam(component):
    """Cut the fans of some seam vertices off by a chord between their neighbours on the seam."""
    seam, faces = component.seams[SEAM], component.faces.copy()
    planted = 0
    for k in range(1, len(seam) - 1, 3):
        before, here, after = (int(v) for v in seam[k - 1 : k + 2])
        part = (k // 3) % 2
        fan = np.flatnonzero((faces == here).any(axis=1) & (component.face_part == part))
        if len(fan) != 3:
            continue
        if part == 0:  # on the right of the seam everything runs the other way
            before, after = after, before
        following = {}
        for face in faces[fan]:
            _, one, two = np.roll(face, -int(np.flatnonzero(face == here)[0])).tolist()
            following[one] = two
        b = following[after]
        a = following[b]
        faces[fan] = [(before, here, after), (before, after, b), (before, b, a)]
        planted += 1
    return replaced(component, faces=faces), planted


def test_chords_along_a_seam_are_split_on_both_sides():
    ragged, planted = with_ears_at_a_seam(left_heart(count=900)[0])
    assert planted >= 4
    check_consistent(ragged)
    assert len(chords(ragged)) == planted + len(chords(left_heart(count=900)[0]))
    clean, _ = cleaned_for_embedding(ragged)
    assert not chords(clean)
    check_consistent(clean)


def test_a_triangle_between_curves_only_gets_a_vertex_inside():
    # The seam and a rim of an annulus one triangle wide share triangles with three curve vertices.
    around = 10
    angles = 2.0 * np.pi * np.arange(around) / around
    rings = [
        np.stack([r * np.cos(angles), r * np.sin(angles), np.full(around, h)], axis=1)
        for r, h in ((2.0, 0.0), (1.0, 1.0))
    ]
    low, high = np.arange(around), around + np.arange(around)
    faces = np.concatenate(
        [
            np.stack([low, np.roll(low, -1), high], axis=1),
            np.stack([np.roll(low, -1), np.roll(high, -1), high], axis=1),
        ]
    )
    component = Component(
        "A",
        ("A",),
        np.concatenate(rings),
        faces,
        np.zeros(len(faces), np.int64),
        {"A.low": low, "A.high": high[::-1]},
        {},
    )
    clean, repairs = cleaned_for_embedding(component)
    on_curve = np.zeros(len(clean.vertices), bool)
    on_curve[: 2 * around] = True
    assert not on_curve[clean.faces].all(axis=1).any()
    assert not chords(clean)
    check_consistent(clean)
    assert len(repairs) == 1


def test_short_rim_and_seam_edges_are_collapsed():
    component, _, _ = left_heart(count=900)
    vertices = component.vertices.copy()
    short = 0
    for curve in (component.rims["LV.aortic"], component.seams[SEAM]):
        for k in range(1, len(curve) - 1, 7):
            vertices[curve[k]] = vertices[curve[k - 1]] + 0.05 * (
                vertices[curve[k]] - vertices[curve[k - 1]]
            )
            short += 1
    crowded = replaced(component, vertices)
    clean, repairs = cleaned_for_embedding(crowded)
    check_consistent(clean)
    assert euler_characteristic(clean.faces) == euler_characteristic(component.faces)
    assert f"{short} edges of rims and seams below 0.15 of the median edge collapsed" in repairs
    assert len(clean.rims["LV.aortic"]) < len(component.rims["LV.aortic"])
    assert len(clean.seams[SEAM]) < len(component.seams[SEAM])


def test_a_rim_of_three_edges_is_refined_to_eight():
    component, _, _ = left_atrium(count=600)
    face = int(
        np.flatnonzero(
            ~np.isin(component.faces, np.concatenate(list(component.rims.values()))).any(1)
        )[0]
    )
    rims = {**component.rims, "A.tiny": component.faces[face][[0, 2, 1]]}
    holed = replaced(
        component,
        faces=np.delete(component.faces, face, axis=0),
        face_part=component.face_part[1:],
        rims=rims,
    )
    clean, repairs = cleaned_for_embedding(holed)
    assert len(clean.rims["A.tiny"]) == 8
    assert not chords(clean)
    check_consistent(clean)
    assert any("fewer than 8 edges" in sentence for sentence in repairs)
    again, more = cleaned_for_embedding(clean)
    assert again is clean
    assert more == ()


def test_triangles_without_area_are_removed():
    component, _, _ = left_heart(count=900)
    curves = np.concatenate([*component.rims.values(), *component.seams.values()])
    inner = np.flatnonzero(~np.isin(component.faces, curves).any(axis=1))
    vertices = component.vertices.copy()
    cap, needle = component.faces[inner[3]], component.faces[inner[-3]]
    vertices[cap[0]] = 0.5 * (vertices[cap[1]] + vertices[cap[2]])
    vertices[needle[0]] = vertices[needle[1]]
    clean, repairs = cleaned_for_embedding(replaced(component, vertices))
    check_consistent(clean)
    assert euler_characteristic(clean.faces) == euler_characteristic(component.faces)
    assert "0 triangles left" in repairs[0]
    corners = clean.vertices[clean.faces]
    longest = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).max(axis=1)
    assert (face_areas(clean.vertices, clean.faces) > 1e-4 * longest**2 / 2).all()


def test_repairs_do_not_depend_on_the_unit_of_length():
    component, _, _ = left_heart(count=900)
    ragged = with_folded_in_rim_vertices(component, "LV.aortic", 3)
    small = cleaned_for_embedding(ragged)
    large = cleaned_for_embedding(replaced(ragged, 1000.0 * ragged.vertices))
    assert small[1] == large[1]
    np.testing.assert_array_equal(small[0].faces, large[0].faces)
    np.testing.assert_allclose(large[0].vertices, 1000.0 * small[0].vertices)


def test_curves_that_touch_are_refused():
    component, _, _ = left_atrium(count=600)
    rims = dict(component.rims)
    rims["A.b"] = np.concatenate([rims["A.b"], rims["A.a"][:1]])
    with pytest.raises(TopologyError, match="1 vertices visited more than once"):
        cleaned_for_embedding(replaced(component, rims=rims))


def test_real_atria_keep_their_topology(shared_data):
    pyvista = pytest.importorskip("pyvista")
    for number in (1, 3):
        grid = pyvista.read(shared_data / "left-atria" / f"LA_with_fibers_{number}.vtk")
        faces = np.asarray(grid.cells, dtype=np.int64).reshape(-1, 4)[:, 1:]
        used, index = np.unique(faces, return_inverse=True)
        faces = index.reshape(-1, 3)
        loops = {f"LA.{k}": loop for k, loop in enumerate(boundary_loops(faces))}
        component = Component(
            "LA",
            ("LA",),
            np.asarray(grid.points, dtype=np.float64)[used],
            faces,
            np.zeros(len(faces), np.int64),
            loops,
            {},
        )
        clean, repairs = cleaned_for_embedding(component)
        check_consistent(clean)
        assert not chords(clean)
        assert repairs
        assert euler_characteristic(clean.faces) == euler_characteristic(faces)


def test_a_cap_of_one_narrow_opening_keeps_its_rim():
    component, _, _ = domain_of_circles({"A.only": circle(30, 40, 3)}, count=800)
    clean, _ = cleaned_for_embedding(component)
    check_consistent(clean)
    assert len(clean.rims["A.only"]) == 8
