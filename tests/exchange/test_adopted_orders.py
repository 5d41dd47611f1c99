"""Correspondences made elsewhere that are not what they seem."""

import json

import numpy as np
import pytest

from ostiform.errors import InputError
from ostiform.pipeline.adopt import adopt_shapes
from ostiform.pipeline.adopt_sources import SourceSettings, read_source
from ostiform.pipeline.carried_fields import read_fields
from ostiform.pipeline.store import Store
from ostiform.study import stated_fields
from ostiform.surface import read_mesh, write_surface
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
    with pytest.raises(InputError, match=r"2 of 6 inside out \(p2, p4\)"):
        adopt_shapes(tmp_path / "a", tmp_path / "out", SourceSettings())
    assert not (tmp_path / "out").exists()


def test_much_area_that_is_folded_against_the_mean_is_told_of_its_shape(tmp_path):
    directions, faces = holed_sphere(150, [])
    write_shapes(tmp_path / "good", directions, faces, (), [1, 1, 1])
    good = adopt_shapes(tmp_path / "good", tmp_path / "out", SourceSettings())
    assert not any("folded" in note for note in good.notes)
    dented = read_mesh(tmp_path / "good" / "p3.vtp").vertices.copy()
    edge = 0.6 * dented[:, 0].max()
    dented[:, 0] = np.where(dented[:, 0] > edge, 2.0 * edge - dented[:, 0], dented[:, 0])
    write_surface(tmp_path / "good" / "p3.vtp", dented, faces)
    folded = adopt_shapes(tmp_path / "good", tmp_path / "other", SourceSettings())
    told = [note for note in folded.notes if "folded against the mean" in note]
    assert len(told) == 1
    assert told[0].startswith("p3: ")


def test_the_unit_that_a_format_fixes_is_believed(tmp_path):
    directions, faces = holed_sphere(150, [])
    for k in range(4):
        points = 1000.0 * directions * (20.0 + k)  # micrometres
        rows = [" ".join(map(repr, row)) for row in points.tolist()]
        (tmp_path / f"p{k}.pts").write_text("\n".join([str(len(rows)), *rows]) + "\n")
        elements = [f"Tr {a} {b} {c} 1" for a, b, c in faces.tolist()]
        (tmp_path / f"p{k}.elem").write_text("\n".join([str(len(faces)), *elements]) + "\n")
    found = read_source(tmp_path, SourceSettings(pattern="{subject}.elem"))
    radii = np.linalg.norm(found.points, axis=2)
    np.testing.assert_allclose(radii, np.repeat([[20.0], [21.0], [22.0], [23.0]], 150, axis=1))


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
    assert "left out 1 excluded shape" in found.notes
    adopt_shapes(project, tmp_path / "out", SourceSettings())
    lines = (tmp_path / "out" / "covariates.csv").read_text(encoding="utf-8").splitlines()
    assert lines == ["subject,phase,sex", "p0,,m", "p1,,f", "p2,,m", "p4,,m"]
    project.write_text(json.dumps({"data": [r | {"excluded": "true"} for r in rows]}))
    with pytest.raises(InputError, match="found all 5 excluded"):
        read_source(project, SourceSettings())


def test_what_the_meshes_hold_at_their_points_is_carried(tmp_path):
    directions, faces = holed_sphere(150, [((0.0, 0.0, 1.0), 0.4, 12)])
    for k in range(4):
        points = directions * (20.0 + k)
        values = {"voltage": points[:, 0], "region": (points[:, 2] > 0).astype(int)}
        write_surface(tmp_path / "in" / f"p{k}.vtp", points, faces, values, {"scar": faces[:, 0]})
    settings = SourceSettings(fields=stated_fields("voltage, region:label,scar"))
    adopt_shapes(tmp_path / "in", tmp_path / "out", settings)
    voltage, region, scar = read_fields(Store(tmp_path / "out"))
    np.testing.assert_allclose(voltage.values, np.outer([20.0, 21.0, 22.0, 23.0], directions[:, 0]))
    assert region.is_label
    np.testing.assert_array_equal(region.values[2], directions[:, 2] > 0)
    held = [set(faces[(faces == k).any(axis=1), 0].tolist()) for k in range(len(directions))]
    assert all(value in own for value, own in zip(scar.values[1], held, strict=True))
    mean = read_mesh(tmp_path / "out" / "meshes" / "mean.vtp")
    np.testing.assert_allclose(mean.point_data["voltage"], 21.5 * directions[:, 0])
    assert (tmp_path / "out" / "fields" / "voltage.csv").is_file()
    wrong = SourceSettings(fields=stated_fields("thickness"))
    with pytest.raises(InputError, match=r"p0.vtp: .*expected the array thickness"):
        read_source(tmp_path / "in", wrong)


@pytest.mark.parametrize("text", ["a,a", ",a", "a:colour"])
def test_fields_that_are_stated_wrongly_are_refused(text):
    with pytest.raises(InputError, match="--fields: expected different names"):
        stated_fields(text)


def test_an_order_that_is_turned_in_parameter_space_is_told(tmp_path):
    directions, faces = holed_sphere(150, [])
    write_shapes(tmp_path / "good", directions, faces, (), [1, 1, 1])
    good = adopt_shapes(tmp_path / "good", tmp_path / "out", SourceSettings())
    assert not any("turned by" in note for note in good.notes)
    write_shapes(tmp_path / "bad", directions, faces, (2, 4), [-1, -1, 1])
    (told,) = (
        note
        for note in adopt_shapes(tmp_path / "bad", tmp_path / "other", SourceSettings()).notes
        if "turned by" in note
    )
    assert told.startswith("p2, p4: turned by 1")
    assert told.endswith("the order of their points may be turned against the others'")
