"""The demonstration population: anatomy, motion, meshes, files."""

import csv
import tomllib
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np
import pytest

from ostiform.demo.contouring import canonical_points, extract
from ostiform.demo.demonstration import demonstration_truth, write_demonstration
from ostiform.demo.truth import read_truth
from ostiform.errors import InputError, TopologyError
from ostiform.study import read_study
from ostiform.surface import (
    boundary_loops,
    enclosed_volume,
    euler_characteristic,
    is_consistently_oriented,
    non_manifold_edges,
    non_manifold_vertices,
)
from tests.study.single_shapes import read_shape

EDGE_MM = 2.6
OSTIA = {"LV": {"mitral", "aortic"}, "LA": {"mitral", "RSPV", "RIPV", "LSPV", "LIPV"}}
SURFACE_SHARE = 1e-9
"""Distance of vertices from the true surface over the edge; projection ends at round-off."""


@pytest.fixture(scope="module")
def truth():
    return demonstration_truth()


@pytest.fixture(scope="module")
def canonical(truth):
    return canonical_points(truth.anatomy, EDGE_MM)


@pytest.fixture(scope="module")
def cycle(truth, canonical):
    """Meshes of every phase of the first subject and of two phases of the others."""
    shapes = {}
    for index, (shape_id, deformation) in enumerate(truth.deformations.items()):
        if shape_id.subject == "S1" or shape_id.phase in ("00", "03"):
            rng = np.random.default_rng(index)
            shapes[shape_id] = extract(truth.anatomy, deformation, EDGE_MM, rng, canonical)
    return shapes


def _angles(surface):
    corners = surface.vertices[surface.faces]  # (F, 3, 3)
    one, two = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    cosine = (one * two).sum(axis=2) / (np.linalg.norm(one, axis=2) * np.linalg.norm(two, axis=2))
    return np.degrees(np.arccos(cosine))


def test_shapes_are_shared_out_evenly_and_unevenly_timed(truth):
    ids = list(truth.deformations)
    counts = [sum(i.subject == f"S{k}" for i in ids) for k in range(1, 5)]
    assert counts == [9, 9, 8, 8]
    for subject in ("S1", "S2", "S3", "S4"):
        times = np.array([i.time for i in ids if i.subject == subject])
        assert times[0] == 0.0
        assert times.max() < 1.0
        assert np.diff(times).min() > 0.0
        assert np.ptp(np.diff(times)) > 1e-3


def test_every_part_is_a_sphere_with_its_named_openings(cycle):
    for parts in cycle.values():
        assert list(parts) == ["LV", "LA"]
        for part, surface in parts.items():
            assert set(surface.loops) == OSTIA[part]
            assert euler_characteristic(surface.faces) == 2 - len(surface.loops)
            assert len(non_manifold_edges(surface.faces)) == 0
            assert len(non_manifold_vertices(surface.faces)) == 0
            assert len(np.unique(surface.faces)) == len(surface.vertices)


def test_surfaces_face_outward_and_loops_keep_the_surface_on_their_left(cycle):
    for parts in cycle.values():
        for surface in parts.values():
            assert is_consistently_oriented(surface.faces)
            assert enclosed_volume(surface.vertices, surface.faces) > 0.0
            found = {tuple(loop.tolist()) for loop in boundary_loops(surface.faces)}
            assert found == {tuple(loop.tolist()) for loop in surface.loops.values()}


def test_both_sides_of_the_seam_hold_the_same_positions_bit_for_bit(cycle):
    for parts in cycle.values():
        ventricle = parts["LV"].vertices[parts["LV"].loops["mitral"]]
        atrium = parts["LA"].vertices[parts["LA"].loops["mitral"]]
        np.testing.assert_array_equal(np.unique(ventricle, axis=0), np.unique(atrium, axis=0))


def test_vertices_lie_on_the_true_surface_and_rims_on_the_true_cuts(truth, cycle):
    for shape_id, parts in cycle.items():
        for part, surface in parts.items():
            material = truth.deformation(shape_id).inverse(surface.vertices)
            level, _ = truth.anatomy.level(material)
            assert np.abs(level).max() < SURFACE_SHARE * EDGE_MM
            for ostium, _, cut in truth.anatomy.part_cuts(part):
                height, _ = cut.height(material[surface.loops[ostium]])
                assert np.abs(height).max() < SURFACE_SHARE * EDGE_MM


def test_parts_end_at_their_cuts(truth, cycle):
    for shape_id, parts in cycle.items():
        for part, surface in parts.items():
            material = truth.deformation(shape_id).inverse(surface.vertices)
            for _, sign, cut in truth.anatomy.part_cuts(part):
                near = cut.reaches(material)
                height = sign * cut.height(material[near])[0]
                assert height.max() < SURFACE_SHARE * EDGE_MM


def test_triangles_are_near_equilateral(cycle):
    least = np.concatenate(
        [_angles(surface).min(axis=1) for parts in cycle.values() for surface in parts.values()]
    )
    assert least.min() > 10.0  # measured 16.8 over the whole population
    assert np.percentile(least, 1.0) > 30.0  # measured 33.5
    assert np.median(least) > 48.0


def test_the_mean_edge_is_the_one_asked_for(truth, canonical):
    deformation = next(iter(truth.deformations.values()))
    for edge in (2.0, 3.0):
        parts = extract(truth.anatomy, deformation, edge, np.random.default_rng(1), canonical)
        for surface in parts.values():
            corners = surface.vertices[surface.faces]
            lengths = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
            assert 0.93 * edge < lengths.mean() < 1.07 * edge


def test_no_two_shapes_share_vertices(truth, canonical, cycle):
    deformation = next(iter(truth.deformations.values()))
    other = extract(truth.anatomy, deformation, EDGE_MM, np.random.default_rng(99), canonical)
    one = next(iter(cycle.values()))["LA"].vertices
    both = np.concatenate([one, other["LA"].vertices])
    assert len(np.unique(both.round(3), axis=0)) == len(both)


def test_ventricles_eject_and_atria_fill_as_hearts_do(truth, cycle):
    for subject in ("S1", "S2", "S3", "S4"):
        volumes = {
            part: np.array(
                [
                    enclosed_volume(parts[part].vertices, parts[part].faces) / 1000.0
                    for shape_id, parts in cycle.items()
                    if shape_id.subject == subject
                ]
            )
            for part in ("LV", "LA")
        }
        ejection = 1.0 - volumes["LV"].min() / volumes["LV"].max()
        assert 0.5 < ejection < 0.7
        assert 90.0 < volumes["LV"].max() < 200.0  # ml
        assert volumes["LA"].argmax() > volumes["LA"].argmin()
        assert 35.0 < volumes["LA"].min() < volumes["LA"].max() < 130.0
        # Out of phase: the atrium is full when the ventricle is empty.
        assert volumes["LA"][volumes["LV"].argmin()] > 1.2 * volumes["LA"].min()


def test_veins_have_their_sizes(truth, cycle):
    for parts in cycle.values():
        for ostium, low, high in (
            ("RSPV", 10.0, 20.0),
            ("RIPV", 8.0, 18.0),
            ("LSPV", 9.0, 19.0),
            ("LIPV", 7.0, 15.0),
        ):
            rim = parts["LA"].vertices[parts["LA"].loops[ostium]]
            perimeter = np.linalg.norm(np.roll(rim, -1, axis=0) - rim, axis=1).sum()
            assert low < perimeter / np.pi < high  # mm


def test_a_body_too_coarse_for_its_openings_is_refused(truth, canonical):
    deformation = next(iter(truth.deformations.values()))
    with pytest.raises(TopologyError, match="smaller edge"):
        extract(truth.anatomy, deformation, 25.0, np.random.default_rng(0), canonical)


def test_impossible_counts_are_refused(tmp_path):
    with pytest.raises(InputError, match="5 subjects and 4 shapes"):
        write_demonstration(tmp_path, subjects=5, shapes=4)
    with pytest.raises(InputError, match="0 subjects"):
        write_demonstration(tmp_path, subjects=0, shapes=4)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("population")
    return write_demonstration(folder / "one", 2, 3, seed=7, edge_mm=EDGE_MM)


def test_the_files_are_an_ordinary_study(written):
    study = read_study(written)
    assert len(study.entries) == 3
    truth = read_truth(written.parent / "truth" / "truth.json")
    for entry in study.entries:
        shape = read_shape(study, entry)
        assert shape.repairs == ()
        for part, surface in shape.parts.items():
            assert set(surface.loops) == OSTIA[part]
            material = truth.deformation(shape.id).inverse(surface.vertices)
            # Every loop was given its own name: the rough points tell the openings apart.
            for ostium, _, cut in truth.anatomy.part_cuts(part):
                assert np.abs(cut.height(material[surface.loops[ostium]])[0]).max() < 1e-9


def test_the_settings_name_the_truth_and_times_are_in_the_sheet(written):
    settings = tomllib.loads(written.read_text(encoding="utf-8"))
    assert settings["schema"] == 1
    assert settings["units"] == "mm"
    assert settings["frame"] == "LPS"
    assert (written.parent / settings["evaluation"]["truth"]).is_file()
    with (written.parent / "shapes.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    truth = read_truth(written.parent / "truth" / "truth.json")
    assert [float(row["time"]) for row in rows] == [i.time for i in truth.deformations]


def test_the_same_seed_writes_the_same_files(written, tmp_path):
    again = write_demonstration(tmp_path, 2, 3, seed=7, edge_mm=EDGE_MM)
    for path in sorted(written.parent.rglob("*")):
        if path.is_file():
            assert (
                path.read_bytes() == (again.parent / path.relative_to(written.parent)).read_bytes()
            )


def test_shapes_meshed_by_other_processes_give_the_same_files(written, tmp_path):
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        again = write_demonstration(tmp_path, 2, 3, seed=7, edge_mm=EDGE_MM, mapped=pool.map)
    for name in ("study.toml", "shapes.csv", "shapes/S1_01_LA.vtp"):
        assert (again.parent / name).read_bytes() == (written.parent / name).read_bytes()


def test_another_seed_draws_other_hearts(written):
    one = read_truth(written.parent / "truth" / "truth.json")
    other = demonstration_truth(2, 3, seed=8)
    points = np.array([[0.0, 20.0, -40.0]])
    first, second = (next(iter(t.deformations.values())) for t in (one, other))
    assert np.abs(first.forward(points) - second.forward(points)).max() > 0.1
