"""Correspondences made elsewhere that are not what they seem."""

import json

import numpy as np
import pytest

from ostiform.errors import InputError
from ostiform.pipeline.adopt import adopt_shapes
from ostiform.pipeline.adopt_sources import SourceSettings, read_source
from ostiform.surface import write_surface
from tests.oracles.holed_spheres import holed_sphere


def write_shapes(folder, directions, faces, turned, change):
    for k in range(6):
        u = directions * change if k in turned else directions
        rates = np.random.default_rng(k).normal(1.0, 0.08, 3)
        points = u * [20.0, 9.0, 6.0] * rates
        points[:, 1:] *= (1.0 + 0.4 * np.clip(u[:, :1], 0, None)) ** 2
        write_surface(folder / f"p{k}.vtp", points, faces)


@pytest.mark.parametrize("holes", [[], [((0.0, 0.0, 1.0), 0.4, 12)]])
def test_shapes_whose_order_is_mirrored_are_refused_by_name(tmp_path, holes):
    directions, faces = holed_sphere(150, holes)
    write_shapes(tmp_path / "a", directions, faces, (2, 4), [1, -1, 1])
    with pytest.raises(InputError, match=r"2 of 6 inside out \(p2/0, p4/0\)"):
        adopt_shapes(tmp_path / "a", tmp_path / "out", SourceSettings())
    assert not (tmp_path / "out").exists()


def test_shapes_whose_order_is_turned_are_told_by_their_folds(tmp_path):
    directions, faces = holed_sphere(150, [])
    write_shapes(tmp_path / "good", directions, faces, (), [1, 1, 1])
    good = adopt_shapes(tmp_path / "good", tmp_path / "out", SourceSettings())
    assert not any("folded" in note for note in good.notes)


def test_excluded_subjects_stay_out_and_groups_become_covariates(tmp_path, rng):
    rows = []
    for k in range(5):
        name = f"points/p{k}_local.particles"
        (tmp_path / "points").mkdir(exist_ok=True)
        np.savetxt(tmp_path / name, rng.normal(size=(20, 3)))
        rows.append(
            {
                "name": f"p{k}",
                "local_particles_1": name.replace("/", "\\"),
                "group_sex": "f" if k % 2 else "m",
                "excluded": "true" if k == 3 else "false",
            }
        )
    project = tmp_path / "a.swproj"
    project.write_text(json.dumps({"data": rows}), encoding="utf-8")
    found = read_source(project, SourceSettings())
    assert [id.subject for id in found.ids] == ["p0", "p1", "p2", "p4"]
    assert "left out 1 excluded subject" in found.notes
    adopt_shapes(project, tmp_path / "out", SourceSettings())
    lines = (tmp_path / "out" / "covariates.csv").read_text(encoding="utf-8").splitlines()
    assert lines == ["subject,phase,sex", "p0,0,m", "p1,0,f", "p2,0,m", "p4,0,m"]
    project.write_text(json.dumps({"data": [r | {"excluded": "true"} for r in rows]}))
    with pytest.raises(InputError, match="found all 5 excluded"):
        read_source(project, SourceSettings())
