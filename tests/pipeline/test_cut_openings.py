"""Openings that are cuts end at one place in every shape of a study, added ones included."""

from dataclasses import replace

import numpy as np
import pytest

from ostiform.errors import InputError
from ostiform.execution import Workers
from ostiform.pipeline.events import Note
from ostiform.pipeline.ingest import ingest_shapes, name_shapes
from ostiform.pipeline.prepare import prepared_shapes
from ostiform.pipeline.prepared import read_prepared, shape_artifact
from ostiform.pipeline.run import Run
from ostiform.pipeline.store import Store
from ostiform.pipeline.tube_ends import known_tube_ends, tube_ends, with_tube_ends
from ostiform.study import read_study
from ostiform.surface import Surface, write_surface
from tests.surface.test_tube_ends import FOOT, tube_on_ball

STUDY = """
schema = 1
[parts.B]
ostia = [{ostia}]
cuts = [{cuts}]
[shapes]
pattern = "{{subject}}.vtp"
{points}
"""
TWO_ENDS = """
[ostia.points]
"B.root" = [0, 0, 0]
"B.vein" = [46, 0, 0]
"""
ENDS = {"S1": (9.0, 0.0), "S2": (13.0, 2.5), "S3": (20.0, -4.0)}


def run_of(folder, surfaces, ostia='"vein"', cuts='"vein"', points=""):
    """Return the run of a study of surfaces, and the events it tells."""
    told = []
    for name, surface in surfaces.items():
        write_surface(folder / f"{name}.vtp", surface.vertices, surface.faces)
    (folder / "study.toml").write_text(STUDY.format(ostia=ostia, cuts=cuts, points=points))
    store = Store(folder / "out")
    return Run(read_study(folder / "study.toml"), store, Workers(1), told.append), told


def prepared(run):
    named = name_shapes(run, ingest_shapes(run))
    found, failures = prepared_shapes(run, named, tube_ends(run, named))
    assert not failures
    return [read_prepared(run.store.path(shape_artifact(ready.name))) for ready, _ in found]


def rim_places(shapes):
    rims = [one.shape.parts["B"] for one in shapes]
    return [rim.vertices[rim.loops["vein"]][:, 0].mean() for rim in rims]


def test_all_tubes_end_where_the_shortest_does(tmp_path):
    run, told = run_of(tmp_path, {k: tube_on_ball(*end) for k, end in ENDS.items()})
    shapes = prepared(run)
    places = rim_places(shapes)
    assert np.ptp(places) < 0.3
    assert FOOT + 7.0 < places[0] < FOOT + 9.0
    assert [event.text for event in told if isinstance(event, Note)][0].startswith("B.vein: cut ")
    assert all(" mm shorter, " in one.shape.repairs[-1] for one in shapes)


def test_a_tube_that_hardly_leaves_the_body_keeps_its_rim_and_says_so(tmp_path):
    surfaces = {k: tube_on_ball(*end) for k, end in ENDS.items()} | {"S4": tube_on_ball(1.6)}
    run, _ = run_of(tmp_path, surfaces)
    *others, stump = prepared(run)
    end = known_tube_ends(run.store)["B.vein"]
    assert end.level == pytest.approx(0.35 * end.radius)
    assert "its own rim is taken" in stump.shape.repairs[-1]
    assert rim_places([stump])[0] == pytest.approx(FOOT + 1.6)
    assert np.ptp(rim_places(others)) < 0.3


def test_further_shapes_are_cut_where_the_model_is(tmp_path):
    run, _ = run_of(tmp_path, {k: tube_on_ball(*end) for k, end in ENDS.items()})
    before = prepared(run)
    later = replace(before[0].shape, parts={"B": tube_on_ball(24.0, 3.0)})
    cut = with_tube_ends(run.study.settings, later, known_tube_ends(run.store))
    surface = cut.parts["B"]
    place = surface.vertices[surface.loops["vein"]][:, 0].mean()
    assert place == pytest.approx(np.mean(rim_places(before)), abs=0.3)


def test_a_vessel_without_a_body_is_measured_from_its_other_opening(tmp_path):
    run, _ = run_of(
        tmp_path, {"S1": vessel(40.0), "S2": vessel(52.0)}, '"root", "vein"', points=TWO_ENDS
    )
    ends = [one.shape.parts["B"] for one in prepared(run)]
    assert known_tube_ends(run.store)["B.vein"].measured == "rims"
    lengths = [np.ptp(surface.vertices[:, 0]) for surface in ends]
    np.testing.assert_allclose(lengths, 40.0 - 0.1 * 5.0, atol=0.4)


def test_a_vessel_of_cuts_alone_is_refused(tmp_path):
    surfaces = {"S1": vessel(40.0), "S2": vessel(52.0)}
    run, _ = run_of(tmp_path, surfaces, '"root", "vein"', '"root", "vein"', TWO_ENDS)
    with pytest.raises(InputError, match="B.root: expected a part with a body wider than .* mm"):
        prepared(run)


@pytest.mark.parametrize("cuts", ['"artery"', '"vein", "artery"'])
def test_cuts_are_ostia(tmp_path, cuts):
    with pytest.raises(InputError, match=r"parts.B.cuts: expected ostia of B, found .?artery"):
        run_of(tmp_path, {"S1": tube_on_ball(9.0)}, cuts=cuts)


def vessel(length: float) -> Surface:
    """Return a tube of radius 5 mm along x, its root wider, open at both ends."""
    steps, turns = int(length / 1.3), 30
    around = 2.0 * np.pi * np.arange(turns) / turns
    along = length * np.arange(steps + 1) / steps
    radius = 5.0 + np.exp(-along / 3.0)
    vertices = np.stack(
        [
            np.repeat(along[:, None], turns, axis=1),
            radius[:, None] * np.cos(around),
            radius[:, None] * np.sin(around),
        ],
        axis=-1,
    ).reshape(-1, 3)
    ring = np.arange(len(vertices)).reshape(-1, turns)
    a, b = ring[:-1], np.roll(ring, -1, axis=1)[:-1]
    c, d = np.roll(ring, -1, axis=1)[1:], ring[1:]
    faces = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], axis=2).reshape(-1, 3)
    return Surface(vertices, faces, {})
